"""Effects of servos, of their supply and of the link to them: one file each."""
