"""A gear train of two masses: the motor's side, the output's side, and a coupling between them.

With x the angle by which the motor leads the output and F the torque through the coupling::

    Jm vm' = torque - F - friction of the motor's side
    Jo vo' = load   + F - friction of the output's side

Backlash is a rigid contact beyond a dead zone: F = 0 while |x| < gap / 2 (Nordin, Gutman,
Automatica 38 (2002) 1633-1649, Sec. 2). An impact reverses the rate of x, times a coefficient of
restitution. Compliance is a spring with a damper, F = x / c + d x' (Spong, Journal of Dynamic
Systems 109 (1987) 310-318), with a damping ratio of ``SPRING_DAMPING`` unless one is stated. With
both, the spring acts beyond the dead zone. Without either the two move as one mass. Controller and
sensor are on either side.

Jm is the inertia of the rotor, reflected through the gears: that of the motor's law, and what the
effect states in addition. Jo is the stated load, corrected by ``unmodelled_inertia``. Where the
effect states no rotor, Jm is all that turns beyond the stated load, ``unmodelled_inertia``
included; if that is 0 with a gap, the output has no inertia.

A sub-step in which a flank is met is divided at the contact, so that contacts are of second order
like the rest of the law. A rebound that would end within half of what is left of the sub-step is
left out. With a restitution of 0 an output without friction comes to rest on a flank.
"""

import warp as wp

from sim2real.effects import CATALOGUE
from sim2real.effects.effect import F, Row
from sim2real.servo import effect_chain as sites
from sim2real.servo.motor import (
    MOTOR_BIT,
    Motor,
    Push,
    drive_push,
    free_mass,
    gear_friction,
    pendulum_torque,
    resistance,
)
from sim2real.servo.parameters import (
    FIRST_CELL,
    FIRST_COLUMN,
    INERTIA_LEFT_OUT,
    LOAD_CELL,
    ROTOR_INERTIA,
    TRAINS,
)
from sim2real.servo.spring_train import Train, through_spring

SPRING_DAMPING = 0.05
"""Damping ratio of the two masses on the spring."""
_GAP, _SPRING = FIRST_COLUMN["backlash"], FIRST_COLUMN["compliance"]
_GAP_CELL, _SPRING_CELL = FIRST_CELL["backlash"], FIRST_CELL["compliance"]
_GAP_BIT, _SPRING_BIT = (1 << [effect.name for effect in CATALOGUE].index(name) for name in TRAINS)
TRAIN_BITS = _GAP_BIT | _SPRING_BIT
"""Bits of the effects that make two masses of the gear train."""
_PHASES = wp.constant(6)
"""Contacts in one sub-step at most."""


@wp.func
def pressed(side: F, before: F, after: F, torque: F, load: F, dry: F, h: F, g: Train) -> bool:
    """Whether a flank pushes, not pulls, while both sides move from one speed to another."""
    zero = wp.float64(0.0)
    if after == zero:  # at rest: friction takes what it needs to on either side
        if side > zero:
            return wp.min(torque + dry, g.friction - load) >= zero
        return wp.max(torque - dry, -g.friction - load) <= zero
    through = g.output * (after - before) - h * load + h * g.friction * wp.sign(before + after)
    return side * through >= zero


@wp.func
def time_to(x: F, v: F, a: F) -> F:
    """Time in which x >= 0 is first covered, from speed v, at an acceleration a that suffices."""
    root = wp.sqrt(wp.max(v * v + wp.float64(2.0) * a * x, wp.float64(0.0)))
    if v > wp.float64(0.0):
        return wp.float64(2.0) * x / (v + root)
    return (root - v) / a


