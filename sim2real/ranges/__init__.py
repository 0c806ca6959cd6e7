"""Randomization ranges: how far each parameter of the simulator may be from its value, by data.

``gather.gather`` makes them from recordings and a model; ``entry`` has their file.
"""
