"""Images of any projection, composed of the faces of a cube around the camera; and of these the light that arrives at a
place inside a scene, as an environment image that has no holes.
"""

from collections.abc import Callable
from functools import partial

import numpy as np

from ..arrays import Array, Float64s
from ..capture.camera import Camera
from ..errors import FrogError
from ..gaussians import NumpyGaussians
from ..srgb import srgb_to_linear
from .render import Drawing, draw

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
    size = rays.shape[:2]
    rgb, alpha, median_index = np.zeros((*size, 3), np.float32), np.zeros(size, np.float32), np.full(size, -1, np.int32)
    distance, z, mean_z = np.full((3, *size), np.nan, np.float32)
    whole = Drawing(rgb, alpha, distance, z, mean_z, median_index)
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


def equirectangular(
    width: int,
    height: int,
    longitudes: tuple[float, float] = (-np.pi, np.pi),
    latitudes: tuple[float, float] = (-np.pi / 2, np.pi / 2),
) -> Float64s:
    """(H, W, 3) unit rays by angles to the right of what lies straight ahead, and up from the horizon.

    Args:
        longitudes, latitudes: angles at the image's left and right, and lower and upper edges; the whole sphere.
    """
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, 1 - (np.arange(height) + 0.5) / height)
    longitude, latitude = (low + (high - low) * share for (low, high), share in ((longitudes, u), (latitudes, v)))
    flat = np.cos(latitude)
    return np.stack([flat * np.sin(longitude), -np.sin(latitude), flat * np.cos(longitude)], axis=-1)


def _side(rays: Float64s) -> int:
    """Pixels of a face as dense in its middle as the image's own, in the median."""
    steps = []
    for axis in (0, 1):
        if rays.shape[axis] > 1:
            first, second = (np.delete(rays, end, axis=axis) for end in (-1, 0))
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
    pixel = local[:, :2] / local[:, 2:] * focal + size / 2 - 0.5
    corner = np.clip(np.floor(pixel).astype(np.int64), 0, size - 2)
    share = (pixel - corner).astype(np.float32)
    left, top = corner.T
    for down in (0, 1):
        for right in (0, 1):
            weight = np.abs(1 - right - share[:, 0]) * np.abs(1 - down - share[:, 1])
            whole.rgb[pixels] += weight[:, None] * face.rgb[top + down, left + right]
            whole.alpha[pixels] += weight * face.alpha[top + down, left + right]
    column, row = np.clip(np.rint(pixel).astype(np.int64), 0, size - 1).T
    whole.median_index[pixels] = face.median_index[row, column]
    whole.median_depth[pixels] = whole.median_z[pixels] = face.median_depth[row, column]
    longer = np.linalg.norm(local, axis=1) / local[:, 2]
    whole.mean_depth[pixels] = face.mean_depth[row, column] * longer
    whole.notice = whole.notice or face.notice


_OPAQUE = 0.3  # opacity from which a Gaussian stands in the way
_MOST = 20_000  # Gaussians that are looked at for a free place
_GRID, _SPAN = 7, 0.5  # places tried along each axis, and how far from the middle, in reaches
_FREE = 0.15  # of the reach: the distance to what is around that a free place has
_LARGEST = 0.25  # of the reach: a sky of large Gaussians does not fill the scene
_SEEN = 1e-4  # coverage below which a colour is noise


