"""Types in the signatures of Warp functions, such as the terms of effects."""

import warp as wp

F = wp.float64
"""A number."""
Row = wp.array(dtype=wp.float64)
"""A row of numbers: a joint's parameters or its memory."""
Table = wp.array2d(dtype=wp.float64)
"""A row of numbers for each rollout."""
