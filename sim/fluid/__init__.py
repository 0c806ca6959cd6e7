"""Boxes of water, and how bodies touch them."""
