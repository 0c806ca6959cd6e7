"""Types of NumPy arrays, named by what they hold; a docstring gives each one's shape."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Array32 = NDArray[np.float32]
Mask = NDArray[np.bool_]
Index = NDArray[np.intp]
Integers = NDArray[np.int32]
Picture = NDArray[np.uint8]
"""Pixels, rows from the top, shape (height, width, 3) or (height, width)."""
