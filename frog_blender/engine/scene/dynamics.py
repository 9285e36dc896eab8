"""What of each Gaussian changes over time: flags by Gaussian, of which a file holds how many have which."""

from __future__ import annotations

from enum import IntFlag

import numpy as np
from numpy.typing import NDArray

from .header import SHAPE_DYNAMIC
from .scene_file import OPACITY_TRACKS, SceneFile


class Dynamics(IntFlag):
    """What changes over time. Gaussians lie in a file by descending flags, so that each kind is one range of rows.

    Attributes:
        OPACITY: by the network, or, where nothing else changes, by a track.
        POSITION: by the network, and colour with it.
        SHAPE: rotation and scale, by the network.
    """

    OPACITY = 1
    POSITION = 2
    SHAPE = 4


STATIC = Dynamics(0)
ONLY_FADES = Dynamics.OPACITY
KEEPS_SHAPE = Dynamics.OPACITY | Dynamics.POSITION
ALL_CHANGES = KEEPS_SHAPE | Dynamics.SHAPE
"""The kinds of Gaussians that there are in files."""


def dynamics_of(scene: SceneFile) -> NDArray[np.uint8]:
    """(N,) the flags of each Gaussian of a scene of FRoG's, descending."""
    count, deformed, fading = (len(scene.arrays.get(name, ())) for name in ("means", "embeddings", OPACITY_TRACKS))
    turning = scene.header.model.get(SHAPE_DYNAMIC, deformed)
    kinds = np.array([ALL_CHANGES, KEEPS_SHAPE, ONLY_FADES, STATIC], np.uint8)
    return np.repeat(kinds, [turning, deformed - turning, fading, count - deformed - fading])


def kind_bounds(dynamics: NDArray[np.uint8]) -> list[int]:
    """Where one kind ends and the next begins, among descending flags (N,)."""
    return [int(place) + 1 for place in np.flatnonzero(np.diff(dynamics))]
