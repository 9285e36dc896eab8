"""Turns that a file asks of whoever shows its images: EXIF's orientation of photographs, and rotations of films.

A camera that was calibrated in images as they are stored is turned with them.
"""

from dataclasses import replace

import numpy as np

from ..arrays import Float64s, ImageArray
from .camera import Camera
from .capture import Distortion
from .lenses import FISHEYE, FOV

# Quarter turns clockwise, after which those of _MIRRORED are mirrored left to right.
_TURNS = {1: 0, 2: 0, 3: 2, 4: 2, 5: 1, 6: 1, 7: 3, 8: 3}
_MIRRORED = frozenset({2, 4, 5, 7})
_MAX_TURNED_COEFFICIENTS = 12  # beyond them OpenCV's model tilts the sensor


def is_mirrored(orientation: int) -> bool:
    """Whether the image is shown mirrored, as no camera took it."""
    return orientation in _MIRRORED


def quarter_turns(orientation: int) -> int:
    """Quarter turns clockwise by which a stored image is shown."""
    return _TURNS.get(orientation, 0)


def oriented(image: ImageArray, orientation: int) -> ImageArray:
    """An image (H, W) or (H, W, C) as EXIF's orientation says that it is shown."""
    image = turned(image, quarter_turns(orientation))
    return np.ascontiguousarray(image[:, ::-1]) if is_mirrored(orientation) else image


def turned(image: ImageArray, turns: int) -> ImageArray:
    """An image (H, W) or (H, W, C) after quarter turns clockwise."""
    return np.ascontiguousarray(np.rot90(image, -turns)) if turns % 4 else image


def turned_camera(camera: Camera, distortion: Distortion | None, turns: int) -> tuple[Camera, Distortion | None] | None:
    """The camera whose images are those of ``camera`` after quarter turns clockwise, and its lens.

    None where no model can say it: skewed pixels, tilted sensors, and prisms of fisheyes.
    """
    turns %= 4
    if turns and distortion is not None and not _turns_easily(distortion):
        return None
    for _ in range(turns):
        (fx, _, cx), (_, fy, cy), _ = camera.intrinsics.tolist()
        # x' = H - y and y' = x, in pixels and along the camera's axes
        quarter = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
        pose = camera.with_pose(quarter @ camera.world_to_camera[:3])
        lens = np.array([[fy, 0.0, camera.height - cy], [0.0, fx, cx], [0.0, 0.0, 1.0]])
        camera = replace(pose, width=camera.height, height=camera.width, intrinsics=lens)
        distortion = None if distortion is None else _turned_lens(distortion)
    return camera, distortion


def _turns_easily(distortion: Distortion) -> bool:
    if distortion.lens is not None:
        return distortion.model in (FISHEYE, FOV)
    return not distortion.skew and not np.any(distortion.coefficients[_MAX_TURNED_COEFFICIENTS:])


def _turned_lens(distortion: Distortion) -> Distortion:
    """That of the images after a quarter turn clockwise."""
    if distortion.lens is None:
        return Distortion(_quarter_turned(distortion.coefficients))
    (fx, _, cx), (_, fy, cy), _ = distortion.lens.tolist()  # in shares of width and height; the model is radial
    return replace(distortion, lens=np.array([[fy, 0.0, 1 - cy], [0.0, fx, cx], [0.0, 0.0, 1.0]]))


def _quarter_turned(coefficients: Float64s) -> Float64s:
    """The tangential and thin-prism terms where x' = -y and y' = x; radial terms stay."""
    moved = coefficients.copy()
    moved[2], moved[3] = coefficients[3], -coefficients[2]
    if len(moved) >= _MAX_TURNED_COEFFICIENTS:
        moved[8:10], moved[10:12] = -coefficients[10:12], coefficients[8:10]
    return moved
