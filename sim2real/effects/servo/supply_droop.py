"""Supply droop: a battery that runs down, and with it the torque.

What the controller asks scales with the voltage, the damping by back-EMF does not:
``torque = kp error (1 - loss_per_min * minutes) - kd v`` (the circuit of a DC motor behind a
bridge; any text on motors).

Leaves gain that falls evenly with time, on all joints alike. Taken for: thermal derating, clock
drift; a fresh battery tells.
"""

import warp as wp

from sim2real.effects.effect import Effect, Parameter


@wp.func
def droop(
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
    """Torque that the motor makes in N m."""
    asked = x + p[1] * v
    return (
        asked * wp.max(wp.float64(1.0) - p[c] * time / wp.float64(60.0), wp.float64(0.0)) - p[1] * v
    )


EFFECT = Effect(
    name="supply_droop",
    plain="a supply that runs down",
    says=lambda p: (
        "the supply voltage, and the motor torque with it, "
        + ("falls" if p["loss_per_min"] > 0 else "rises")
        + " by {loss_per_min} per minute"
    ),
    site="motor",
    term=droop,
    parameters=(Parameter("loss_per_min", low=-0.5, high=0.5, typical=0.1),),
    component="supply",
    order=1,
)
