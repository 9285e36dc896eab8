"""``.splat`` files (antimatter15/splat): one time's Gaussians in 32 bytes each, without harmonics.

Place and size are float32, colour and opacity 8 bits, the turn 8 bits a number. Nothing says which way is up.
"""

from pathlib import Path

import numpy as np

from ..gaussians import GaussianArrays
from ..io.plain_values import UnfitValue
from ..spherical_harmonics import SH_DC
from .stills import AS_THEY_ARE, Part

EXPECTED = "a .splat file, 32 bytes a Gaussian"
_ROW = np.dtype([("mean", "<f4", 3), ("scale", "<f4", 3), ("rgba", "u1", 4), ("turn", "u1", 4)])


def decode_splat(_path: Path, content: bytes) -> list[Part]:
    """Gaussians with the file's own axes; UnfitValue for any other content."""
    if not content or len(content) % _ROW.itemsize:
        raise UnfitValue(f"{len(content):,} bytes", EXPECTED)
    table = np.frombuffer(content, _ROW)
    colors = (table["rgba"][:, :3] / 255.0 - 0.5) / SH_DC
    turns = (table["turn"].astype(np.float64) - 128) / 128
    opacities = table["rgba"][:, 3] / 255.0
    return [Part(GaussianArrays(table["mean"], turns, table["scale"], opacities, colors[:, None]), AS_THEY_ARE)]