@wp.func
def apart_for(q: F, v: F, x: F, rate: F, drive: Push, load: F, dry: F, h: F, g: Train) -> wp.vec4d:
    """Angles and speeds of the motor's side and of the output after h without contact."""
    zero = wp.float64(0.0)
    w = v - rate
    output = free_mass(q - x, w, load, zero, g.output, g.friction, h)
    stiff = wp.float64(0.5) * h * drive.stiffness
    damping = drive.damping + stiff
    torque = drive.torque
    if drive.seen > zero:
        on_output = drive.seen_damping + drive.seen * stiff
        torque -= on_output * wp.float64(0.5) * (w + output[1])
        damping -= on_output
    motor = free_mass(q, v, torque, damping, g.motor, dry, h)
    return wp.vec4d(motor[0], motor[1], output[0], output[1])


@wp.func
def rebound(side: F, rate: F, torque: F, load: F, h: F, g: Train) -> F:
    """Rate of the motor's lead after an impact; 0 where a rebound ends soon, within h / 2."""
    after = -g.restitution * rate
    press = side * (torque / g.motor - load / g.output)
    if wp.float64(4.0) * wp.abs(after) <= press * h:
        return wp.float64(0.0)
    return after


@wp.func
def across_gap(state: wp.vec4d, drive: Push, load: F, dry: F, h: F, g: Train) -> wp.vec4d:
    """A sub-step of a train whose flanks are rigid, divided where they meet.

    A state is the angle and speed of the motor's side, the lead of the motor, and its rate. The
    torque of ``drive`` is from the start: ``torque - stiffness (q - q0) - damping v`` with the
    angle and speed that the controller sees; the stiffness is kp, or 0 where it is clipped.
    Implicit, as a small rotor is fast.
    """
    zero = wp.float64(0.0)
    q = state[0]
    v = wp.float64(state[1])
    x = wp.float64(state[2])
    rate = wp.float64(state[3])  # of x
    remaining = wp.float64(h)
    phase = int(0)
    push = Push()
    push.torque = drive.torque
    push.damping = drive.damping
    push.stiffness = drive.stiffness
    push.seen = drive.seen
    push.seen_damping = drive.seen_damping
    while phase < _PHASES and remaining > zero:
        phase += 1
        side = zero
        joined = wp.vec4d(zero, zero, zero, zero)  # both sides as one mass
        if phase > 1:
            moved = q - state[0] - drive.seen * (x - state[2])
            push.torque = drive.torque - drive.stiffness * moved
        if wp.abs(x) >= g.half_gap * wp.float64(1.0 - 1e-12) and x * rate >= zero:
            side = wp.sign(x)
            if rate != zero:  # an impact
                after = rebound(side, rate, push.torque - push.damping * v, load, h, g)
                v -= g.output_share * (rate - after)
                rate = after
            if rate == zero:
                damping = push.damping + wp.float64(0.5) * remaining * push.stiffness
                one = free_mass(
                    q, v, push.torque + load, damping, g.total, dry + g.friction, remaining
                )
                joined = wp.vec4d(one[0], one[1], side * g.half_gap, zero)
                torque = push.torque - damping * v
                if pressed(side, v, one[1], torque, load, dry, remaining, g):
                    return joined
        end = apart_for(q, v, x, rate, push, load, dry, remaining, g)
        apart = end[0] - end[2]
        if wp.abs(apart) <= g.half_gap:
            return wp.vec4d(end[0], end[1], apart, end[1] - end[3])
        if wp.sign(apart) == side and rate == zero:  # neither pressed nor parted
            return joined
        side = wp.sign(apart)
        acceleration = side * (end[1] - end[3] - rate) / remaining
        until = wp.min(time_to(g.half_gap - side * x, side * rate, acceleration), remaining)
        end = apart_for(q, v, x, rate, push, load, dry, until, g)
        q = end[0]
        v = end[1]
        rate = end[1] - end[3]
        x = side * g.half_gap
        remaining -= until
    return wp.vec4d(q, v, x, rate)


