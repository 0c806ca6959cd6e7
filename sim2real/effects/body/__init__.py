"""Effects of the body in the water: one file each."""
