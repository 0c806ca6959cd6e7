"""The Warp kernels of a rollout: event-driven integration, with one or two servos per thread."""

from typing import Any

import warp as wp

from sim2real.effects import SIGNATURE
from sim2real.effects.effect import F, Row, Table
from sim2real.servo.effect_chain import FOLLOWING_BITS, arrival_time, measured_angle, shaft_inertia
from sim2real.servo.gear_train import TRAIN_BITS, Train, sensed, train_at_rest, train_of
from sim2real.servo.law import resting_angle, substep_of
from sim2real.servo.motor import MOTOR_BIT, read_motor
from sim2real.servo.parameters import BASE, COLUMNS, HELD_CELL, LOAD_CELL, LOOP

_CLOCK = [COLUMNS.index(name) for name in (BASE[2], *LOOP)]
"""Columns that determine when set-points take effect and when the controller samples."""

_LEAST_SIDE = wp.constant(wp.float64(0.02))
"""Smallest share of the inertia on either side of a gear train."""
_LEAST_LINK = wp.constant(wp.float64(5e-4))
"""The same for a load that varies: the last links of an arm are much lighter than the rotors."""


@wp.func
def at_rest(u: F, kp: F, p: Row, torque: F) -> wp.vec4d:
    """State of a servo at rest at its first set-point, under a load's torque."""
    zero = wp.float64(0.0)
    q = resting_angle(u, kp, p[4], torque)
    return wp.vec4d(q, zero, kp * (u - q), zero)


@wp.func
def displaced(state: wp.vec4d, by: F, kp: F) -> wp.vec4d:
    """A state at rest, held by friction at another angle."""
    return state + wp.vec4d(by, wp.float64(0.0), -kp * by, wp.float64(0.0))


@wp.func
def load_at(time: F, signal: int, grid: Table, varying: wp.array3d(dtype=F)) -> wp.vec2d:
    """Inertia in kg m2 beyond the mean and torque in N m of a load that varies with time."""
    last = grid[signal, 2] - wp.float64(1.0)
    place = wp.clamp((time + grid[signal, 0]) / grid[signal, 1], wp.float64(0.0), last)
    before = wp.min(int(place), int(last) - 1)
    share = place - wp.float64(before)
    inertia = wp.lerp(varying[signal, before, 0], varying[signal, before + 1, 0], share)
    torque = wp.lerp(varying[signal, before, 1], varying[signal, before + 1, 1], share)
    return wp.vec2d(inertia, torque)


@wp.func
def measured(state: wp.vec4d, time: F, h: F, p: Row, z: Row, active: wp.int64) -> F:
    """Measured angle at the end of a sub-step."""
    q = sensed(state[0], p, z, active)
    rest = active & ~wp.static(wp.int64(TRAIN_BITS))
    return measured_angle(q, q, state[1], state[2], time, h, p, z, rest)


@wp.func
def _same_events(
    row: int, other: int, theta: Table, signal: wp.array(dtype=wp.int32), longest: Row
) -> bool:
    """Whether two rows without effects have the same events and the same sub-steps between them."""
    if signal[row] != signal[other] or longest[row] != longest[other]:
        return False
    for k in range(wp.static(len(_CLOCK))):
        if theta[row, wp.static(_CLOCK[k])] != theta[other, wp.static(_CLOCK[k])]:
            return False
    return True


