"""Types in the signatures of effects' terms, which are Warp functions."""

import warp as wp

F = wp.float64
"""A number."""
Row = wp.array(dtype=wp.float64)
"""A row of numbers: a joint's parameters or its memory."""
