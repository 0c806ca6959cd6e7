"""Unmodelled inertia: what turns besides the stated load, or what was stated too much.

Loads are stated without the servo's rotor. A rotor behind gears of ratio n adds n squared times its
inertia to the shaft, often as much as the load itself (any text on drives). Where no law states a
rotor, this effect stands for it; where one does, for a part of the load that was not stated.
Residual: an error proportional to acceleration. Confused with: latency, tens of milliseconds of it;
a pendulum distinguishes them, as its weight is known.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def rotor(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    return x + p[c]


EFFECT = Effect(
    plain="inertia missing from the stated load",
    says="the stated load inertia is {inertia_kgm2} too "
    "{inertia_kgm2:small for the load and its rotor|large}",
    site="inertia",
    term=rotor,
    parameters=(Parameter("inertia_kgm2", low=-0.0018, high=0.04, typical=0.001),),
    either_sign=True,
    load="inertia_kgm2",
)