def free_place(gaussians: NumpyGaussians, middle: Float64s, reach: float) -> Float64s:
    """(3,) the place nearest the middle of a scene that nothing stands close to, or else the one with the most room.

    From the inside of a filmed subject there is nothing to see but its inside.

    Args:
        middle: (3,), world units.
        reach: from there to the ends of the scene, world units.
    """
    opaque = np.flatnonzero(gaussians.opacities > _OPAQUE)
    opaque = opaque[:: max(1, -(-len(opaque) // _MOST))]
    means = gaussians.means[opaque].astype(np.float64)
    sizes = np.minimum(np.median(gaussians.scales[opaque], axis=1), _LARGEST * reach)
    steps = np.linspace(-_SPAN, _SPAN, _GRID) * reach
    offsets = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), axis=-1).reshape(-1, 3)
    offsets = offsets[np.argsort(np.linalg.norm(offsets, axis=1), kind="stable")]
    best, most_room = np.asarray(middle, np.float64), -np.inf
    for position in middle + offsets:
        room = float((np.linalg.norm(means - position, axis=1) - sizes).min()) if len(means) else np.inf
        if room > most_room:
            best, most_room = position, room
        if room >= _FREE * reach:
            break
    return best


def environment(gaussians: NumpyGaussians, world_to_camera: Float64s, width: int) -> Array:
    """The light from everywhere around a camera, as an equirectangular image.

    Where no Gaussian is seen, the colours of what is seen around it continue.

    Args:
        world_to_camera: (4, 4), rigid. The middle of the image is straight ahead.
        width: pixels, a power of two from 4 on; the height is half of it.

    Returns:
        (width / 2, width, 3) float32, linear light with Rec. 709 primaries, not negative.

    Raises:
        FrogError: where no Gaussian is seen at all.
    """
    if width < 4 or width & (width - 1):
        raise ValueError(f"width: {width}, expected a power of two from 4 on")

    drawing = draw_panorama(equirectangular(width, width // 2), world_to_camera, partial(draw, gaussians))
    alpha = np.clip(drawing.alpha, 0.0, 1.0)
    if not (alpha > _SEEN).any():
        raise FrogError("No Gaussian is seen from where the light was to be taken. Choose another place.")
    straight = np.clip(drawing.rgb / np.maximum(alpha, _SEEN)[..., None], 0.0, None)
    return filled(srgb_to_linear(straight), np.where(alpha > _SEEN, alpha, 0.0))


def filled(colors: Array, weights: Array) -> Array:
    """An equirectangular image whose holes have the colours around them, by averages of growing regions.

    Gortler et al., "The Lumigraph" (1996), section 3.5 (pull and push). Pixels count by the part of the sphere that
    they cover.

    Args:
        colors: (H, W, 3), H and W powers of two.
        weights: (H, W) in [0, 1]: 1 keeps a colour, 0 ignores it. Not all 0.

    Returns:
        (H, W, 3) float32.
    """
    height = weights.shape[0]
    areas = np.cos(((np.arange(height) + 0.5) / height - 0.5) * np.pi)[:, None] * np.ones_like(weights)
    known, kept, area = [], [], areas
    weighted, total = colors * (weights * areas)[..., None], weights * areas
    while True:
        known.append(weighted / np.maximum(total, 1e-30)[..., None])
        kept.append(np.clip(total / area, 0.0, 1.0)[..., None])
        if min(total.shape) == 1:
            break
        weighted, total, area = _halved(weighted), _halved(total), _halved(area)
    last = total[..., None]
    result = np.broadcast_to((known[-1] * last).sum((0, 1)) / last.sum(), known[-1].shape)
    result = kept[-1] * known[-1] + (1 - kept[-1]) * result
    for finer, share in zip(known[-2::-1], kept[-2::-1], strict=True):
        result = share * finer + (1 - share) * _doubled(result)
    return np.asarray(result.astype(np.float32))


def _halved(values: Array) -> Array:
    """Sums of 2 x 2 pixels."""
    rows = values[::2] + values[1::2]
    return np.asarray(rows[:, ::2] + rows[:, 1::2])


def _doubled(values: Array) -> Array:
    """Twice as many pixels along both axes, linear between them; the left edge continues at the right one."""
    above, below = np.concatenate([values[:1], values[:-1]]), np.concatenate([values[1:], values[-1:]])
    rows = np.stack([0.75 * values + 0.25 * above, 0.75 * values + 0.25 * below], axis=1)
    rows = rows.reshape(-1, *values.shape[1:])
    left, right = np.roll(rows, 1, axis=1), np.roll(rows, -1, axis=1)
    both = np.stack([0.75 * rows + 0.25 * left, 0.75 * rows + 0.25 * right], axis=2)
    return np.asarray(both.reshape(len(rows), -1, values.shape[2]))
