"""Warp kernels that turn many rollouts into whitened normal equations.

A problem is one joint with one set of effects. Its rollouts are rows of ``angle``: for each of its
recordings the servo itself and then V - 1 variants of it. Noise that is correlated in time is
whitened by an autoregression with coefficients for each problem, or by a Kalman filter.
"""

from __future__ import annotations

import warp as wp

from sim2real.effects.effect import Row, Table

Rows = wp.array(dtype=wp.int32)


@wp.kernel(enable_backward=False)
def expand(
    theta: Table, variant: Rows, signal: Rows, factor: Table, offset: Table, out: Table
) -> None:
    """Copy the parameters of its variant to each row, in the context of its recording."""
    row = wp.tid()
    for k in range(out.shape[1]):
        out[row, k] = theta[variant[row], k] * factor[signal[row], k] + offset[signal[row], k]


@wp.kernel(enable_backward=False)
def difference(
    base: Rows, signal: Rows, length: Rows, weight: Table, scale: Row, angle: Table
) -> None:
    """Replace the angles of variants by their scaled and weighted differences from their servo."""
    row = wp.tid()
    if base[row] != row:
        for k in range(length[signal[row]]):
            change = (angle[row, k] - angle[base[row], k]) * scale[row]
            angle[row, k] = change * weight[signal[row], k]


@wp.kernel(enable_backward=False)
def residual(
    base: Rows, signal: Rows, length: Rows, weight: Table, position: Table, angle: Table
) -> None:
    """Replace the angles of servos by weighted simulated minus measured ones, 0 where missing."""
    row = wp.tid()
    if base[row] == row:
        for k in range(length[signal[row]]):
            measured = position[signal[row], k]
            if wp.isnan(measured):
                angle[row, k] = wp.float64(0.0)
            else:
                angle[row, k] = (angle[row, k] - measured) * weight[signal[row], k]


@wp.kernel(enable_backward=False)
def lag_products(
    first: Rows,
    recordings: Rows,
    variants: Rows,
    signal: Rows,
    length: Rows,
    counts: wp.array2d(dtype=wp.int32),
    angle: Table,
    out: wp.array3d(dtype=wp.float64),
) -> None:
    """Sums of products of each problem's residual at two lags, over samples that count.

    If both lags increase by one, the sums change only where runs of counted samples begin or end.
    """
    problem, separation = wp.tid()
    order = out.shape[1] - 1
    total = wp.float64(0.0)
    for r in range(recordings[problem]):
        row = first[problem] + r * variants[problem]
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
    problem: Rows,
    signal: Rows,
    length: Rows,
    counts: wp.array2d(dtype=wp.int32),
    autoregression: Table,
    angle: Table,
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
    first: Rows,
    recordings: Rows,
    variants: Rows,
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
    variant_count = variants[problem]
    widest = out.shape[2] / (deep + 1)
    j = pair / widest
    i = pair - j * widest
    if j == deep:
        j = i
    r = block / blocks
    if i >= variant_count or j > i or r >= recordings[problem]:
        return
    row = first[problem] + r * variant_count
    count = length[signal[row]]
    part = block - r * blocks
    total = wp.float64(0.0)
    for k in range(part * count / blocks, (part + 1) * count / blocks):
        total += angle[row + i, k] * angle[row + j, k]
    out[problem, block, pair] = total
