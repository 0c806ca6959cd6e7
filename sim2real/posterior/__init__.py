"""Posteriors of servos: priors, likelihoods, resumable chains, convergence, predictive checks.

``servo.sample_servo`` samples the posterior of one joint.
"""