@wp.func
def train_step(state: wp.vec4d, drive: Push, load: F, dry: F, h: F, g: Train) -> wp.vec4d:
    """Advance a train by h, under the motor's drive and torques of load and of dry friction."""
    zero = wp.float64(0.0)
    if g.stiffness > zero:
        return through_spring(state, drive, load, dry, h, g)
    if g.half_gap == zero:
        damping = drive.damping + wp.float64(0.5) * h * drive.stiffness
        torque = drive.torque + load
        end = free_mass(state[0], state[1], torque, damping, g.total, dry + g.friction, h)
        return wp.vec4d(end[0], end[1], zero, zero)
    return across_gap(state, drive, load, dry, h, g)


@wp.func
def train_cell(active: wp.int64) -> int:
    """Cell of memory with the motor's lead over the output; its rate is in the next."""
    if (active & wp.static(wp.int64(_GAP_BIT))) != wp.int64(0):
        return wp.static(_GAP_CELL)
    return wp.static(_SPRING_CELL)


@wp.func
def controlled_side(p: Row) -> wp.vec2d:
    """1 where the controller sees the output, 0 where it sees the motor: its angle, its speed."""
    twice = wp.float64(2.0) * wp.max(p[wp.static(_GAP + 3)], p[wp.static(_SPRING + 3)])
    one = wp.float64(1.0)
    return wp.vec2d(wp.min(twice, one), wp.max(twice - one, wp.float64(0.0)))


@wp.func
def train_of(inertia: F, p: Row, least: F) -> Train:
    """The gear train of a row, of so much inertia, a share of at least ``least`` on either side."""
    g = Train()
    rotor = sites.train_rotor(p)
    if rotor > wp.float64(0.0):
        rotor += p[wp.static(ROTOR_INERTIA)]
    else:
        rotor = wp.max(p[wp.static(ROTOR_INERTIA)] + p[wp.static(INERTIA_LEFT_OUT)], rotor)
    if rotor == wp.float64(0.0) and p[wp.static(_GAP)] > wp.float64(0.0):
        rotor = inertia  # an output without inertia
    g.motor = wp.clamp(rotor, least * inertia, (wp.float64(1.0) - least) * inertia)
    g.output = inertia - g.motor
    g.total = inertia
    g.output_share = g.output / inertia
    g.half_gap = wp.float64(0.5) * p[wp.static(_GAP)]
    g.friction = p[wp.static(_GAP + 2)]
    g.restitution = p[wp.static(_GAP + 4)]
    side = controlled_side(p)
    g.seen = side[0]
    g.seen_speed = side[1]
    if p[wp.static(_SPRING)] > wp.float64(0.0):
        g.stiffness = wp.float64(1.0) / p[wp.static(_SPRING)]
        reduced = g.motor * g.output_share
        ratio = p[wp.static(_SPRING + 4)]
        if ratio == wp.float64(0.0):
            ratio = wp.static(wp.float64(SPRING_DAMPING))
        g.damper = wp.float64(2.0) * ratio * wp.sqrt(reduced * g.stiffness)
    return g


@wp.func
def train_at_rest(state: wp.vec4d, u: F, kp: F, p: Row, z: Row, active: wp.int64) -> wp.vec4d:
    """State of a train whose controller holds the first set-point.

    The load rests on one flank, or where friction of the output holds it in the middle of the gap:
    it may then be anywhere.
    """
    cell = train_cell(active)
    q = state[0]
    seen = controlled_side(p)[0]
    for _ in range(8):
        carried = -pendulum_torque(q - z[cell], p[4]) - z[wp.static(LOAD_CELL)]
        z[cell] = p[wp.static(_SPRING)] * carried
        if wp.abs(carried) > p[wp.static(_GAP + 2)]:
            z[cell] += wp.float64(0.5) * p[wp.static(_GAP)] * wp.sign(carried)
        q = u - carried / kp + seen * z[cell]
    return wp.vec4d(q, state[1], carried, state[3])


