"""Scene files, compared."""

from __future__ import annotations

import numpy as np

from frog_blender.engine.scene.scene_file import SceneFile


def same_arrays(one: SceneFile, other: SceneFile) -> bool:
    """Whether two scenes have the same numbers, to the bit."""
    return one.arrays.keys() == other.arrays.keys() and all(
        np.array_equal(array, other.arrays[name]) for name, array in one.arrays.items()
    )
