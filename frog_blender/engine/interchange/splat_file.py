"""``.splat`` files (antimatter15/splat): 32 bytes a Gaussian, without harmonics. Numpy alone.

Place and size as float32, colour and opacity in 8 bits, the turn in 8 bits a number. No file says which way is up.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from ..errors import found_instead
from ..gaussians import GaussianArrays, NumpyGaussians
from ..io.regular_file import regular_file
from ..spherical_harmonics import SH_DC
from .activated import usable

_EXPECTED = "a .splat file, 32 bytes a Gaussian"
_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("turn", "u1", 4)])


def read_splat_file(path: Path) -> tuple[NumpyGaussians, int]:
    """Gaussians with the file's own axes, and how many rows are left out; FrogError for any other file."""
    content = regular_file(path, _EXPECTED).read_bytes()
    if not content or len(content) % _ROW.itemsize:
        raise found_instead(path, f"{len(content):,} bytes", _EXPECTED)
    table = np.frombuffer(content, _ROW)
    colors = (table["rgba"][:, :3] / 255.0 - 0.5) / SH_DC
    turns = (table["turn"].astype(np.float64) - 128) / 128
    opacities = table["rgba"][:, 3] / 255.0
    made = GaussianArrays(table["mean"], turns, table["scale"], opacities, colors[:, None])
    return usable(path, made, keep_rows=False)