@wp.func
def sensed(q: F, p: Row, z: Row, active: wp.int64) -> F:
    """Angle of the side of the gear train that the sensor is on; q is that of the motor's side."""
    if (active & wp.static(wp.int64(_GAP_BIT))) != wp.int64(0):
        return q - z[wp.static(_GAP_CELL)]
    if (active & wp.static(wp.int64(_SPRING_BIT))) != wp.int64(0):
        return q - p[wp.static(_SPRING + 2)] * z[wp.static(_SPRING_CELL)]
    return q


@wp.func
def train_substep(
    state: wp.vec4d,
    u: F,
    time: F,
    h: F,
    kp: F,
    kd: F,
    g: Train,
    m: Motor,
    p: Row,
    z: Row,
    active: wp.int64,
    tick: bool,
) -> wp.vec4d:
    """The sub-step of a servo whose gear train is two masses.

    Loads act on the output's side, the friction of the motor's law and of other effects on the
    motor's side.
    """
    zero = wp.float64(0.0)
    half = wp.float64(0.5) * h
    v = state[1]
    q = state[0] + half * v
    speed = v + half * state[3]
    others = active & ~wp.static(wp.int64(TRAIN_BITS))
    cell = train_cell(active)
    lead = z[cell]
    rate = z[cell + 1]
    output = q - lead - half * rate
    seen = q - g.seen * (q - output)  # by the controller
    seen_speed = speed - g.seen_speed * rate
    weight = pendulum_torque(output, p[4]) + z[wp.static(LOAD_CELL)]
    error = sites.command_in_force(u, seen, seen_speed, state[2], time, h, p, z, others) - seen
    error = sites.error_seen(error, seen, seen_speed, state[2], time, h, p, z, others)
    load = sites.load_torque(weight, output, v - rate, state[2], time, h, p, z, others)
    push = Push()
    push.torque = kp * error
    push.damping = kd
    push.stiffness = kp
    push.seen = g.seen
    push.seen_damping = g.seen_speed * kd
    dry = zero
    if (active & wp.static(wp.int64(MOTOR_BIT))) != wp.int64(0):
        if kp > zero:
            at_start = v - g.seen_speed * rate
            push = drive_push(kp, kd, error, half, at_start, seen_speed, tick, m, z)
            if push.stiffness > zero:  # else what damps is the motor's back-EMF alone
                push.seen = g.seen
                push.seen_damping = g.seen_speed * kd
                if m.line > zero:
                    push.seen_damping = g.seen_speed * (kd - m.line)
            weaker = wp.float64(1.0) / resistance(push, speed, m)
            push.torque *= weaker
            push.damping *= weaker
            push.stiffness *= weaker
            push.seen_damping *= weaker
        dry = gear_friction(speed, push.torque - push.damping * speed, weight, m)
    if kp > zero:
        torque = push.torque - push.damping * speed + push.seen_damping * rate
        # What effects change is explicit: the drive stays implicit, and stable.
        if (others & wp.static(wp.int64(sites.MOTOR_TORQUE_BITS))) != wp.int64(0):
            push.torque += (
                sites.motor_torque(torque, q, speed, torque, time, h, p, z, others) - torque
            )
    direction = speed
    if v == zero:
        direction = wp.float64(1e-9) * wp.sign(push.torque + load)
    dry = sites.friction_bound(
        dry, q, direction, push.torque - push.damping * speed, time, h, p, z, others
    )
    torque = push.torque
    push.torque += push.stiffness * half * (v - push.seen * rate)  # at the start, not the middle
    moved = train_step(wp.vec4d(state[0], v, lead, rate), push, load, dry, h, g)
    z[cell] = moved[2]
    z[cell + 1] = moved[3]
    middle = wp.float64(0.5) * (v + moved[1])
    torque -= push.damping * middle - push.seen_damping * wp.float64(0.5) * (rate + moved[3])
    return wp.vec4d(moved[0], moved[1], torque, (moved[1] - v) / h)
