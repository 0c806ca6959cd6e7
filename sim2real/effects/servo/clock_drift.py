"""Clock drift: the clock of the set-points and the clock of the samples have different rates.

A set-point sent ``time`` seconds into the recording takes effect ``s_per_s * time`` later than the
first one did. Residual: an error proportional to speed that grows with time. Confused with: supply
droop, thermal derating, which change a gain and not a delay.
"""

from sim2real.effects.effect import Effect, F, Parameter, Row, wp


@wp.func
def drift(x: F, q: F, v: F, torque: F, time: F, h: F, p: Row, c: int, z: Row, s: int) -> F:
    return x + p[c] * time


EFFECT = Effect(
    plain="clock drift",
    says="the delay between set-point and response {s_per_s:grows|shrinks} by {s_per_s} of the "
    "elapsed time, as with clocks that drift apart",
    site="arrival",
    term=drift,
    parameters=(Parameter("s_per_s", low=-0.01, high=0.01, typical=0.001),),
    component="link",
)
