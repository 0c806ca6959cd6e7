"""Published cases for validation of the fluid: ``python -m benchmarks.validation``."""
