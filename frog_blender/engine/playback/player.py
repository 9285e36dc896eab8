"""A finished scene, played: time in, Gaussians out. Numpy and the native library alone."""

from __future__ import annotations

import math
import threading
import uuid
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import fields, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from ..capture.time import frame_to_time
from ..gaussians import GaussianArrays
from ..scene.header import SHAPE_DYNAMIC, SceneHeader
from ..scene.scene_file import OPACITY_TRACKS, VISIBILITY, SceneFile, read_scene
from .baselines import BASELINES
from .buffer_pool import BufferPool
from .canonical import canonical_gaussians, normalize
from .deformation import DeformationPlayer
from .frame_delta import FrameDelta, column_names, column_of, column_width, extract_columns
from .visibility import VisibilityMask

PLAYABLE: dict[str, Callable[[dict[str, np.ndarray], dict], Any]] = {
    "frog": DeformationPlayer,
    "ed3dgs": DeformationPlayer,
    **BASELINES,
}
"""What moves a scene, by the method in its header, unless there is no more in the file than CANONICAL: nothing moves
then. Quaternions may be of any length, and arrays of any layout, unless the class has a true ``gives_checked``."""

CANONICAL = {"means", "log_scales", "quaternions", "opacity_logits", "sh"}

TIMES_KEPT = 4
"""Times a scene remembers: a render asks for the same one for every view layer, playback for its neighbours."""


def row_ranges(arrays: dict[str, np.ndarray]) -> dict[str, range]:
    """Of which Gaussians a scene file's arrays tell, by their names: all of them, those that are deformed, which come
    first, or those that only fade, which come next. Arrays that do not have a row a Gaussian are not among them."""
    deformed, everyone = len(arrays.get("embeddings", ())), range(len(arrays["means"]))
    rows = dict.fromkeys(CANONICAL & arrays.keys(), everyone)
    if "embeddings" in arrays:
        rows["embeddings"] = range(deformed)
    if OPACITY_TRACKS in arrays:
        rows[OPACITY_TRACKS] = range(deformed, deformed + len(arrays[OPACITY_TRACKS]))
    return rows


def select_gaussians(scene: SceneFile, kept: np.ndarray) -> SceneFile:
    """The scene of some of its Gaussians alone, which are and move there as they do in the whole one.

    Args:
        kept: (M,) their indices, ascending, at least one.
    """
    arrays, header = dict(scene.arrays), scene.header
    if {VISIBILITY, "embeddings"} <= arrays.keys():
        deformed = len(arrays["embeddings"])
        arrays[VISIBILITY] = VisibilityMask(arrays[VISIBILITY], deformed).select(kept[kept < deformed])
    for name, rows in row_ranges(scene.arrays).items():
        arrays[name] = arrays[name][kept[(kept >= rows.start) & (kept < rows.stop)] - rows.start]
    if SHAPE_DYNAMIC in header.model:
        num_shape_dynamic = int((kept < header.model[SHAPE_DYNAMIC]).sum())
        header = replace(header, model=header.model | {SHAPE_DYNAMIC: num_shape_dynamic})
    if OPACITY_TRACKS in arrays and not len(arrays[OPACITY_TRACKS]):
        del arrays[OPACITY_TRACKS]
    if (
        "embeddings" in arrays and not len(arrays["embeddings"]) and OPACITY_TRACKS not in arrays
    ):  # none of those that move
        arrays = {name: arrays[name] for name in CANONICAL}
        header = replace(header, model={})
    return SceneFile(header, arrays)


