"""Scenes of segments that were trained with the same static Gaussians, joined into one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array, Bools, SceneArrays
from ..errors import FrogError
from ..field.names import CANONICAL
from .header import SceneHeader
from .morton_order import morton_order
from .scene_file import SceneFile
from .segments import SEGMENTS, Segment, network_prefix

_ATTRIBUTES = sorted(CANONICAL)


@dataclass(frozen=True)
class TrainedSegment:
    """A segment's scene, and where it belongs.

    Attributes:
        first, frames: the frames that it is to play.
        trained_first: the frame at which its scene begins.
        scene: with numbers as they were trained; the shared Gaussians are among its static ones, to the bit.
    """

    first: int
    frames: int
    trained_first: int
    scene: SceneFile


def join(header: SceneHeader, shared: SceneArrays, parts: Sequence[TrainedSegment]) -> SceneFile:
    """A scene that plays each segment in its frames.

    Args:
        header: of all frames; its model and version are replaced.
        shared: the canonical arrays of the Gaussians that all segments have; none for segments that share nothing.
        parts: one after the other in time.

    Raises:
        FrogError: a segment does not have the shared Gaussians, or is none of FRoG's in one piece.
    """
    known = {row.tobytes() for row in _rows(shared)} if shared else set()
    pieces = [_Piece.of(part, known) for part in parts]
    embedded = [piece for piece in pieces if piece.segment.deformed]
    arrays: SceneArrays = {}
    for name in _ATTRIBUTES:
        moving = [piece.deformed[name] for piece in pieces]
        still = [piece.still[name] for piece in pieces]
        arrays[name] = np.concatenate([*moving, *still, *([shared[name]] if shared else [])])
    widest = max((piece.arrays["embeddings"].shape[1] for piece in embedded), default=0)
    embeddings = [_widened(piece.arrays["embeddings"][piece.order], widest) for piece in embedded]
    arrays["embeddings"] = np.concatenate(embeddings) if embedded else np.empty((0, 1), np.float32)
    if embedded:
        arrays["temporal_table"] = np.concatenate([piece.arrays["temporal_table"] for piece in embedded])
    for number, piece in enumerate(pieces):
        own = {name: each for name, each in piece.arrays.items() if name.startswith("network.")}
        arrays |= {name.replace("network.", network_prefix(number), 1): each for name, each in own.items()}
    model = {SEGMENTS: [piece.segment.to_json() for piece in pieces]}
    return SceneFile(replace(header, model=model), arrays)


@dataclass(frozen=True)
class _Piece:
    """What of a segment's scene goes into the whole one: canonical rows in their order, and everything else."""

    segment: Segment
    deformed: SceneArrays
    still: SceneArrays
    order: Array
    arrays: SceneArrays

    @classmethod
    def of(cls, part: TrainedSegment, known: set[bytes]) -> _Piece:
        scene, arrays = part.scene, part.scene.arrays
        usual = CANONICAL | {"embeddings", "temporal_table"}
        if extra := [name for name in arrays if name not in usual and not name.startswith("network.")]:
            raise FrogError(f"The segment of frame {part.first} has {', '.join(extra)}, expected FRoG's alone.")
        moving = len(arrays.get("embeddings", ()))
        rows = {name: arrays[name][moving:] for name in _ATTRIBUTES}
        own = np.array([row.tobytes() not in known for row in _rows(rows)], bool)
        if len(own) - int(own.sum()) != len(known):
            found = f"{len(own) - int(own.sum())} of the {len(known)} shared Gaussians"
            raise FrogError(f"The segment of frame {part.first} has {found}, expected all: train it again.")
        order = morton_order(arrays["means"][:moving])
        deformed = {name: arrays[name][:moving][order] for name in _ATTRIBUTES}
        frames = (part.first, part.frames, part.trained_first, scene.header.frame_count)
        model = dict(scene.header.model) if moving else {}
        return cls(Segment(*frames, moving, int(own.sum()), model), deformed, _near(rows, own), order, arrays)


def _near(rows: SceneArrays, chosen: Bools) -> SceneArrays:
    """The chosen rows, neighbours together."""
    order = np.flatnonzero(chosen)[morton_order(rows["means"][chosen])]
    return {name: array[order] for name, array in rows.items()}


def _rows(arrays: SceneArrays) -> Array:
    """(N, numbers) float32, all attributes of each Gaussian."""
    count = len(arrays["means"])
    result: Array = np.concatenate([np.ascontiguousarray(arrays[n], "<f4").reshape(count, -1) for n in _ATTRIBUTES], 1)
    return result


def _widened(rows: Array, width: int) -> Array:
    return np.pad(rows, ((0, 0), (0, width - rows.shape[1])))
