"""Posteriors of servos: likelihoods, resumable chains, convergence, predictive checks."""
