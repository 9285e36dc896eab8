"""Frames that another program made, played: read from the disk one by one, nothing kept between them.

Where the same row is the same Gaussian in all frames, times between two of them are interpolated; else the frame before
is held, for there is nothing between Gaussians that are not the same.
"""

from __future__ import annotations

import math
from collections.abc import Collection

import numpy as np

from ..arrays import Array, SceneArrays
from ..capture.time import time_to_frame
from ..gaussians import GaussianArrays, NumpyGaussians
from ..scene.frame_rows import FrameRows
from .frame_delta import FrameDelta, canonical_gaussians, normalize

_LARGEST = 1e18  # its square is a float32 still


class PlayableSequence:
    """A sequence's frames at any time.

    Args:
        arrays: the scene file's arrays; what does not change, and everything at frame 0.
        rows: what changes.
    """

    def __init__(self, arrays: SceneArrays, rows: FrameRows) -> None:
        self._still = canonical_gaussians(arrays).checked()
        self._rows = rows
        self.num_dynamic = len(rows)
        has_sh = {f"sh_{k}" for k in range(1, self._still.sh.shape[1])}
        known = {"means", "quaternions", "scales", "base"} | has_sh
        self.changing = frozenset(rows.layout.columns) & known if self.num_dynamic and rows.count > 1 else frozenset()

    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated, with unit quaternions; arrays that may be written."""
        found = GaussianArrays(*(array.copy() for array in vars(self._still).values()))
        for name, column in self._columns(time).items():
            if name == "base":
                found.sh[: self.num_dynamic, 0], found.opacities[: self.num_dynamic] = column[:, :3], column[:, 3]
            elif name.startswith("sh_"):
                found.sh[: self.num_dynamic, int(name.removeprefix("sh_"))] = column
            else:
                getattr(found, name)[: self.num_dynamic] = column
        return found

    def delta_at(self, time: float, names: Collection[str]) -> FrameDelta:
        """The columns ``names`` of the dynamic Gaussians at a time in [0, 1]."""
        columns = self._columns(time)
        return FrameDelta({name: columns[name] for name in names})

    def _columns(self, time: float) -> dict[str, Array]:
        """What changes, as ``changing`` names it."""
        if not self.changing:
            return {}
        position = time_to_frame(time, self._rows.count)
        # A frame's own time is computed as f / (n - 1), so that it may come out a hair beside the frame.
        nearest = round(position)
        is_frame = abs(position - nearest) < 1e-6
        first = nearest if is_frame else math.floor(position)
        share = 0.0 if is_frame else position - first
        columns = self._checked(first)
        if share and self._rows.layout.keeps_identity and first + 1 < self._rows.count:
            following = self._checked(first + 1)
            for name, column in columns.items():
                other = following[name]
                if name == "quaternions":
                    other = np.where((column * other).sum(axis=1, keepdims=True) < 0, -other, other)
                columns[name] = column + np.float32(share) * (other - column)
        if "quaternions" in columns:
            columns["quaternions"] = normalize(columns["quaternions"])
        return columns

    def _checked(self, frame: int) -> dict[str, Array]:
        """A frame's columns with every number one that can be drawn: a file may say anything."""
        columns = {name: column for name, column in self._rows.at(frame).items() if name in self.changing}
        for name, column in columns.items():
            np.nan_to_num(column, copy=False, nan=0.0, posinf=_LARGEST, neginf=-_LARGEST)
            if name == "scales":
                np.maximum(column, 0, out=column)
            elif name == "base":
                np.clip(column[:, 3], 0, 1, out=column[:, 3])
        return columns
