"""Kernels of the event filter: many hypotheses of which set-point was in force, each filtered.

The state of a joint is the deviation of its angle in rad, its speed, the delay of the last
set-point in s, and the deviations at the last samples, one for each coefficient of the
autoregression of the noise and one more where they are smoothed. A covariance (n, n) is stored by
rows, with its product with the observation after it.
"""

import warp as wp

PRUNED = wp.constant(20.0)
"""Log-likelihood by which a hypothesis may be below the likeliest."""
SAME_RAD = wp.constant(1e-9)
"""Difference below which two set-points are one."""
COUNTS = 4
"""Counts along a history: set-points after one that arrived, losses among them, set-points after a
lost one, losses among them."""

Vector = wp.array(dtype=wp.float64)
Matrix = wp.array2d(dtype=wp.float64)
Cube = wp.array3d(dtype=wp.float64)
Whole = wp.array(dtype=wp.int32)
Wholes = wp.array3d(dtype=wp.int32)


@wp.func
def _propagate(
    x: Matrix, P: Matrix, m: int, j: int, n: int, F: Matrix, i: int, below: wp.float64, spread: int
):
    """Move joint ``j`` of hypothesis ``m`` on; ``below``: set-point too low by, in rad."""
    a = j * n
    e = x[m, a]
    v = x[m, a + 1]
    x[m, a] = F[i, 0] * e + F[i, 1] * v + F[i, 4] * below
    x[m, a + 1] = F[i, 2] * e + F[i, 3] * v + F[i, 5] * below
    if spread > 0:
        b = j * n * (n + 1)
        for c in range(n):
            e = P[m, b + c]
            v = P[m, b + n + c]
            P[m, b + c] = F[i, 0] * e + F[i, 1] * v
            P[m, b + n + c] = F[i, 2] * e + F[i, 3] * v
        for c in range(n):
            e = P[m, b + c * n]
            v = P[m, b + c * n + 1]
            P[m, b + c * n] = F[i, 0] * e + F[i, 1] * v
            P[m, b + c * n + 1] = F[i, 2] * e + F[i, 3] * v


@wp.func
def _observe(
    x: Matrix, P: Matrix, m: int, j: int, n: int, model: Matrix, channel: int,
    innovation: wp.float64, sd: wp.float64, spread: int,
):  # fmt: skip
    """Update by a sample; its log-likelihood."""
    a = j * n
    error = innovation - x[m, a]
    for c in range(3, n):
        error += model[channel, c - 3] * x[m, a + c]
    variance = sd * sd
    if spread > 0:
        b = j * n * (n + 1)
        k = b + n * n  # covariance of the state with the predicted innovation
        for c in range(n):
            P[m, k + c] = P[m, b + c]
            for d in range(3, n):
                P[m, k + c] = P[m, k + c] - model[channel, d - 3] * P[m, b + d * n + c]
        variance += P[m, k]
        for d in range(3, n):
            variance -= model[channel, d - 3] * P[m, k + d]
        for c in range(n):
            weight = P[m, k + c] / variance
            x[m, a + c] = x[m, a + c] + weight * error
            for d in range(n):
                P[m, b + c * n + d] = P[m, b + c * n + d] - weight * P[m, k + d]
    return wp.float64(-0.5) * (wp.log(variance) + error * error / variance)


@wp.func
def _remember(x: Matrix, P: Matrix, m: int, j: int, n: int, spread: int):
    """Shift the deviations at the last samples by one."""
    a = j * n
    for c in range(n - 4):
        x[m, a + n - 1 - c] = x[m, a + n - 2 - c]
    x[m, a + 3] = x[m, a]
    if spread > 0:
        b = j * n * (n + 1)
        for c in range(n - 4):
            r = n - 1 - c
            for d in range(n):
                P[m, b + r * n + d] = P[m, b + (r - 1) * n + d]
        for d in range(n):
            P[m, b + 3 * n + d] = P[m, b + d]
        for d in range(n):
            for c in range(n - 4):
                r = n - 1 - c
                P[m, b + d * n + r] = P[m, b + d * n + r - 1]
            P[m, b + d * n + 3] = P[m, b + d * n]


