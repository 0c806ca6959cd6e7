"""Two masses of a gear train that a spring couples, advanced by the midpoint rule."""

import warp as wp

from sim2real.effects.effect import F
from sim2real.servo.motor import Push

_SWEEPS = wp.constant(8)
"""Iterations at most over the dry friction of both sides, which the spring couples."""


@wp.struct
class Train:
    """A gear train: inertias in kg m2, half the gap in rad.

    ``stiffness`` of the spring is in N m/rad, 0 where the flanks are rigid, and ``damper`` in
    N m s; ``friction`` is the bound of dry friction on the output, N m; ``restitution`` the ratio
    of the rates after and before an impact; ``seen`` is 1 where the controller sees the output's
    angle and 0 where it sees the motor's, ``seen_speed`` the same for the speed.
    """

    motor: wp.float64
    output: wp.float64
    total: wp.float64
    output_share: wp.float64
    half_gap: wp.float64
    stiffness: wp.float64
    damper: wp.float64
    friction: wp.float64
    restitution: wp.float64
    seen: wp.float64
    seen_speed: wp.float64


@wp.func
def through_spring(state: wp.vec4d, drive: Push, load: F, dry: F, h: F, g: Train) -> wp.vec4d:
    """A sub-step of a train that is a spring: the midpoint rule, friction as impulses."""
    zero = wp.float64(0.0)
    half = wp.float64(0.5) * h
    v = state[1]
    w = v - state[3]
    stretch = state[2]
    gain = half * g.stiffness + g.damper  # torque of the spring per mean rate
    if g.half_gap > zero:
        middle = state[2] + half * state[3]
        stretch -= wp.sign(middle) * g.half_gap
        if wp.abs(middle) <= g.half_gap:
            stretch = zero
            gain = zero
    force = g.stiffness * stretch
    # For mean speeds a, b, and with a part C of D that acts on the output's speed:
    # (2 Jm/h + D - C + G) a - (G - C) b = 2 Jm/h v + T - F, and
    # (2 Jo/h + G) b - G a = 2 Jo/h w + load + F; their solution is a matrix of mobilities.
    motor = wp.float64(2.0) * g.motor / h
    output = wp.float64(2.0) * g.output / h
    on_output = drive.seen_damping + drive.seen * half * drive.stiffness
    motor_row = motor + drive.damping + half * drive.stiffness - on_output + gain
    output_row = output + gain
    coupling = gain - on_output
    per = wp.float64(1.0) / (motor_row * output_row - coupling * gain)
    mobility = output_row * per
    output_mobility = motor_row * per
    by_output = coupling * per
    by_motor = gain * per
    on_motor = motor * v + drive.torque - force
    on_output = output * w + load + force
    dry_motor = zero
    dry_output = zero
    if dry + g.friction > zero:  # as if both sides went on sliding
        dry_motor = -wp.sign(v) * dry
        dry_output = -wp.sign(w) * g.friction
        on_motor += dry_motor
        on_output += dry_output
    a = mobility * on_motor + by_output * on_output
    b = by_motor * on_motor + output_mobility * on_output
    after = a + a - v
    output_after = b + b - w
    if (dry > zero and after * v <= zero) or (g.friction > zero and output_after * w <= zero):
        sweep = int(0)
        changed = bool(True)
        while changed and sweep < _SWEEPS:
            sweep += 1
            to_stop = dry_motor - (a - wp.float64(0.5) * v) / mobility
            change = wp.clamp(to_stop, -dry, dry) - dry_motor
            dry_motor += change
            a += mobility * change
            b += by_motor * change
            changed = wp.abs(change) > wp.float64(1e-9) * dry
            to_stop = dry_output - (b - wp.float64(0.5) * w) / output_mobility
            change = wp.clamp(to_stop, -g.friction, g.friction) - dry_output
            dry_output += change
            a += by_output * change
            b += output_mobility * change
            changed = changed or wp.abs(change) > wp.float64(1e-9) * g.friction
            changed = changed and dry > zero and g.friction > zero
        after = a + a - v
        output_after = b + b - w
        # A speed at rest is 0, without a rounding error that friction takes for a direction.
        if wp.abs(dry_motor) < dry:
            a = wp.float64(0.5) * v
            after = zero
        if wp.abs(dry_output) < g.friction:
            b = wp.float64(0.5) * w
            output_after = zero
    return wp.vec4d(state[0] + h * a, after, state[2] + h * (a - b), after - output_after)
