"""Packet loss: some set-points never arrive; the previous one stays in force.

Each is lost with ``probability``, independently. Residual: isolated spikes proportional to the
change of the set-point. Confused with: latency jitter, whose delay is bounded by its width.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def lose(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    """Time at which a set-point takes effect in s; infinite if it is lost."""
    # A random stream of its own.
    if wp.float64(wp.randf(wp.rand_init(33, int(q)))) < p[c]:
        return wp.float64(wp.inf)
    return x


EFFECT = Effect(
    plain="lost set-points",
    says="{probability} of the set-points are lost",
    site="arrival",
    term=lose,
    parameters=(Parameter("probability", low=0.0, high=1.0, typical=0.05),),
    component="link",
    order=2,
    fitted=False,
)
