"""Dead band: the controller ignores errors up to ``halfwidth_rad``.

``error = sgn(error) (max(|error| - halfwidth, 0) + step)``, where ``step`` is ``step_share`` times
the half-width beyond the band and 0 in it. A share of 0 subtracts the band, as an analogue
controller does; 1 is firmware that switches (``if |error| < halfwidth: error = 0``). Residual: a
static offset within the band, and small sines with flat tops. Confused with: Coulomb friction,
backlash; small steps under load distinguish them, as the band does not depend on the direction of
the load.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp

SWITCHES_FROM = 0.5


@wp.func
def ignore(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    beyond = x - wp.clamp(x, -p[c], p[c])
    if beyond != wp.float64(0.0):
        beyond += wp.sign(x) * p[c + 1] * p[c]
    return beyond


EFFECT = Effect(
    plain="a dead band of the controller",
    says=lambda p: (
        "the controller ignores position errors below {halfwidth_rad}"
        + (", and acts on the whole error above" if p.get("step_share", 0) > SWITCHES_FROM else "")
    ),
    site="error",
    term=ignore,
    parameters=(
        Parameter("halfwidth_rad", low=0.0, high=0.1, typical=0.01),
        Parameter("step_share", low=0.0, high=1.0, typical=1.0, starts=(0.0, 1.0)),
    ),
)