@wp.func
def _delay(
    x: Matrix, P: Matrix, m: int, j: int, n: int, k: int, sd: wp.float64, correlation: wp.float64,
    kick: wp.float64,
):  # fmt: skip
    """A set-point takes effect: its delay, and the speed that this adds, ``kick`` per s."""
    a = j * n
    b = j * n * (n + 1)
    keep = wp.where(k == 0, wp.float64(0.0), correlation)
    x[m, a + 2] = keep * x[m, a + 2]
    for c in range(n):
        P[m, b + 2 * n + c] = keep * P[m, b + 2 * n + c]
    for c in range(n):
        P[m, b + c * n + 2] = keep * P[m, b + c * n + 2]
    P[m, b + 2 * n + 2] = P[m, b + 2 * n + 2] + (wp.float64(1.0) - keep * keep) * sd * sd
    x[m, a + 1] = x[m, a + 1] + kick * x[m, a + 2]
    for c in range(n):
        P[m, b + n + c] = P[m, b + n + c] + kick * P[m, b + 2 * n + c]
    for c in range(n):
        P[m, b + c * n + 1] = P[m, b + c * n + 1] + kick * P[m, b + c * n + 2]


@wp.kernel(enable_backward=False)
def run_filter(
    first: Whole, slots: Whole, start: Whole, command: Vector, within: Matrix, tail: Matrix,
    samples: Whole, innovation: Vector, noise: Vector, model: Matrix, gain: Vector, rates: Matrix,
    width: int, states: Cube, covariances: Cube, sums: Cube, marks: Wholes,
    history: wp.array4d(dtype=wp.int32), tolerance: Matrix, value: Matrix, counts: Cube,
    active: Wholes,
):  # fmt: skip
    """Filter one group of channels under one model of arrivals.

    ``sums`` of a hypothesis: log-likelihood, counts. ``marks``: the set-point
    in force, and the hypothesis that it came from. The first ``width`` places hold what is kept.
    """
    s, g = wp.tid()
    G = slots.shape[0]
    th = s * G + g
    x = states[th]
    P = covariances[th]
    w = sums[th]
    mark = marks[th]
    past = history[th]
    n = model.shape[1] + 3
    J = first[g + 1] - first[g]
    spread = int(0)
    if rates[s, 2] > wp.float64(0.0):
        spread = int(1)
    kept = int(1)
    for k in range(slots[g]):
        made = int(width)
        best = wp.float64(-1.0e300)
        for m in range(kept):
            old = mark[m, 0]
            lost_before = wp.min(k - 1 - old, 1)
            if k == 0:
                lost_before = 0
            loss = rates[s, lost_before]
            differs = int(0)
            for j in range(J):
                at = start[first[g] + j]
                if wp.abs(command[at + k] - command[at + old]) > wp.float64(SAME_RAD):
                    differs = int(1)
            for lost in range(2):
                probability = wp.where(lost == 1, loss, wp.float64(1.0) - loss)
                if differs == 0:  # nothing shows whether it arrived
                    probability = wp.where(lost == 1, wp.float64(0.0), wp.float64(1.0))
                score = w[m, 0] + wp.log(wp.max(probability, wp.float64(1.0e-300)))
                if probability > wp.float64(0.0) and score > best - wp.float64(PRUNED):
                    c = int(made)
                    made += 1
                    new = int(k)
                    if lost > 0:
                        new = old
                    for d in range(1, w.shape[1]):
                        w[c, d] = w[m, d]
                    if differs > 0:
                        chance = 1 + 2 * lost_before
                        w[c, chance] = w[c, chance] + wp.float64(1.0)
                        w[c, chance + 1] = w[c, chance + 1] + wp.where(
                            lost == 1, wp.float64(1.0), wp.float64(0.0)
                        )
                    for j in range(J):
                        channel = first[g] + j
                        at = start[channel]
                        for d in range(n):
                            x[c, j * n + d] = x[m, j * n + d]
                        if spread > 0:
                            b = j * n * (n + 1)
                            for d in range(n * n):
                                P[c, b + d] = P[m, b + d]
                            kick = gain[channel] * (command[at + new] - command[at + old])
                            _delay(x, P, c, j, n, k, rates[s, 2], rates[s, 3], kick)
                        below = command[at + k] - command[at + new]
                        for i in range(samples[at + channel + k], samples[at + channel + k + 1]):
                            _propagate(x, P, c, j, n, within, i, below, spread)
                            if noise[i] > wp.float64(0.0):
                                score += _observe(
                                    x, P, c, j, n, model, channel, innovation[i], noise[i], spread
                                )
                            _remember(x, P, c, j, n, spread)
                        _propagate(x, P, c, j, n, tail, at + k, below, spread)
                    w[c, 0] = score
                    mark[c, 0] = new
                    mark[c, 1] = m
                    best = wp.max(best, score)
        # Keep the likeliest, and merge those that are alike.
        kept = int(0)
        more = int(1)
        while more > 0 and kept < width:
            c = int(width)
            for d in range(width, made):
                if w[d, 0] > w[c, 0]:
                    c = int(d)
            if w[c, 0] < best - wp.float64(PRUNED):
                more = int(0)
            else:
                twin = int(-1)
                for d in range(kept):
                    alike = int(1)
                    for j in range(J):
                        channel = first[g] + j
                        at = start[channel]
                        step = command[at + mark[d, 0]] - command[at + mark[c, 0]]
                        if wp.abs(step) > wp.float64(SAME_RAD):
                            alike = int(0)
                        for q in range(n):
                            size = tolerance[channel, wp.where(q == 1, 1, 0)]
                            if q != 2 and wp.abs(x[d, j * n + q] - x[c, j * n + q]) > size:
                                alike = int(0)
                    if alike > 0 and twin < 0:
                        twin = int(d)
                if twin >= 0:
                    share = wp.float64(1.0) / (wp.float64(1.0) + wp.exp(w[c, 0] - w[twin, 0]))
                    w[twin, 0] = w[twin, 0] - wp.log(share)
                    for d in range(1, w.shape[1]):
                        w[twin, d] = share * w[twin, d] + (wp.float64(1.0) - share) * w[c, d]
                else:
                    for d in range(w.shape[1]):
                        w[kept, d] = w[c, d]
                    for d in range(J * n):
                        x[kept, d] = x[c, d]
                    if spread > 0:
                        for d in range(J * n * (n + 1)):
                            P[kept, d] = P[c, d]
                    mark[kept, 0] = mark[c, 0]
                    past[k, kept, 0] = mark[c, 0]
                    past[k, kept, 1] = mark[c, 1]
                    kept += 1
                w[c, 0] = wp.float64(-1.0e300)
    # Sum over what is kept; the likeliest history, backwards.
    top = wp.float64(-1.0e300)
    m = int(0)
    for d in range(kept):
        if w[d, 0] > top:
            top = w[d, 0]
            m = int(d)
    total = wp.float64(0.0)
    for d in range(kept):
        total += wp.exp(w[d, 0] - top)
    value[s, g] = top + wp.log(total)
    for d in range(kept):
        for q in range(1, w.shape[1]):
            share = wp.exp(w[d, 0] - top) / total
            counts[s, g, q - 1] = counts[s, g, q - 1] + share * w[d, q]
    for back in range(slots[g]):
        k = slots[g] - 1 - back
        active[s, g, k] = past[k, m, 0]
        m = past[k, m, 1]


