"""Boxes of water, and their coupling to bodies."""
