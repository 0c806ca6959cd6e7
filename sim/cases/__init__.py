"""Published cases that the fluid is measured against, one file each."""