class ScenePlayer:
    """Stateless to its callers: any time, in any order, from any thread.

    Attributes:
        header: the scene file's header.
        count, moving: Gaussians, and those of them that the method moves.
        sh_degree: of their colours.
        columns: names of a frame's columns, see moving_part; ``changing`` are those of them that are not the same at
            all times.
        token: of this object alone, in this and any other process: what is kept of it elsewhere can name it.
    """

    def __init__(self, scene: SceneFile) -> None:
        self.header: SceneHeader = scene.header
        self._arrays = scene.arrays
        self.count = len(scene.arrays["means"])
        is_static_capture = not scene.header.model and scene.arrays.keys() <= CANONICAL
        playable = None if is_static_capture else PLAYABLE.get(scene.header.method)
        self._deformation = playable(scene.arrays, scene.header.model) if playable else None
        self.sh_degree = math.isqrt(scene.arrays["sh"].shape[1]) - 1
        self.num_dynamic = (
            int(getattr(self._deformation, "num_dynamic", self.count)) if self._deformation is not None else 0
        )
        self.columns = column_names(scene.arrays["sh"].shape[1])
        changing: frozenset[str] = getattr(self._deformation, "changing", frozenset())
        self.changing = tuple(name for name in self.columns if name in changing)
        self.token = uuid.uuid4().hex
        self._recent: OrderedDict[float, GaussianArrays] = OrderedDict()
        self._lock = threading.Lock()

    @classmethod
    def load(cls, path: str | Path) -> ScenePlayer:
        """FrogError in one sentence when the file cannot be used."""
        return cls(read_scene(path))

    def subset(self, kept: np.ndarray) -> ScenePlayer:
        """A scene of some of the Gaussians alone, which are and move there as they do here.

        Args:
            kept: (M,) their indices, ascending, at least one.
        """
        return ScenePlayer(select_gaussians(SceneFile(self.header, self._arrays), kept))

    def at_frame(self, frame: float) -> GaussianArrays:
        """Gaussians at a frame counted from 0; fractions are legal, frames outside are held."""
        return self.at(self.time_of(frame))

    def time_of(self, frame: float) -> float:
        """The time in [0, 1] of a frame counted from 0; 0 where nothing moves, which is one moment."""
        return self._held(frame_to_time(frame, self.header.frame_count))

    def at(self, time: float, part: FrameDelta | None = None) -> GaussianArrays:
        """Gaussians at a time in [0, 1] (clamped): unit quaternions, scales and opacities activated.

        The arrays are read-only: others may be shown the same ones.  With ``part``, what was kept of that time (see
        ``delta_at``), nothing is computed; the numbers are the same.
        """
        time = self._held(time)
        with self._lock:
            known = self._recent.get(time)
            if known is not None:
                self._recent.move_to_end(time)
                return _copy(known)  # its fields are the caller's own, the arrays are not
            while len(self._recent) >= TIMES_KEPT:
                self._recent.popitem(last=False)  # before the new one is computed, which may use its memory again
        gaussians = _read_only(self._compute(time) if part is None else self._joined(part))
        with self._lock:
            self._recent[time] = gaussians
        return _copy(gaussians)

    def delta_at(self, time: float) -> FrameDelta:
        """What of a time in [0, 1] (clamped) is not as at all others: ``changing`` of the Gaussians that move."""
        if not self.changing:
            return FrameDelta({})
        compute = getattr(self._deformation, "delta_at", None)
        if compute is not None:
            return compute(self._held(time), self.changing)
        return extract_columns(self._compute(self._held(time)), self.changing)

    @property
    def delta_bytes(self) -> int:
        """How much memory ``delta_at`` gives."""
        return 4 * self.num_dynamic * sum(column_width(name) for name in self.changing)

    def column(self, name: str, part: FrameDelta) -> np.ndarray:
        """(N, width) a column at the time of ``part``; it is good until the caller drops it, and not to be changed."""
        moved = part.columns.get(name)
        if moved is None:
            return column_of(self._still, name)
        if self.num_dynamic == self.count:
            return moved
        column = self._column_memory[name].take()[name]
        column[: self.num_dynamic] = moved
        return column

    def _held(self, time: float) -> float:
        return min(max(float(time), 0.0), 1.0) if self._deformation is not None else 0.0

    @cached_property
    def _still(self) -> GaussianArrays:
        """Some moment: right for the columns that do not change, and for the Gaussians that do not move."""
        return self._compute(0.0)

    @cached_property
    def _column_memory(self) -> dict[str, BufferPool]:
        return {name: BufferPool({name: column_of(self._still, name)}) for name in self.changing}

    @cached_property
    def _joined_memory(self) -> BufferPool:
        plain = [name for name in self.changing if hasattr(self._still, name) and self.num_dynamic < self.count]
        opacities = ["opacities"] if "base" in self.changing else []
        colors = ["sh"] if any(name == "base" or name.startswith("sh_") for name in self.changing) else []
        return BufferPool({name: getattr(self._still, name) for name in [*plain, *opacities, *colors]})

    def _joined(self, part: FrameDelta) -> GaussianArrays:
        arrays = {field.name: getattr(self._still, field.name) for field in fields(GaussianArrays)}
        arrays |= self._joined_memory.take()
        for name, column in part.columns.items():
            if name == "base":
                arrays["sh"][: self.num_dynamic, 0], arrays["opacities"][: self.num_dynamic] = (
                    column[:, :3],
                    column[:, 3],
                )
            elif name.startswith("sh_"):
                arrays["sh"][: self.num_dynamic, int(name.removeprefix("sh_"))] = column
            elif self.num_dynamic < self.count:
                arrays[name][: self.num_dynamic] = column
            else:
                arrays[name] = column
        return GaussianArrays(**arrays)

    def _compute(self, time: float) -> GaussianArrays:
        if self._deformation is None:
            return canonical_gaussians(self._arrays).checked()
        gaussians = self._deformation.at(time)
        if getattr(self._deformation, "gives_checked", False):
            return gaussians
        gaussians.quaternions = normalize(gaussians.quaternions)
        return gaussians.checked()


def _copy(gaussians: GaussianArrays) -> GaussianArrays:
    """Another object of the same arrays; a third of the time of ``dataclasses.replace``, in every frame."""
    return GaussianArrays(*vars(gaussians).values())


def _read_only(gaussians: GaussianArrays) -> GaussianArrays:
    """Other views of the same arrays, which cannot be written through."""
    views = [array.view() for array in vars(gaussians).values()]
    for view in views:
        view.flags.writeable = False
    return GaussianArrays(*views)
