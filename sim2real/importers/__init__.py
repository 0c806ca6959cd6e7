"""Public logs made into recordings: one reader for each format of log."""
