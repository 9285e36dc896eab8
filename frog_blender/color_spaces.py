"""Conversion between the display-referred sRGB of videos and Blender's scene-linear color (Rec. 709 primaries unless
a .blend of Blender 5 uses others).
"""

import numpy as np

from .engine.srgb import linear_to_srgb


def to_display(linear: np.ndarray) -> np.ndarray:
    """Display-referred sRGB float32 of scene-linear colour, any shape: the inverse of ``to_linear``."""
    linear = np.maximum(np.asarray(linear, dtype=np.float32), 0.0)
    return linear_to_srgb(linear).astype(np.float32)


def into_working_space(linear: np.ndarray) -> np.ndarray:
    """Converts the first three of (..., 3 or 4) channels in place from linear Rec. 709 to the working space of the
    open .blend.
    """
    matrix = _working_space()
    if matrix is not None:
        linear[..., :3] = linear[..., :3] @ matrix.T
    return linear


def out_of_working_space(linear: np.ndarray) -> np.ndarray:
    """(..., 3) linear Rec. 709, converted from the working space of the open .blend."""
    matrix = _working_space()
    return linear if matrix is None else (linear @ np.linalg.inv(matrix).T).astype(linear.dtype)


def _working_space() -> np.ndarray | None:
    """(3, 3) the matrix from linear Rec. 709; None where they are the same."""
    import bpy
    from mathutils import Color

    if bpy.app.version < (5, 0, 0):
        return None
    matrix = np.array([Color(row).from_rec709_linear_to_scene_linear() for row in np.eye(3)]).T
    return None if np.allclose(matrix, np.eye(3), atol=1e-5) else matrix