def _simulating(effects: bool, pairs: bool) -> Any:  # noqa: ANN401 - Warp has no stubs
    """The kernel that simulates servos from rest on their first set-point, or where they are seen.

    A thread simulates ``together`` of the rows in ``order``. With ``pairs``, and without effects,
    it simulates two rows with the same events at once: a core can execute the dependency chains of
    two short sub-steps in parallel. A sub-step with effects is too long for that, and is inlined
    only where it is called once.
    """
    substep = substep_of(effects)
    mask = ~MOTOR_BIT if effects else 0

    @wp.kernel(enable_backward=False, module="unique")
    def simulate_servos(
        theta: Table,
        active: wp.array(dtype=wp.int64),
        memory: Table,
        signal: wp.array(dtype=wp.int32),
        order: wp.array(dtype=wp.int32),
        together: int,
        times: Table,
        command: Table,
        length: wp.array(dtype=wp.int32),
        grid: Table,
        varying: wp.array3d(dtype=F),
        longest: Row,
        position: Table,
    ) -> None:
        _ = wp.static(SIGNATURE)  # Warp's cache does not see the sources of the effects
        place = int(wp.tid() * together)
        end = wp.min(place + together, order.shape[0])
        while place < end:
            row = order[place]
            place += 1
            paired = bool(False)
            if wp.static(pairs) and place < end:
                paired = _same_events(row, order[place], theta, signal, longest)
            row_b = int(row)
            if paired:
                row_b = order[place]
                place += 1
            p = theta[row]
            p_b = theta[row_b]
            z = memory[row]
            z_b = memory[row_b]
            effects = active[row]
            effects_b = active[row_b]
            others = effects & wp.static(wp.int64(mask))
            m = read_motor(p)
            m_b = read_motor(p_b)
            t = times[signal[row]]
            sent = command[signal[row]]
            samples = length[signal[row]]
            zero = wp.float64(0.0)
            kp = wp.float64(p[0])
            kd = wp.float64(p[1])
            kp_b = wp.float64(p_b[0])
            kd_b = wp.float64(p_b[1])
            latency = p[2]
            inertia = shaft_inertia(p[3], p, z, others)
            inertia_b = shaft_inertia(p_b[3], p_b, z_b, wp.int64(0))
            per_longest = wp.float64(1.0) / longest[row]
            total = wp.float64(inertia)
            total_b = wp.float64(inertia_b)
            varies = grid[signal[row], 1] > zero
            if varies:
                torque = load_at(zero, signal[row], grid, varying)[1]
                z[wp.static(LOAD_CELL)] = torque
                z_b[wp.static(LOAD_CELL)] = torque
            u = wp.float64(sent[0])
            state = at_rest(u, kp, p, z[wp.static(LOAD_CELL)])
            state_b = at_rest(u, kp_b, p_b, z_b[wp.static(LOAD_CELL)])
            g = Train()
            if (others & wp.static(wp.int64(TRAIN_BITS))) != wp.int64(0):
                g = train_of(inertia, p, _LEAST_SIDE)
                state = train_at_rest(state, u, kp, p, z, others)
            begin = grid[signal[row], 3]
            if not wp.isnan(begin):
                z[wp.static(HELD_CELL)] = state[2]
                begin -= measured(state, zero, zero, p, z, others)
                state = displaced(state, begin, kp)
                state_b = displaced(state_b, grid[signal[row], 3] - state_b[0], kp_b)
            angle = wp.float64(state[0])
            following = others & wp.static(wp.int64(FOLLOWING_BITS))
            start = t[0]
            clock = wp.float64(start)
            sample = int(0)
            arrival = int(0)
            period = m.period
            next_tick = wp.float64(start) + m.phase
            z[wp.static(HELD_CELL)] = state[2]
            z_b[wp.static(HELD_CELL)] = state_b[2]
            tick = bool(False)
            ticks = wp.float64(0.0)
            while sample < samples:
                arrives = t[samples - 1] + wp.float64(1.0)
                if arrival < samples:
                    arrives = t[arrival] + latency
                    if others != wp.int64(0):
                        number = wp.float64(arrival)
                        since = t[arrival] - start
                        arrives = arrival_time(
                            arrives, number, zero, zero, since, zero, p, z, effects
                        )
                        if wp.isinf(arrives):
                            arrival += 1
                            continue
                until = wp.min(t[sample], arrives)
                if period > zero:
                    if clock >= next_tick:
                        tick = True
                        ticks += wp.float64(1.0)
                        next_tick = start + m.phase + ticks * period
                    until = wp.min(until, next_tick)
                if until > clock:
                    h = until - clock
                    count = int(wp.ceil(h * per_longest))
                    if count > 1:
                        h = h / wp.float64(count)
                    for k in range(count):
                        time = clock - start + wp.float64(k) * h
                        ticking = tick and k == 0
                        if varies:
                            middle = time + wp.float64(0.5) * h
                            load = load_at(middle, signal[row], grid, varying)
                            z[wp.static(LOAD_CELL)] = load[1]
                            z_b[wp.static(LOAD_CELL)] = load[1]
                            total = wp.max(inertia + load[0], wp.float64(0.05) * inertia)
                            total_b = wp.max(inertia_b + load[0], wp.float64(0.05) * inertia_b)
                            if (others & wp.static(wp.int64(TRAIN_BITS))) != wp.int64(0):
                                g = train_of(total, p, _LEAST_LINK)
                        state = substep(
                            state, u, time, h, kp, kd, total, g, m, p, z, effects, ticking
                        )
                        if paired:
                            state_b = substep(
                                state_b, u, time, h, kp_b, kd_b, total_b, g, m_b, p_b, z_b,
                                effects_b, ticking,
                            )  # fmt: skip
                        elif following != wp.int64(0):
                            angle = measured(state, time, h, p, z, effects)
                    clock = until
                    tick = False
                if arrives <= until:
                    u = sent[arrival]
                    arrival += 1
                    if wp.isnan(u):
                        kp = zero
                        kd = zero
                        kp_b = zero
                        kd_b = zero
                        u = zero
                elif until == t[sample]:
                    if sample == 0 or following == wp.int64(0):
                        angle = measured(state, clock - start, zero, p, z, others)
                    position[row, sample] = angle
                    if paired:
                        position[row_b, sample] = state_b[0]
                    sample += 1

    return simulate_servos


KERNELS = {
    (effects, pairs): _simulating(effects, pairs)
    for effects, pairs in ((False, False), (False, True), (True, False))
}
"""Kernels by whether servos may have effects and whether they are simulated in pairs."""
