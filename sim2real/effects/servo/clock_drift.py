"""Clock drift: the clock that sends and the clock that measures run at different rates.

A set-point sent ``time`` seconds into the recording takes effect ``s_per_s * time`` later than the
first one did.

Leaves error in proportion to speed that grows with time. Taken for: supply droop, thermal derating;
it is a lag, not a gain.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def drift(
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
    """Time at which a set-point takes effect in s."""
    return x + p[c] * time


EFFECT = Effect(
    name="clock_drift",
    plain="clocks that drift apart",
    says=lambda p: (
        "the delay between set-point and response "
        + ("grows" if p["s_per_s"] > 0 else "shrinks")
        + " by {s_per_s} of the elapsed time, as with clocks that drift apart"
    ),
    site="arrival",
    term=drift,
    parameters=(Parameter("s_per_s", low=-0.01, high=0.01, typical=0.001),),
    component="link",
)
