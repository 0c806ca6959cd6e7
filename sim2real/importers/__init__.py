"""Import of public logs as recordings, with one reader for each format."""
