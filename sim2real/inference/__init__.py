"""Inference for servos and swims, independent of both: fits, noise, evidence, model selection.

``sim2real.identification`` has the problem of a servo's recordings, ``sim.inference`` that of
swims.
"""
