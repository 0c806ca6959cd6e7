"""The link to a robot: do its set-points arrive unevenly, or not at all?

A delay of one set-point or its loss is a random event of its own, so that no refit reproduces it.
But what it does to the angle is known, a short response in proportion to the change of the
set-point (``sim2real.residuals.linear``), and the sum of all such responses is found in the
residual by its likelihood.
"""
