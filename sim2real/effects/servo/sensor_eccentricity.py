"""Sensor eccentricity: the measured angle errs by a wave of the angle itself.

``measured = q + amplitude_rad sin(2 pi q / period + phase)``, as a magnet off its axis, the teeth
of a gear before the sensor or its interpolation make it (any text on magnetic encoders). Every
sensor has a little of it, so that it belongs to the plain servo and is no finding.

Leaves a wave over the angle, the same in both directions and at all speeds. Taken for: cogging.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def wave(
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
    if p[c + 1] == wp.float64(0.0):
        return x
    return x + p[c] * wp.sin(wp.float64(6.283185307179586) * q / p[c + 1] + p[c + 2])


_PERIODS = tuple(3.2 / (1.0 + 0.5 * k) for k in range(18))
"""From a wave in 3.2 rad to one in a third of a radian."""
_PHASES = (0.0, 2.0944, -2.0944)

EFFECT = Effect(
    name="sensor_eccentricity",
    plain="an angle sensor whose error is a wave of the angle",
    says="the angle sensor errs by {amplitude_rad} every {period_rad}",
    site="sensor",
    term=wave,
    parameters=(
        Parameter("amplitude_rad", low=0.0, high=0.03, typical=0.005, starts=(0.002,)),
        Parameter("period_rad", low=0.2, high=7.0, typical=0.5, starts=_PERIODS),
        Parameter("phase_rad", low=-3.15, high=3.15, typical=1.0, starts=_PHASES),
    ),
    order=2,
    everywhere=True,
    never_named=True,
)
