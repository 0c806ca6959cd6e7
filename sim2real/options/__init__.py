"""What each command takes, a file for each part of the work; light to import."""
