"""Randomization ranges: distributions of a simulator's parameters, derived from data."""
