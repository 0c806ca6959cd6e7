"""Latency jitter: the latency differs from one set-point to the next.

Uniform within ``halfwidth_s`` of the latency, drawn independently for each set-point; set-points
keep their order. Residual: noise proportional to speed. Confused with: sensor noise; a regression
of the squared residual on the squared speed distinguishes them.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def scatter(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    # A random stream of its own.
    number = wp.float64(wp.randf(wp.rand_init(31, int(q))))
    return x + p[c] * (wp.float64(2.0) * number - wp.float64(1.0))


EFFECT = Effect(
    plain="latency jitter",
    says="set-points arrive up to {halfwidth_s} before or after the mean latency",
    site="arrival",
    term=scatter,
    parameters=(Parameter("halfwidth_s", low=0.0, high=0.1, typical=0.01),),
    component="link",
    order=1,
    fitted=False,
    mimics=("rate_limit", "torque_saturation"),
)
