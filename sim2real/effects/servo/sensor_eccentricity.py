"""Sensor eccentricity: the error of the angle sensor is periodic in the angle.

``measured = q + amplitude_rad (sin(2 pi q / period + phase) - zero - slope q)``, caused by an
off-axis magnet, the teeth of a gear before the sensor or its interpolation (any text on magnetic
encoders). ``zero`` and ``slope`` are those of the straight line through the sine over 0.8 rad
either way, which a calibration removes and which would otherwise be an offset and a gain of the
sensor. Every sensor has a small eccentricity; it belongs to the plain servo and is no finding.
Residual: a sine of the angle, the same in both directions and at all speeds. Confused with:
cogging.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp
from sim2real.effects.elementary import sine

RANGE_RAD = 0.8
"""Angles, either way, over which the sensor is calibrated."""


@wp.func
def wave(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    if p[c + 1] == wp.float64(0.0):
        return x
    turn = wp.float64(6.283185307179586) / p[c + 1]
    if z[s] == wp.float64(0.0):
        z[s] = wp.float64(1.0)
        r = turn * wp.static(wp.float64(RANGE_RAD))
        z[s + 1] = wp.sin(p[c + 2]) * wp.sin(r) / r
        z[s + 2] = (
            wp.float64(3.0) * turn * wp.cos(p[c + 2]) * (wp.sin(r) - r * wp.cos(r)) / (r * r * r)
        )
    return x + p[c] * (sine(turn * q + p[c + 2]) - z[s + 1] - z[s + 2] * q)


_PERIODS = tuple(3.2 / (1.0 + 0.5 * k) for k in range(18))
"""From a wave in 3.2 rad to one in a third of a radian."""
_PHASES = (0.0, 2.0944, -2.0944)

EFFECT = Effect(
    plain="eccentricity of the angle sensor",
    says="the error of the angle sensor has an amplitude of {amplitude_rad} and "
    "repeats every {period_rad}",
    site="sensor",
    term=wave,
    parameters=(
        Parameter("amplitude_rad", low=0.0, high=0.03, typical=0.005, starts=(0.002,)),
        Parameter("period_rad", low=0.2, high=7.0, typical=0.5, starts=_PERIODS),
        Parameter("phase_rad", low=-6.3, high=6.3, typical=1.0, starts=_PHASES),
    ),
    memory=3,
    order=2,
    everywhere=True,
    never_named=True,
    steady=True,
)
