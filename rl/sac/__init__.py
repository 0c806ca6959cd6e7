"""Soft actor-critic: several agents side by side, resumable."""
