"""Simulation of servos: law, parameters and batched rollouts."""
