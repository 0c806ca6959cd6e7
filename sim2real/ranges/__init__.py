"""Randomization ranges: distributions of the simulator's parameters, derived from data.

``gather.gather`` derives them from recordings and a model; ``entry`` defines their file.
"""
