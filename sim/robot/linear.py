"""Small symmetric positive definite systems, one for each robot, in place in ``Motion``."""

import warp as wp

from sim.robot.chain import Motion


@wp.func
def factorise(e: int, first: int, size: int, s: Motion) -> int:
    """Cholesky factor of rows ``first`` to ``size``, in place, below the diagonal."""
    for i in range(first, size):
        for j in range(first, i + 1):
            x = s.A[e, i, j]
            for k in range(first, j):
                x -= s.A[e, i, k] * s.A[e, j, k]
            if i == j:
                s.A[e, i, i] = wp.sqrt(x)
            else:
                s.A[e, i, j] = x / s.A[e, j, j]
    return 0


@wp.func
def solve(e: int, size: int, s: Motion) -> int:
    """Replace b by the solution."""
    for i in range(size):
        x = s.b[e, i]
        for k in range(i):
            x -= s.A[e, i, k] * s.b[e, k]
        s.b[e, i] = x / s.A[e, i, i]
    for r in range(size):
        i = size - 1 - r
        x = s.b[e, i]
        for k in range(i + 1, size):
            x -= s.A[e, k, i] * s.b[e, k]
        s.b[e, i] = x / s.A[e, i, i]
    return 0


@wp.func
def response(e: int, column: int, size: int, s: Motion) -> int:
    """Column of the inverse, into ``inverse``."""
    for i in range(size):
        x = wp.float64(0.0)
        if i == column:
            x = wp.float64(1.0)
        for k in range(i):
            x -= s.A[e, i, k] * s.inverse[e, column, k]
        s.inverse[e, column, i] = x / s.A[e, i, i]
    for r in range(size):
        i = size - 1 - r
        x = s.inverse[e, column, i]
        for k in range(i + 1, size):
            x -= s.A[e, k, i] * s.inverse[e, column, k]
        s.inverse[e, column, i] = x / s.A[e, i, i]
    return 0
