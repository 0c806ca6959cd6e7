"""Encoder quantization: the measured angle comes in steps of ``step_rad``.

``angle = step round(q / step)``.

Leaves a sawtooth of half a step. Nothing else looks like it.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def count(
    x: wp.float64,
    q: wp.float64,
    v: wp.float64,
    torque: wp.float64,
    time: wp.float64,
    h: wp.float64,
    p: wp.array(dtype=wp.float64),
    c: int,
    z: wp.array(dtype=wp.float64),
    s: int,
) -> wp.float64:
    """Measured angle in rad."""
    return p[c] * wp.round(x / p[c])


EFFECT = Effect(
    name="encoder_quantization",
    plain="a coarser angle sensor",
    says="the angle sensor has a resolution of {step_rad}, coarser than the data sheet states",
    site="sensor",
    term=count,
    parameters=(Parameter("step_rad", low=0.0, high=0.1, typical=0.00419),),
    order=5,
    fitted=False,
    steady=True,
)
