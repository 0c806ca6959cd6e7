"""Effects of the camera above the pool: one file each."""
