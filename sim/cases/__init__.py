"""Published cases for validation of the fluid, one file each."""
