"""Warp kernels: a plain PD servo solved exactly between events, and innovations of any servo.

With no effects and no pendulum the servo is linear and the set-point piecewise constant, so that

    y'' + 2 a y' + w^2 y = 0,   y = q - u,   2 a = kd / I,   w^2 = kp / I

has a closed form over each interval between a sample and an arriving set-point. Nothing is cut
into sub-steps; latency stays any real number of seconds. Source: the matrix exponential of a second
order system, Astrom and Wittenmark, Computer-Controlled Systems (Prentice Hall, 1997), ch. 2.
"""

# Warp compiles this and checks its types itself; int(0) is how it declares a variable.
# mypy: ignore-errors
# ruff: noqa: UP018

from __future__ import annotations

import warp as wp

from sim2real.servo.law import Row

Table = wp.array2d(dtype=wp.float64)


@wp.func
def free_motion(a: wp.float64, w2: wp.float64, h: wp.float64) -> wp.vec2d:
    """Decaying cosine and sine of y'' + 2 a y' + w2 y = 0 after h seconds: C and S.

    y(h) = (C + a S) y(0) + S y'(0), whatever the damping.
    """
    s2 = a * a - w2
    if s2 < wp.float64(0.0):
        w = wp.sqrt(-s2)
        decay = wp.exp(-a * h)
        return wp.vec2d(decay * wp.cos(w * h), decay * wp.sin(w * h) / w)
    s = wp.sqrt(s2)
    if s * h < wp.float64(1e-4):
        decay = wp.exp(-a * h)
        return wp.vec2d(decay, decay * h)
    slow = wp.exp(-w2 / (a + s) * h)  # a - s, without cancellation
    fast = wp.exp(-(a + s) * h)
    return wp.vec2d(wp.float64(0.5) * (slow + fast), wp.float64(0.5) * (slow - fast) / s)


@wp.kernel(enable_backward=False)
def plain_servos(
    servo: Table,
    signals: int,
    inertia: Row,
    t: Table,
    length: wp.array(dtype=wp.int32),
    change_t: Table,
    change_u: Table,
    changes: wp.array(dtype=wp.int32),
    angle: Table,
) -> None:
    """Angles of servos (kp, kd, latency) at rest on each signal's first set-point at first.

    ``change_t`` and ``change_u`` hold each signal's first set-point and then those that differ from
    the one before.
    """
    row = wp.tid()
    s = row % signals
    b = row / signals
    a = wp.float64(0.5) * servo[b, 1] / inertia[s]
    w2 = servo[b, 0] / inertia[s]
    u = wp.float64(change_u[s, 0])
    q = wp.float64(u)
    v = wp.float64(0.0)
    now = wp.float64(t[s, 0])
    sample = int(0)
    change = int(1)
    while sample < length[s]:
        until = t[s, sample]
        arrived = int(0)
        if change < changes[s]:
            arrives = change_t[s, change] + servo[b, 2]
            if arrives <= until:
                until = arrives
                arrived = int(1)
        if until > now:
            free = free_motion(a, w2, until - now)
            y = q - u
            q = u + (free[0] + a * free[1]) * y + free[1] * v
            v = (free[0] - a * free[1]) * v - w2 * free[1] * y
            now = until
        if arrived == 1:
            u = change_u[s, change]
            change += 1
        else:
            angle[row, sample] = q
            sample += 1


@wp.kernel(enable_backward=False)
def innovation_energy(
    signals: int,
    lags: int,
    length: wp.array(dtype=wp.int32),
    position: Table,
    counts: wp.array2d(dtype=wp.int32),
    autoregression: Row,
    angle: Table,
    energy: Row,
) -> None:
    """Sum of squared innovations of simulated minus measured angles, over the samples that count.

    As ``servo.whitening`` does it. Coefficients come in fours, so that four sums go at once; those
    beyond the first ``lags`` are 0.
    """
    row = wp.tid()
    s = row % signals
    for k in range(length[s]):
        measured = position[s, k]
        if wp.isnan(measured):
            angle[row, k] = wp.float64(0.0)
        else:
            angle[row, k] = angle[row, k] - measured
    total = wp.float64(0.0)
    order = autoregression.shape[0]
    for k in range(lags, length[s]):
        if counts[s, k] != 0:
            x0 = angle[row, k]
            x1 = wp.float64(0.0)
            x2 = wp.float64(0.0)
            x3 = wp.float64(0.0)
            for i in range(0, order, 4):
                x0 -= autoregression[i] * angle[row, k - 1 - i]
                x1 -= autoregression[i + 1] * angle[row, wp.max(k - 2 - i, 0)]
                x2 -= autoregression[i + 2] * angle[row, wp.max(k - 3 - i, 0)]
                x3 -= autoregression[i + 3] * angle[row, wp.max(k - 4 - i, 0)]
            e = x0 + x1 + x2 + x3
            total += e * e
    energy[row] = total
