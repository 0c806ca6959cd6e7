"""A policy outside the simulator: exports, radio, pilot."""
