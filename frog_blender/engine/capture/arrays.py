"""Types of numpy arrays; docstrings give their shapes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Bools = NDArray[np.bool_]
Ints = NDArray[np.int64]
Float32s = NDArray[np.float32]
Float64s = NDArray[np.float64]
Floats = Float32s | Float64s
ImageArray = NDArray[np.uint8]
"""(H, W, 3) display-referred sRGB, or (H, W) brightness."""
