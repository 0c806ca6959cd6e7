"""Servos as problems of the shared inference: what a fit leaves, and what would explain it."""
