"""The Warp kernel of a rollout: one servo a thread, its clock stopping at every event."""

from typing import Any

import warp as wp

from sim2real.effects import SIGNATURE
from sim2real.servo.law import (
    SENSOR_BITS,
    Row,
    arrival_time,
    exact_motion,
    measured_angle,
    other_inertia,
    resting_angle,
    substep_of,
)
from sim2real.servo.motor import MOTOR_BIT, read_motor
from sim2real.servo.parameters import HELD_CELL


def _simulating(effects: bool) -> Any:  # noqa: ANN401 - Warp has no stubs
    """The kernel that simulates a servo from rest on its signal's first set-point."""
    substep = substep_of(effects)
    mask = ~MOTOR_BIT if effects else 0

    @wp.kernel(enable_backward=False, module="unique")
    def simulate_servos(
        theta: wp.array2d(dtype=wp.float64),
        active: wp.array(dtype=wp.int32),
        memory: wp.array2d(dtype=wp.float64),
        signal: wp.array(dtype=wp.int32),
        times: wp.array2d(dtype=wp.float64),
        command: wp.array2d(dtype=wp.float64),
        length: wp.array(dtype=wp.int32),
        longest: Row,
        position: wp.array2d(dtype=wp.float64),
    ) -> None:
        _ = wp.static(SIGNATURE)  # Warp's cache does not see the sources of the effects
        row = wp.tid()
        p = theta[row]
        z = memory[row]
        effects = active[row]
        others = effects & wp.static(mask)
        m = read_motor(p)
        t = times[signal[row]]
        sent = command[signal[row]]
        samples = length[signal[row]]
        zero = wp.float64(0.0)
        kp = wp.float64(p[0])
        kd = wp.float64(p[1])
        latency = p[2]
        inertia = wp.float64(p[3])
        inertia += m.rotor
        if others != 0:
            inertia = other_inertia(inertia, zero, zero, zero, zero, zero, p, z, others)
        longest_step = longest[row]
        u = wp.float64(sent[0])
        state = wp.vec4d(resting_angle(u, kp, p[4]), zero, zero, zero)
        state[2] = kp * (u - state[0])
        angle = wp.float64(state[0])
        start = t[0]
        now = wp.float64(start)
        sample = int(0)
        arrival = int(0)
        period = m.period
        looks = wp.float64(start) + m.phase
        z[wp.static(HELD_CELL)] = state[2]
        tick = bool(False)
        ticks = wp.float64(0.0)
        while sample < samples:
            arrives = t[samples - 1] + wp.float64(1.0)
            if arrival < samples:
                arrives = t[arrival] + latency
                if others != 0:
                    number = wp.float64(arrival)
                    since = t[arrival] - start
                    arrives = arrival_time(arrives, number, zero, zero, since, zero, p, z, effects)
                    if wp.isinf(arrives):
                        arrival += 1
                        continue
            until = wp.min(t[sample], arrives)
            if period > zero:
                if now >= looks:
                    tick = True
                    ticks += wp.float64(1.0)
                    looks = start + m.phase + ticks * period
                until = wp.min(until, looks)
            if until > now:
                count = int(wp.ceil((until - now) / longest_step))
                h = (until - now) / wp.float64(count)
                for k in range(count):
                    time = now - start + wp.float64(k) * h
                    look = tick and k == 0
                    state = substep(state, u, time, h, kp, kd, inertia, m, p, z, effects, look)
                    if (others & wp.static(SENSOR_BITS)) != 0:
                        angle = measured_angle(
                            state[0], state[0], state[1], state[2], time, h, p, z, effects
                        )
                now = until
                tick = False
            if arrives <= until:
                u = sent[arrival]
                arrival += 1
                if wp.isnan(u):
                    kp = zero
                    kd = zero
                    u = zero
            elif until == t[sample]:
                if (others & wp.static(SENSOR_BITS)) == 0:
                    angle = state[0]
                elif sample == 0:
                    angle = measured_angle(
                        state[0], state[0], state[1], state[2], zero, zero, p, z, effects
                    )
                position[row, sample] = angle
                sample += 1

    return simulate_servos


simulate_any, simulate_motors = _simulating(True), _simulating(False)
"""Kernels for servos with and without effects; see ``rollout.rollout``. The second is faster."""


@wp.kernel(enable_backward=False)
def solve_servos(
    theta: wp.array2d(dtype=wp.float64),
    signal: wp.array(dtype=wp.int32),
    times: wp.array2d(dtype=wp.float64),
    command: wp.array2d(dtype=wp.float64),
    length: wp.array(dtype=wp.int32),
    position: wp.array2d(dtype=wp.float64),
) -> None:
    """The same of a servo that is linear, with no effect and no pendulum: exact between events."""
    row = wp.tid()
    p = theta[row]
    t = times[signal[row]]
    sent = command[signal[row]]
    samples = length[signal[row]]
    zero = wp.float64(0.0)
    kp = wp.float64(p[0])
    kd = wp.float64(p[1])
    u = wp.float64(sent[0])
    state = wp.vec4d(u, zero, zero, zero)
    now = wp.float64(t[0])
    sample = int(0)
    arrival = int(1)
    while sample < samples:
        if arrival < samples and sent[arrival] == sent[arrival - 1]:
            arrival += 1  # it changes nothing
            continue
        until = wp.float64(t[sample])
        arrived = int(0)
        if arrival < samples and t[arrival] + p[2] <= until:
            until = t[arrival] + p[2]
            arrived = int(1)
        if until > now:
            state = exact_motion(state, u, until - now, kp, kd, p[3])
            now = until
        if arrived == 1:
            u = sent[arrival]
            arrival += 1
            if wp.isnan(u):
                kp = zero
                kd = zero
                u = zero
        else:
            position[row, sample] = state[0]
            sample += 1
