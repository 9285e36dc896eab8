"""A finished scene, played: time in, Gaussians out. Numpy and the native library alone."""

from __future__ import annotations

import hashlib
import math
import threading
import uuid
from collections import OrderedDict
from collections.abc import Collection
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

import numpy as np

from ..arrays import Array, SceneArrays
from ..capture.time import frame_to_time, time_to_frame
from ..errors import FrogError
from ..field.names import CANONICAL, CURVES, PER_GAUSSIAN, SEQUENCE
from ..gaussians import GaussianArrays, NumpyGaussians
from ..registry import METHODS
from ..scene.header import SceneHeader
from ..scene.scene_file import WIDTHS, FrameRows, SceneFile, read_scene
from . import frame_delta
from .deformation import DeformationPlayer

_LARGEST = 1e18  # its square is a float32 still


class PlayableSequence:
    """A sequence's frames at any time.

    Args:
        arrays: the scene file's arrays; what does not change, and everything at frame 0.
        rows: what changes.
    """

    def __init__(self, arrays: SceneArrays, rows: FrameRows) -> None:
        self._still = frame_delta.canonical_gaussians(arrays).checked()
        self._rows = rows
        self.num_dynamic = len(rows)
        known = frozenset(frame_delta.column_names(self._still.sh.shape[1]))
        self.changing = frozenset(rows.layout.columns) & known if self.num_dynamic and rows.count > 1 else frozenset()

    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated, with unit quaternions; arrays that may be written."""
        arrays = {name: array.copy() for name, array in self._still.arrays.items()}
        frame_delta.put_columns(arrays, self._columns(time), self.num_dynamic)
        return GaussianArrays.of(arrays)

    def delta_at(self, time: float, names: Collection[str]) -> frame_delta.FrameDelta:
        """The columns ``names`` of the dynamic Gaussians at a time in [0, 1]."""
        columns = self._columns(time)
        return {name: columns[name] for name in names}

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
            columns["quaternions"] = frame_delta.normalize(columns["quaternions"])
        return columns

    def _checked(self, frame: int) -> dict[str, Array]:
        """A frame's columns that change."""
        return _drawable({name: column for name, column in self._rows.at(frame).items() if name in self.changing})


class PlayableCurves(PlayableSequence):
    """Gaussians at any time, each of which has a curve of its own, as SpacetimeGaussians' have (arXiv 2312.16812).

    With t_c a Gaussian's own time and d = t - t_c,
        mean(t) = mean + b_1 d + b_2 d^2 + b_3 d^3,   quaternion(t) = quaternion + w d,
        opacity(t) = opacity * exp(-(d / s)^2).

    Args:
        arrays: the scene file's, quaternions of length one; of CURVES, a row is b_1, b_2, b_3, w, t_c and log s.
    """

    def __init__(self, arrays: SceneArrays) -> None:
        self._still = frame_delta.canonical_gaussians(arrays).checked()
        self._curves = arrays[CURVES]
        self.num_dynamic = len(self._curves)
        self.changing = frozenset({"means", "quaternions", "base"})

    def _columns(self, time: float) -> dict[str, Array]:
        still, base = self._still, frame_delta.column_of(self._still, "base")
        one, two, three, spin, centre, width = np.split(self._curves, [3, 6, 9, 13, 14], axis=1)
        with np.errstate(over="ignore", invalid="ignore"):
            since = np.float32(time) - centre
            means = still.means + since * (one + since * (two + since * three))
            base[:, 3:] *= np.exp(-np.square(since * np.exp(-width)))
            columns = _drawable({"means": means, "quaternions": still.quaternions + since * spin, "base": base})
        return columns | {"quaternions": frame_delta.normalize(columns["quaternions"])}


def _drawable(columns: dict[str, Array]) -> dict[str, Array]:
    """Columns, changed in place, with every number one that can be drawn: a file may say anything."""
    for name, column in columns.items():
        np.clip(np.nan_to_num(column, copy=False), -_LARGEST, _LARGEST, out=column)
        if name == "scales":
            np.maximum(column, 0, out=column)
        elif name == "base":
            np.clip(column[:, 3], 0, 1, out=column[:, 3])
    return columns


