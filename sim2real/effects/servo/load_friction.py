"""Load-dependent friction: friction proportional to the torque transmitted by the gears.

``bound = ratio |torque| exp(-(v fading)^2)``, as teeth and bearings are pressed together, and as
the lubricant separates them at speed; ``fading_s_per_rad`` is 0 where it does not fade. Source:
Duclusaud, Passault, Padois, Ly, Extended Friction Models for the Physics Simulation of Servo
Actuators, ICRA 2025, the load-dependent models without and with a Stribeck part. Residual: an error
proportional to load that differs between driving and back-driving. Confused with: a smaller kp,
which absorbs nearly all of it; another load or gain distinguishes them.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp
from sim2real.effects.elementary import decay

FADES_FROM_S_PER_RAD = 0.02


@wp.func
def bound(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    share = p[c]
    if p[c + 1] > wp.float64(0.0):
        slow = v * p[c + 1]
        share *= decay(slow * slow)
    return x + share * wp.abs(torque)


EFFECT = Effect(
    plain="load-dependent friction",
    says=lambda p: (
        "gear friction opposes the motion with {ratio} of the transmitted torque"
        + (
            f" and fades above {1 / p['fading_s_per_rad']:.2g} rad/s"
            if p.get("fading_s_per_rad", 0.0) > FADES_FROM_S_PER_RAD
            else ""
        )
    ),
    site="friction",
    term=bound,
    parameters=(
        Parameter("ratio", low=0.0, high=0.9, typical=0.2),
        Parameter("fading_s_per_rad", low=0.0, high=5.0, typical=0.5, starts=(0.0, 1.0)),
    ),
)
