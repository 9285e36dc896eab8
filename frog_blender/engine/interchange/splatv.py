"""``.splatv`` files (antimatter15/splaTV): SpacetimeGaussians in 64 bytes each.

Two numbers, a magic one and the length of JSON text, which lists the chunks after it. That of the type "splat" is a
texture: place, turn, size, colour and opacity, and the motion as SpacetimeGaussians has it (see ply). Its last pixels
may belong to no Gaussian.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np

from ..io.plain_values import UnfitValue, entries, items, plain_json, whole
from ..io.regular_file import regular_file
from .frame_source import StillSource
from .ply import splats_of
from .stills import decoding

_EXPECTED, _MAGIC, _MOST_CHUNKS = "a .splatv file", 0x674B, 64
_ROW = np.dtype(
    [
        *(("mean", "<f4", 3), ("turn", "<f2", 4), ("scale", "<f2", 4), ("rgba", "u1", 4)),
        *(("motion", "<f2", 10), ("spin", "<f2", 4), ("centre", "<f2"), ("width", "<f2")),
    ]
)


def read_splatv(path: Path) -> StillSource:
    """The Gaussians of a file and their curves; FrogError in one sentence for anything else."""
    with decoding(path, _EXPECTED):
        content = regular_file(path, _EXPECTED).read_bytes()
        magic, length = np.frombuffer(content[:8].ljust(8, b"\0"), "<u4").tolist()
        if magic != _MAGIC:
            raise UnfitValue("another kind of file", _EXPECTED)
        start, count = 8 + length, 0
        for chunk in items(plain_json(content[8:start].decode(), "its header"), "its chunks", _MOST_CHUNKS):
            described = entries(chunk, "a chunk")
            size = whole(described.get("size"), "a chunk's size", 0, len(content) - start)
            if described.get("type") == "splat":
                count = size // _ROW.itemsize
                break
            start += size
        rows = np.frombuffer(content, _ROW, count, start)
        rows = rows[rows["width"] != 0]  # others are seen at no time
        if not len(rows):
            raise UnfitValue("no Gaussians", _EXPECTED)
        with np.errstate(divide="ignore"):
            alpha = rows["rgba"][:, 3] / 255
            opacities, widths = np.log(alpha) - np.log1p(-alpha), np.log(rows["width"].astype(np.float32))
            scales = np.log(rows["scale"][:, :3].astype(np.float32))
        parts = {"rot": rows["turn"], "scale": scales, "f_dc": rows["rgba"][:, :3] / 255}
        parts |= {"motion": rows["motion"][:, :9], "omega": rows["spin"]}
        columns = {f"{name}_{i}": column for name, part in parts.items() for i, column in enumerate(part.T)}
        columns |= dict(zip("xyz", rows["mean"].T, strict=True))
        columns |= {"opacity": opacities, "trbf_center": rows["centre"], "trbf_scale": widths}
        table = np.rec.fromarrays([*columns.values()], dtype=[(name, "<f4") for name in columns])
    return replace(splats_of(path, table), origin="splatv")
