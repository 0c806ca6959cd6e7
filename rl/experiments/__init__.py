"""Evaluation, ablation, and the realities that policies are tested in."""
