"""Posteriors of servos: priors, likelihoods, a chain that survives being killed, and what is left.

``servo.sample_servo`` does it all for one joint.
"""
