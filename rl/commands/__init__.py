"""Commands for training and testing policies; the command line imports them when they run."""