class Deformation(Protocol):
    """Moves the Gaussians of a scene.

    Attributes:
        num_dynamic: Gaussians that it moves, the first ones.
        changing: their columns that are not the same at all times.
    """

    num_dynamic: int
    changing: frozenset[str]

    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated. Quaternions may have any length, arrays any layout."""


_BY_COLUMN = DeformationPlayer | PlayableSequence

TIMES_KEPT = 4
"""Times a scene remembers: a render asks for the same one for every view layer, playback for its neighbours."""


def select_gaussians(scene: SceneFile, kept: Array) -> SceneFile:
    """A scene of some of the Gaussians, with the same appearance and motion.

    Args:
        kept: (M,) their indices, ascending, at least one.
    """
    arrays, header = dict(scene.arrays), scene.header
    for name in PER_GAUSSIAN & arrays.keys():
        own = kept[kept < len(arrays[name])]
        arrays[name] = np.take(arrays[name], own, axis=0)  # rows in one piece, which indexing does not see
    if "embeddings" in arrays and not len(arrays["embeddings"]):
        arrays = {name: arrays[name] for name in CANONICAL}
        header = replace(header, model={})
    return SceneFile(header, arrays, None if scene.rows is None else scene.rows.subset(kept))


class ScenePlayer:
    """Stateless to its callers: any time, in any order, from any thread.

    Attributes:
        header: the scene file's header.
        count: Gaussians.
        num_dynamic: those of them that the method moves, the first ones.
        sh_degree: of their colours.
        columns: names of a frame's columns, see frame_delta; ``changing`` are those of them that change in
            time.
        token: of this object alone, in this and any other process: what is kept of it elsewhere can name it.
        source: what computes its frames; another scene where this one is edited.
        rows: (N,) which of its file's Gaussians it has, ascending; None for all ``file_count`` of them.
    """

    def __init__(self, scene: SceneFile, part_of: tuple[ScenePlayer, Array] | None = None) -> None:
        self.header: SceneHeader = scene.header
        self._arrays = scene.arrays
        self.count = len(scene.arrays["means"])
        self._rows = scene.rows
        self._deformation = _deformation(scene)
        self.sh_degree = math.isqrt(scene.arrays["sh"].shape[1]) - 1
        self.num_dynamic = self._deformation.num_dynamic if self._deformation is not None else 0
        self.columns = frame_delta.column_names(scene.arrays["sh"].shape[1])
        changing = self._deformation.changing if self._deformation is not None else frozenset[str]()
        self.changing = tuple(name for name in self.columns if name in changing)
        self.token = uuid.uuid4().hex
        self.source: ScenePlayer = self
        self.rows: Array | None = None
        self.file_count = self.count
        if part_of is not None:
            whole, kept = part_of
            self.rows = kept if whole.rows is None else whole.rows[kept]
            self.file_count, self.identity = whole.file_count, whole.identity
        self._recent: OrderedDict[float, NumpyGaussians] = OrderedDict()
        self._lock = threading.Lock()

    @classmethod
    def load(cls, path: str | Path) -> ScenePlayer:
        """FrogError in one sentence when the file cannot be used."""
        return cls(read_scene(path))

    def __repr__(self) -> str:
        return f"ScenePlayer({self.header.method!r}, {self.count} Gaussians, {self.header.frame_count} frames)"

    def subset(self, kept: Array) -> ScenePlayer:
        """A scene of some of the Gaussians, with the same appearance and motion.

        Args:
            kept: (M,) their indices, ascending, at least one.
        """
        return ScenePlayer(select_gaussians(SceneFile(self.header, self._arrays, self._rows), kept), (self, kept))

    def canonical(self) -> ScenePlayer:
        """The scene's canonical field, at all times as it is before anything moves it; FrogError for frames that
        another program made, which have none."""
        if self.header.method == SEQUENCE:
            raise FrogError("Found a sequence of frames, expected a scene with a canonical field.")
        arrays = {name: self._arrays[name] for name in CANONICAL}
        return ScenePlayer(SceneFile(replace(self.header, model={}), arrays))

    @cached_property
    def identity(self) -> str:
        """Of the Gaussians in its file: another training has another one."""
        digest = hashlib.blake2b(digest_size=16)
        for name in ("means", "opacity_logits"):
            digest.update(np.ascontiguousarray(self._arrays[name], "<f4").data)
        return digest.hexdigest()

    @property
    def keeps_identity(self) -> bool:
        """Whether the same row is the same Gaussian at all times: not in frames that another program made of others."""
        return bool(self.header.model.get("keeps_identity", True))

    def edited(self, part: frame_delta.FrameDelta) -> frame_delta.FrameDelta:
        """What ``delta_at`` returns, from what that of ``source`` did."""
        return part

    def at_frame(self, frame: float) -> NumpyGaussians:
        """Gaussians at a frame counted from 0; fractions are legal, frames outside are held."""
        return self.at(self.time_of(frame))

    def time_of(self, frame: float) -> float:
        """The time in [0, 1] of a frame counted from 0; always 0 in a static scene."""
        return self._held(frame_to_time(frame, self.header.frame_count))

    def at(self, time: float, part: frame_delta.FrameDelta | None = None) -> NumpyGaussians:
        """Gaussians at a time in [0, 1] (clamped): unit quaternions, scales and opacities activated.

        The arrays are read-only: others may be shown the same ones.  With ``part``, what was kept of that time (see
        ``delta_at``), nothing is computed; the numbers are the same.
        """
        time = self._held(time)
        with self._lock:
            known = self._recent.get(time)
            if known is not None:
                self._recent.move_to_end(time)
                return replace(known)  # its fields are the caller's own, the arrays are not
            while len(self._recent) >= TIMES_KEPT:
                self._recent.popitem(last=False)  # before the new one is computed, which may use its memory again
        gaussians = _read_only(self.compute(time) if part is None else self._joined(part), self.header.low_pass)
        with self._lock:
            self._recent[time] = gaussians
        return replace(gaussians)

    def delta_at(self, time: float) -> frame_delta.FrameDelta:
        """The columns ``changing`` of the dynamic Gaussians at a time in [0, 1] (clamped)."""
        if not self.changing:
            return {}
        if isinstance(self._deformation, _BY_COLUMN):  # which gives those columns alone
            return self._deformation.delta_at(self._held(time), self.changing)
        gaussians = self.compute(self._held(time))
        return {name: frame_delta.column_of(gaussians, name, self.num_dynamic) for name in self.changing}

    @property
    def delta_bytes(self) -> int:
        """Bytes that ``delta_at`` returns."""
        return 4 * self.num_dynamic * sum(WIDTHS[name] for name in self.changing)

    def column(self, name: str, part: frame_delta.FrameDelta) -> Array:
        """(N, width) a column at the time of ``part``; it is good until the caller drops it, and not to be changed."""
        moved = part.get(name)
        if moved is None:
            return frame_delta.column_of(self._still, name)
        if self.num_dynamic == self.count:
            return moved
        column = self._column_memory[name].take()[0][name]
        column[: self.num_dynamic] = moved
        return column

    def _held(self, time: float) -> float:
        return min(max(float(time), 0.0), 1.0) if self._deformation is not None else 0.0

    @cached_property
    def _still(self) -> NumpyGaussians:
        """The frame at time 0: right in constant columns, and for static Gaussians."""
        return self.compute(0.0)

    @cached_property
    def _column_memory(self) -> dict[str, frame_delta.BufferPool]:
        return {
            name: frame_delta.BufferPool({name: frame_delta.column_view(self._still, name)}) for name in self.changing
        }

    @cached_property
    def _joined_memory(self) -> frame_delta.BufferPool:
        plain = [name for name in self.changing if hasattr(self._still, name) and self.num_dynamic < self.count]
        opacities = ["opacities"] if "base" in self.changing else []
        colors = ["sh"] if any(name == "base" or name.startswith("sh_") for name in self.changing) else []
        return frame_delta.BufferPool({name: getattr(self._still, name) for name in [*plain, *opacities, *colors]})

    def _joined(self, part: frame_delta.FrameDelta) -> NumpyGaussians:
        arrays = self._still.arrays | self._joined_memory.take()[0]
        frame_delta.put_columns(arrays, part, self.num_dynamic)
        return GaussianArrays.of(arrays)

    def compute(self, time: float) -> NumpyGaussians:
        """As ``at`` for a time in [0, 1], but computed in any case, into arrays that may be written."""
        if self._deformation is None:
            return frame_delta.canonical_gaussians(self._arrays).checked()
        gaussians = self._deformation.at(time)
        if isinstance(self._deformation, _BY_COLUMN):
            return gaussians  # contiguous float32 with unit quaternions
        gaussians.quaternions = frame_delta.normalize(gaussians.quaternions)
        return gaussians.checked()


def _deformation(scene: SceneFile) -> Deformation | None:
    """What moves a scene's Gaussians; None for a static one."""
    if scene.rows is not None:
        return PlayableSequence(scene.arrays, scene.rows)
    if CURVES in scene.arrays:
        return PlayableCurves(scene.arrays)
    if not scene.header.model and scene.arrays.keys() <= CANONICAL:  # static, whatever its method
        return None
    deformation: Deformation | None = METHODS[scene.header.method].player(scene.arrays, scene.header.model)
    return deformation


def _read_only(gaussians: NumpyGaussians, low_pass: float) -> NumpyGaussians:
    """Other views of the same arrays, which cannot be written through, with the scene's low-pass."""
    views = gaussians.mapped(lambda array: array.view())
    for view in views.arrays.values():
        view.flags.writeable = False
    views.low_pass = low_pass
    return views
