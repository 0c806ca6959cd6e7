"""Cogging: a torque that repeats with the angle, from magnets, teeth or an eccentric gear.

``torque = torque_Nm sin(2 pi q / period + phase)``. Residual: a ripple over the angle, the same in
both directions. Confused with: eccentricity of the angle sensor.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp
from sim2real.effects.elementary import sine


@wp.func
def ripple(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    if p[c + 1] == wp.float64(0.0):
        return x
    return x + p[c] * sine(wp.float64(6.283185307179586) * q / p[c + 1] + p[c + 2])


_PERIODS = tuple(5.0 / (0.75 + 0.6 * k) for k in range(33))
"""From one bump in 1.3 rad to twenty in one."""
_PHASES = (0.0, 2.0944, -2.0944)

EFFECT = Effect(
    plain="cogging torque",
    says="a torque ripple with an amplitude of {torque_Nm} repeats every {period_rad}",
    site="load",
    term=ripple,
    parameters=(
        Parameter("torque_Nm", low=0.0, high=0.5, typical=0.05, starts=(0.3,)),
        Parameter("period_rad", low=0.002, high=1.6, typical=0.2, starts=_PERIODS),
        Parameter("phase_rad", low=-6.3, high=6.3, typical=1.0, starts=_PHASES),
    ),
    everywhere=True,
)
