"""A scene of segments taken apart: each segment as a scene of its own, of what is there while it plays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from ..arrays import SceneArrays
from ..field.names import CANONICAL
from .scene_file import SceneFile
from .segments import Segment, network_prefix, rows_of, segments_of


def own_arrays(arrays: SceneArrays, segments: tuple[Segment, ...], number: int) -> SceneArrays:
    """The arrays of the Gaussians that a segment deforms, by the names that a scene in one piece has.

    KeyError or ValueError where they are not there.
    """
    prefix, rows, segment = network_prefix(number), rows_of(segments)[number], segments[number]
    found = {name: arrays[name][rows.deformed] for name in (*CANONICAL, "embeddings")}
    found["embeddings"] = found["embeddings"][:, : int(segment.model["embedding_size"])]  # others' may be wider
    if any(len(array) != segment.deformed for array in found.values()):
        raise ValueError(f"segment {number} has fewer Gaussians than its header says")
    network = {name.replace(prefix, "network."): each for name, each in arrays.items() if name.startswith(prefix)}
    return found | {"temporal_table": arrays["temporal_table"][rows.table]} | network


def part_of(scene: SceneFile, number: int) -> SceneFile:
    """A segment as a scene in one piece, of the frames that it was trained on; other segments' Gaussians are left
    out."""
    segments = segments_of(scene.header.model)
    segment, every = segments[number], rows_of(segments)
    rows, first_shared = every[number], every[-1].still.stop
    count = len(scene.arrays["means"])
    kept = np.r_[rows.deformed, rows.still, first_shared:count]
    arrays = {name: scene.arrays[name][kept] for name in CANONICAL}
    if segment.deformed:
        own = own_arrays(scene.arrays, segments, number)
        arrays |= {name: own[name] for name in own if name not in CANONICAL}
    header = replace(
        scene.header,
        model=segment.model if segment.deformed else {},
        frame_count=segment.trained_frames,
        camera_shots=tuple(_shots(frames, segment) for frames in scene.header.camera_shots),
        test_frames=_shots(scene.header.test_frames, segment),
    )
    return SceneFile(header, arrays)


def _shots(frames: tuple[int, ...], segment: Segment) -> tuple[int, ...]:
    """Those of some frames that a segment was trained on, counted from its first."""
    counted = (frame - segment.trained_first for frame in frames)
    return tuple(frame for frame in counted if 0 <= frame < segment.trained_frames)
