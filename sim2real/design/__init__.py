"""Recordings to make next, designed for what they will tell."""
