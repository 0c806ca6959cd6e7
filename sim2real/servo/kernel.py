"""The Warp kernel of a rollout: one servo a thread, its clock stopping at every event."""

import warp as wp

from sim2real.servo.law import Row, measured_angle, resting_angle, shaft_inertia, substep


@wp.kernel(enable_backward=False)
def simulate_servos(
    theta: wp.array2d(dtype=wp.float64),
    active: wp.array(dtype=wp.int32),
    t: Row,
    command: wp.array2d(dtype=wp.float64),
    offset: int,
    steps_per_radian: wp.float64,
    longest: wp.float64,
    position: wp.array2d(dtype=wp.float64),
) -> None:
    """Simulate one servo from rest on its first set-point; see ``rollout.rollout``."""
    row = wp.tid()
    p = theta[row]
    effects = active[row]
    sent = command[(row + offset) % command.shape[0]]
    samples = t.shape[0]
    kp = wp.float64(p[0])
    kd = wp.float64(p[1])
    latency = p[2]
    inertia = shaft_inertia(p, effects)
    fastest = wp.max(wp.sqrt(wp.abs(kp) / inertia), wp.float64(0.5) * kd / inertia)
    steps = steps_per_radian
    if effects != 0:
        steps *= wp.float64(2.0)
    longest_step = wp.min(longest, wp.float64(1.0) / (steps * fastest))
    u = wp.float64(sent[0])
    state = wp.vec2d(resting_angle(u, kp, p[4]), wp.float64(0.0))
    now = wp.float64(t[0])
    sample = int(0)
    arrival = int(0)
    while sample < samples:
        arrives = t[samples - 1] + wp.float64(1.0)
        if arrival < samples:
            arrives = t[arrival] + latency
        until = wp.min(t[sample], arrives)
        if until > now:
            count = int(wp.ceil((until - now) / longest_step))
            h = (until - now) / wp.float64(count)
            for _ in range(count):
                state = substep(state, u, h, kp, kd, inertia, p, effects)
            now = until
        if arrives <= until:
            u = sent[arrival]
            arrival += 1
            if wp.isnan(u):
                kp = wp.float64(0.0)
                kd = wp.float64(0.0)
                u = wp.float64(0.0)
        else:
            position[row, sample] = measured_angle(state[0], state[1], p, effects)
            sample += 1
