"""Soft actor-critic for several agents in parallel, resumable."""
