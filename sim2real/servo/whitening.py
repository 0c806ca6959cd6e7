"""Warp kernels that turn many rollouts into whitened normal equations.

A problem is one joint with one set of effects. Its rollouts are rows of ``angle``: ``rows`` has the
index of that of each of its recordings and variants, the servo itself first, and -1 for absent
ones. Noise that is correlated in time is whitened by an autoregression with coefficients for each
problem, or by a Kalman filter.
"""

import warp as wp

from sim2real.effects.effect import Row, Table

Rows = wp.array(dtype=wp.int32)
Places = wp.array3d(dtype=wp.int32)
Counts = wp.array2d(dtype=wp.int32)


@wp.kernel(enable_backward=False)
def lag_products(
    rows: Places,
    signal: Rows,
    length: Rows,
    counts: Counts,
    angle: Table,
    out: wp.array3d(dtype=wp.float64),
) -> None:
    """Sums of products of each problem's residual at two lags, over samples that count.

    If both lags increase by one, the sums change only where runs of counted samples begin or end.
    """
    problem, separation = wp.tid()
    order = out.shape[1] - 1
    total = wp.float64(0.0)
    for r in range(rows.shape[1]):
        row = rows[problem, r, 0]
        if row < 0:
            continue
        s = signal[row]
        counted = int(0)
        for k in range(order, length[s] + 1):
            counts_now = int(0)
            if k < length[s]:
                counts_now = counts[s, k]
            if counts_now != counted:
                sign = wp.float64(counts_now - counted)
                for i in range(1, order + 1 - separation):
                    out[problem, i, i + separation] += (
                        sign * angle[row, k - i] * angle[row, k - i - separation]
                    )
            if counts_now != 0:
                total += angle[row, k] * angle[row, k - separation]
            counted = counts_now
    for i in range(order + 1 - separation):
        total += out[problem, i, i + separation]
        out[problem, i, i + separation] = total
        out[problem, i + separation, i] = total


@wp.func
def four_before(k: int, x: Row) -> wp.vec4d:
    """The samples at k - 1 to k - 4, the first one in place of those before it."""
    return wp.vec4d(
        x[wp.max(k - 1, 0)], x[wp.max(k - 2, 0)], x[wp.max(k - 3, 0)], x[wp.max(k - 4, 0)]
    )


@wp.kernel(enable_backward=False)
def whiten(
    problem: Rows, signal: Rows, length: Rows, counts: Counts, autoregression: Table, angle: Table
) -> None:
    """Replace every sample by its innovation, 0 where the sample does not count."""
    row = wp.tid()
    s = signal[row]
    x = angle[row]
    a = autoregression[problem[row]]
    order = a.shape[0]
    k = length[s] - 1
    while k >= 0:
        # Four samples at a time, for which a coefficient and a sample are read once.
        e = four_before(k + 1, x)
        past = four_before(k, x)
        for i in range(order):
            e -= a[i] * past
            past = wp.vec4d(past[1], past[2], past[3], x[wp.max(k - 5 - i, 0)])
        for back in range(wp.min(k + 1, 4)):
            j = k - back
            if j < order or counts[s, j] == 0:
                x[j] = wp.float64(0.0)
            else:
                x[j] = e[back]
        k -= 4


@wp.kernel(enable_backward=False)
def whiten_slow(
    signal: Rows,
    length: Rows,
    position: Table,
    weight: Table,
    speed: Table,
    process: Table,
    angle: Table,
    logarithm: Row,
) -> None:
    """Replace weighted samples by innovations under ``SlowErrors``, of variance 1.

    By a Kalman filter of two states; ``logarithm`` sums up those of their variances before. Source:
    Anderson, Moore, Optimal Filtering (Prentice-Hall 1979), section 5.3.
    """
    row = wp.tid()
    s = signal[row]
    first, second, keep, keep_delay = process[s, 0], process[s, 1], process[s, 2], process[s, 3]
    one = wp.float64(1.0)
    error, delay, cross, total = wp.float64(0.0), wp.float64(0.0), wp.float64(0.0), wp.float64(0.0)
    variance, variance_delay = wp.float64(first), wp.float64(second)
    for k in range(length[s]):
        e = wp.float64(0.0)
        if not wp.isnan(position[s, k]):
            w, v = weight[s, k], weight[s, k] * speed[s, k]
            with_error, with_delay = w * variance + v * cross, w * cross + v * variance_delay
            size = w * with_error + v * with_delay + one
            left = angle[row, k] - w * error - v * delay
            e = left / wp.sqrt(size)
            error += with_error / size * left
            delay += with_delay / size * left
            variance -= with_error * with_error / size
            cross -= with_error * with_delay / size
            variance_delay -= with_delay * with_delay / size
            total += wp.log(size)
        angle[row, k] = e
        error *= keep
        delay *= keep_delay
        variance = keep * keep * variance + (one - keep * keep) * first
        cross *= keep * keep_delay
        fresh = one - keep_delay * keep_delay
        variance_delay = keep_delay * keep_delay * variance_delay + fresh * second
    logarithm[row] = total


@wp.kernel(enable_backward=False)
def gram(
    rows: Places,
    signal: Rows,
    length: Rows,
    blocks: int,
    deep: int,
    angle: Table,
    out: wp.array3d(dtype=wp.float64),
) -> None:
    """Inner products of each problem's whitened rows, for each block of its recordings.

    ``out[problem, recording * blocks + block]`` holds the products of row j < deep with row i at
    ``j * V + i``, and those of each row i with itself at ``deep * V + i``.
    """
    problem, block, pair = wp.tid()
    j = pair / rows.shape[2]
    i = pair - j * rows.shape[2]
    if j == deep:
        j = i
    r = block / blocks
    row = rows[problem, r, i]
    other = rows[problem, r, j]
    if row < 0 or other < 0 or j > i:
        return
    count = length[signal[row]]
    part = block - r * blocks
    total = wp.float64(0.0)
    for k in range(part * count / blocks, (part + 1) * count / blocks):
        total += angle[row, k] * angle[other, k]
    out[problem, block, pair] = total