@wp.kernel(enable_backward=False)
def expect(
    first: Whole, slots: Whole, start: Whole, command: Vector, within: Matrix, tail: Matrix,
    samples: Whole, innovation: Vector, noise: Vector, model: Matrix, gain: Vector,
    path: wp.array2d(dtype=wp.int32), rest: Whole, p: int, delay_sd_s: wp.float64,
    correlation: wp.float64, states: Cube, covariances: Cube, mean: Vector, sums: Cube,
):  # fmt: skip
    """Smooth one channel along its group's path."""
    channel = wp.tid()
    g = int(0)
    while first[g + 1] <= channel:
        g += 1
    at = start[channel]
    x = states[channel]
    P = covariances[channel]
    n = model.shape[1] + 3
    behind = model.shape[1] - p - 1
    for k in range(slots[g]):
        new = path[g, k]
        kick = gain[channel] * (command[at + new] - command[at + path[g, wp.max(k - 1, 0)]])
        _delay(x, P, 0, 0, n, k, delay_sd_s, correlation, kick)
        below = command[at + k] - command[at + new]
        for i in range(samples[at + channel + k], samples[at + channel + k + 1]):
            _propagate(x, P, 0, 0, n, within, i, below, 1)
            if noise[i] > wp.float64(0.0):
                _observe(x, P, 0, 0, n, model, channel, innovation[i], noise[i], 1)
            _remember(x, P, 0, 0, n, 1)
            mean[i] = x[0, 2]
            for d in range(wp.min(i - at, behind) + 1):
                mean[i - d] = x[0, 3 + d]
            back = i - behind
            if back >= at + p and noise[wp.max(back, at)] > wp.float64(0.0):
                for c in range(p + 1):
                    for d in range(p + 1):
                        q = (3 + behind + c) * n + 3 + behind + d
                        sums[channel, rest[back], c * (p + 1) + d] = (
                            sums[channel, rest[back], c * (p + 1) + d] + P[0, q]
                        )
        _propagate(x, P, 0, 0, n, tail, at + k, below, 1)
