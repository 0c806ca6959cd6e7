"""A gear train of two masses: the motor's side, the output's side, and a coupling between them.

With x the angle by which the motor leads the output and F the torque through the coupling::

    Jm vm' = torque - F - friction of the motor's side
    Jo vo' = load   + F - friction of the output's side

Backlash is a rigid contact beyond a dead zone: F = 0 while |x| < gap / 2, and impacts are inelastic
(Nordin, Gutman, Automatica 38 (2002) 1633-1649, Sec. 2). Compliance is a spring with a damper,
F = x / c + d x' (Spong, Journal of Dynamic Systems 109 (1987) 310-318), with a damping ratio of
``SPRING_DAMPING``. With both, the spring acts beyond the dead zone. Without either the two move as
one mass. The controller acts on the motor's angle; the sensor is on either side.

A sub-step in which a flank is met is divided at the contact, so that contacts are of second order
like the rest of the law.
"""

import warp as wp

from sim2real.servo.friction import slide

vec4 = wp.types.vector(length=4, dtype=wp.float64)
"""Angle and speed of the motor's side; lead of the motor, and its rate."""

SPRING_DAMPING = 0.05
_PHASES = wp.constant(6)
"""Contacts in one sub-step at most."""
_SWEEPS = wp.constant(8)


@wp.struct
class Train:
    """A gear train: inertias in kg m2, half the gap in rad, the spring in rad/(N m).

    ``damper`` is in N m s; ``friction`` is the bound of dry friction on the output, N m.
    """

    motor: wp.float64
    output: wp.float64
    half_gap: wp.float64
    spring: wp.float64
    damper: wp.float64
    friction: wp.float64


@wp.func
def free_mass(
    q: wp.float64,
    v: wp.float64,
    torque: wp.float64,
    damping: wp.float64,
    inertia: wp.float64,
    dry: wp.float64,
    h: wp.float64,
) -> wp.vec2d:
    """Angle and speed of a mass after h, under a torque, damping and dry friction."""
    half = wp.float64(0.5) * h
    damp = half * damping
    per = wp.float64(1.0) / (inertia + damp)
    free = ((inertia - damp) * v + h * torque) * per
    if dry > wp.float64(0.0):
        state = wp.vec4d(q, v, wp.float64(0.0), wp.float64(0.0))
        after = slide(state, free, h * dry * per, half, torque, wp.float64(0.0))
        return wp.vec2d(after[0], after[1])
    return wp.vec2d(q + half * (v + free), free)


@wp.func
def pressed(
    side: wp.float64,
    before: wp.float64,
    after: wp.float64,
    torque: wp.float64,
    load: wp.float64,
    dry: wp.float64,
    h: wp.float64,
    g: Train,
) -> bool:
    """Whether a flank pushes, rather than pulls, while both sides move from one speed to another."""
    zero = wp.float64(0.0)
    if after == zero:  # at rest: friction takes what it needs to on either side
        if side > zero:
            return wp.min(torque + dry, g.friction - load) >= zero
        return wp.max(torque - dry, -g.friction - load) <= zero
    through = g.output * (after - before) - h * load + h * g.friction * wp.sign(before + after)
    return side * through >= zero


