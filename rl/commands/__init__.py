"""The commands that learn, one file each; the command line imports them when they run."""
