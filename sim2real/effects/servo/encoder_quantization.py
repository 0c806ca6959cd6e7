"""Encoder quantization: the measured angle is rounded to multiples of ``step_rad``.

``angle = step round(q / step)``. Residual: a sawtooth of half a step. Nothing else looks like it.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def count(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    return p[c] * wp.round(x / p[c])


EFFECT = Effect(
    plain="coarse quantization of the angle sensor",
    says="the angle sensor has a resolution of {step_rad}, coarser than the data sheet states",
    site="sensor",
    term=count,
    parameters=(Parameter("step_rad", low=0.0, high=0.1, typical=0.00419),),
    order=5,
    fitted=False,
    steady=True,
)