@wp.func
def across_gap(
    state: vec4,
    torque: wp.float64,
    damping: wp.float64,
    load: wp.float64,
    dry: wp.float64,
    h: wp.float64,
    g: Train,
) -> vec4:
    """A sub-step of a train whose flanks are rigid."""
    zero = wp.float64(0.0)
    q = state[0]
    v = state[1]
    x = state[2]
    faster = state[3]
    left = wp.float64(h)
    phase = int(0)
    while phase < _PHASES and left > zero:
        phase += 1
        side = zero
        if wp.abs(x) >= g.half_gap * wp.float64(1.0 - 1e-12) and x * faster >= zero:
            side = wp.sign(x)
            common = (g.motor * v + g.output * (v - faster)) / (g.motor + g.output)
            one = free_mass(
                q, common, torque + load, damping, g.motor + g.output, dry + g.friction, left
            )
            if pressed(side, common, one[1], torque - damping * common, load, dry, left, g):
                return vec4(one[0], one[1], side * g.half_gap, zero)
            v = common
            faster = zero
        a = free_mass(q, v, torque, damping, g.motor, dry, left)
        b = free_mass(q - x, v - faster, load, zero, g.output, g.friction, left)
        apart = a[0] - b[0]
        if wp.abs(apart) <= g.half_gap:
            return vec4(a[0], a[1], apart, a[1] - b[1])
        if wp.sign(apart) == side:  # neither pressed nor parted: it rolls along
            return vec4(a[0], a[1], side * g.half_gap, zero)
        flank = wp.sign(apart) * g.half_gap
        until = left * wp.clamp((flank - x) / (apart - x), zero, wp.float64(1.0))
        a = free_mass(q, v, torque, damping, g.motor, dry, until)
        b = free_mass(q - x, v - faster, load, zero, g.output, g.friction, until)
        q = a[0]
        v = a[1]
        faster = a[1] - b[1]
        x = flank
        if x * faster < zero:
            faster = zero
        left -= until
    return vec4(q, v, x, faster)


@wp.func
def through_spring(
    state: vec4,
    torque: wp.float64,
    damping: wp.float64,
    load: wp.float64,
    dry: wp.float64,
    h: wp.float64,
    g: Train,
) -> vec4:
    """A sub-step of a train that is a spring: the midpoint rule, friction as impulses."""
    zero = wp.float64(0.0)
    half = wp.float64(0.5) * h
    v = state[1]
    output = v - state[3]
    middle = state[2] + half * state[3]
    force = zero
    gain = zero
    if g.half_gap == zero or wp.abs(middle) > g.half_gap:
        per = wp.float64(1.0) / g.spring
        force = (state[2] - wp.sign(middle) * g.half_gap) * per
        gain = half * per + g.damper
    # Mean speeds a and b: (2 Jm/h + D + G) a - G b = ..., (2 Jo/h + G) b - G a = ...
    m = wp.float64(2.0) * g.motor / h
    o = wp.float64(2.0) * g.output / h
    m1 = m + damping + gain
    o1 = o + gain
    per = wp.float64(1.0) / (m1 * o1 - gain * gain)
    right = m * v + torque - force
    below = o * output + load + force
    a = (o1 * right + gain * below) * per
    b = (gain * right + m1 * below) * per
    if dry + g.friction > zero:
        # Friction's torques c, d change a by (o1 c + G d) per, b by (G c + m1 d) per
        c = zero
        d = zero
        sweep = int(0)
        changed = bool(True)
        while changed and sweep < _SWEEPS:
            sweep += 1
            end = wp.float64(2.0) * (a + (o1 * c + gain * d) * per) - v
            new = wp.clamp(c - end / (wp.float64(2.0) * o1 * per), -dry, dry)
            changed = wp.abs(new - c) > wp.float64(1e-9) * dry
            c = new
            end = wp.float64(2.0) * (b + (gain * c + m1 * d) * per) - output
            new = wp.clamp(d - end / (wp.float64(2.0) * m1 * per), -g.friction, g.friction)
            changed = changed or wp.abs(new - d) > wp.float64(1e-9) * g.friction
            d = new
            if dry == zero or g.friction == zero:
                changed = False
        a += (o1 * c + gain * d) * per
        b += (gain * c + m1 * d) * per
    after = wp.float64(2.0) * a - v
    faster = after - (wp.float64(2.0) * b - output)
    return vec4(state[0] + h * a, after, state[2] + half * (state[3] + faster), faster)


@wp.func
def train_step(
    state: vec4,
    torque: wp.float64,
    damping: wp.float64,
    load: wp.float64,
    dry: wp.float64,
    h: wp.float64,
    g: Train,
) -> vec4:
    """Advance a train by h; the motor's torque is ``torque`` less ``damping`` times its speed."""
    if g.spring > wp.float64(0.0):
        return through_spring(state, torque, damping, load, dry, h, g)
    return across_gap(state, torque, damping, load, dry, h, g)
