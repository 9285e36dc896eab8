"""Small scenes of segments, joined from random ones that share static Gaussians."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.builders import scene_file

from frog_blender.engine.field.names import CANONICAL
from frog_blender.engine.scene.joined import TrainedSegment, join
from frog_blender.engine.scene.scene_file import SceneFile

SHARED, OVERLAP = 30, 2


def shared_gaussians(seed: int = 99) -> dict[str, np.ndarray]:
    return {name: array for name, array in scene_file(SHARED, seed).arrays.items() if name in CANONICAL}


def trained_segment(number: int, moving: int, still: int, frames: int, **model: object) -> SceneFile:
    """A segment's scene: ``moving`` Gaussians, ``still`` ones of its own, and the shared ones among them."""
    own, shared = scene_file(moving + still, number, moving=moving, **model), shared_gaussians()
    arrays = dict(own.arrays)
    order = np.random.default_rng(number).permutation(still + SHARED)
    for name in CANONICAL:
        static = np.concatenate([own.arrays[name][moving:], shared[name]])[order]
        arrays[name] = np.concatenate([own.arrays[name][:moving], static])
    if not moving:
        arrays = {name: arrays[name] for name in CANONICAL}
    header = replace(own.header, frame_count=frames, model=own.header.model if moving else {})
    return SceneFile(header, arrays)


def parts() -> list[TrainedSegment]:
    """Three segments of 5, 6 and 4 frames, of which the last deforms nothing, trained on frames around them."""
    found = [
        TrainedSegment(0, 5, 0, trained_segment(1, 20, 7, 7)),
        TrainedSegment(5, 6, 3, trained_segment(2, 33, 0, 10, hidden_width=16, embedding_size=6, temporal_rows=4)),
        TrainedSegment(11, 4, 9, trained_segment(3, 0, 9, 6)),
    ]
    assert all(part.trained_first + part.scene.header.frame_count <= 15 for part in found)
    return found


def joined() -> SceneFile:
    scene = parts()[0].scene
    shots = (tuple(range(15)),) * len(scene.header.cameras)
    header = replace(scene.header, frame_count=15, camera_shots=shots)
    return join(header, shared_gaussians(), parts())
