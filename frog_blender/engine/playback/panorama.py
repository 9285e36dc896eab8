"""Images of any projection, composed of up to six square ones: the faces of a cube around the camera."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from ..arrays import Array, Float64s
from ..capture.camera import Camera
from .render import Drawing

_MARGIN = 2  # pixels of a face beyond its quarter of a turn: interpolation reaches across edges
_SIDES = 16, 8192
# From the panorama's camera to each face's: its rows are the face's x, y and z.
_FACES = (
    ((1, 0, 0), (0, 1, 0), (0, 0, 1)),
    ((-1, 0, 0), (0, 1, 0), (0, 0, -1)),
    ((0, 0, -1), (0, 1, 0), (1, 0, 0)),
    ((0, 0, 1), (0, 1, 0), (-1, 0, 0)),
    ((1, 0, 0), (0, 0, -1), (0, 1, 0)),
    ((1, 0, 0), (0, 0, 1), (0, -1, 0)),
)


def draw_panorama(rays: Float64s, world_to_camera: Float64s, draw_face: Callable[[Camera], Drawing]) -> Drawing:
    """What is seen along rays; its planar depths are distances, as a panorama has no plane.

    Args:
        rays: (H, W, 3) directions of the pixels in the camera's axes, of any length; NaN where nothing is seen.
        world_to_camera: (4, 4), rigid.
        draw_face: draws a pinhole camera.
    """
    height, width = rays.shape[:2]
    whole = Drawing(
        rgb=np.zeros((height, width, 3), np.float32),
        alpha=np.zeros((height, width), np.float32),
        median_depth=np.full((height, width), np.nan, np.float32),
        median_z=np.full((height, width), np.nan, np.float32),
        mean_depth=np.full((height, width), np.nan, np.float32),
        median_index=np.full((height, width), -1, np.int32),
    )
    sees = np.isfinite(rays).all(axis=-1)
    side = _side(rays)
    axis = np.abs(np.where(sees[..., None], rays, 0)).argmax(axis=-1)
    ahead = np.take_along_axis(rays, axis[..., None], axis=-1)[..., 0] > 0
    face_of = np.array([[2, 3], [4, 5], [0, 1]])[axis, 1 - ahead.astype(int)]
    for index, rows in enumerate(_FACES):
        rotation = np.array(rows, np.float64)
        pixels = np.nonzero(sees & (face_of == index))
        if not pixels[0].size:
            continue
        camera = _face_camera(rotation, world_to_camera, side)
        _fill(whole, pixels, rays[pixels] @ rotation.T, camera, draw_face(camera))
    return whole


def equirectangular(width: int, height: int) -> Float64s:
    """(H, W, 3) unit rays of a whole sphere: the middle of the image is straight ahead, its upper edge above."""
    longitude = ((np.arange(width) + 0.5) / width - 0.5) * 2 * np.pi
    latitude = (0.5 - (np.arange(height) + 0.5) / height)[:, None] * np.pi
    flat, down = np.cos(latitude), np.broadcast_to(-np.sin(latitude), (height, width))
    return np.stack([flat * np.sin(longitude), down, flat * np.cos(longitude)], axis=-1)


def _side(rays: Float64s) -> int:
    """Pixels of a face as dense in its middle as the image's own, in the median."""
    steps = []
    for axis in (0, 1):
        if rays.shape[axis] > 1:
            first, second = (np.delete(rays, place, axis=axis) for place in (-1, 0))
            lengths = np.linalg.norm(first, axis=-1) * np.linalg.norm(second, axis=-1)
            between = np.linalg.norm(np.cross(first, second), axis=-1) / lengths
            if np.isfinite(between).any():
                steps.append(float(np.nanmedian(between)))
    finest = min((step for step in steps if step > 0), default=1.0)
    return int(np.clip(np.ceil(2 / finest), *_SIDES))


def _face_camera(rotation: Float64s, world_to_camera: Float64s, side: int) -> Camera:
    size, focal = side + 2 * _MARGIN, side / 2
    intrinsics = np.array([[focal, 0, size / 2], [0, focal, size / 2], [0, 0, 1]])
    turn = np.eye(4)
    turn[:3, :3] = rotation
    return Camera("panorama", size, size, intrinsics, turn @ world_to_camera)


def _fill(whole: Drawing, pixels: tuple[Array, ...], local: Float64s, camera: Camera, face: Drawing) -> None:
    """Takes pixels from a face: colours between its pixels, depths of the nearest one.

    Args:
        pixels: rows and columns (N,) of the image.
        local: (N, 3) their rays in the face's axes.
    """
    size, focal = camera.width, camera.intrinsics[0, 0]
    place = local[:, :2] / local[:, 2:] * focal + size / 2 - 0.5
    corner = np.clip(np.floor(place).astype(np.int64), 0, size - 2)
    share = (place - corner).astype(np.float32)
    left, top = corner.T
    for down in (0, 1):
        for right in (0, 1):
            weight = np.abs(1 - right - share[:, 0]) * np.abs(1 - down - share[:, 1])
            whole.rgb[pixels] += weight[:, None] * face.rgb[top + down, left + right]
            whole.alpha[pixels] += weight * face.alpha[top + down, left + right]
    column, row = np.clip(np.rint(place).astype(np.int64), 0, size - 1).T
    whole.median_index[pixels] = face.median_index[row, column]
    whole.median_depth[pixels] = whole.median_z[pixels] = face.median_depth[row, column]
    longer = np.linalg.norm(local, axis=1) / local[:, 2]
    whole.mean_depth[pixels] = face.mean_depth[row, column] * longer
    whole.instances += face.instances
    whole.notice = whole.notice or face.notice
