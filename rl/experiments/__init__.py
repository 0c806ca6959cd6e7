"""Evaluation, ablation, and the realities that policies are tried in."""
