"""Drawing finished Gaussians without torch, and moving them about."""

from dataclasses import dataclass, replace

import numpy as np

from ..arrays import Array
from ..capture.camera import NEUTRAL, Camera
from ..gaussians import NumpyGaussians
from ..native.options import RasterizeOptions
from ..notices import say
from .painter import painter

_PIXELS_AT_ONCE = 2**22  # of a large image


@dataclass
class Drawing:
    """One image, all float32.

    Attributes:
        rgb: (H, W, 3) display-referred, over the background (over black: premultiplied by alpha).
        alpha: (H, W) coverage.
        median_depth: (H, W) Euclidean distance to the centre of the Gaussian that takes transmittance through one half.
        median_z: (H, W) planar depth of the same.
        mean_depth: (H, W) planar depth averaged by blending weight. All depths are NaN where nothing is.
        median_index: (H, W) int32, which Gaussian the median depth is that of; -1 where nothing is.
        notice: what a user is to know of it, see ``Painter.paint``; "" for nothing.
    """

    rgb: Array
    alpha: Array
    median_depth: Array
    median_z: Array
    mean_depth: Array
    median_index: Array
    notice: str = ""


def draw(
    gaussians: NumpyGaussians,
    camera: Camera,
    background: tuple[float, float, float] = (0.0, 0.0, 0.0),
    options: RasterizeOptions | None = None,
    depth_limit: Array | None = None,
) -> Drawing:
    """What ``camera`` sees of ``gaussians``, exactly as in training; arguments as in ``rasterizer.rasterize``.

    A notice is not said here: Blender's renders report it in their own way.
    """
    gaussians = gaussians.checked()
    options = replace(options or RasterizeOptions(), depth=True)
    image = options.new_image(camera, len(gaussians))
    median_index = image["median_index"]
    if depth_limit is not None:
        depth_limit = np.ascontiguousarray(depth_limit, np.float32)
        if depth_limit.shape != median_index.shape:
            raise ValueError(f"depth_limit: shape {depth_limit.shape}, expected {median_index.shape}")
    notice = painter().paint(gaussians, camera, background, replace(options, depth_limit=depth_limit), image)
    if camera.exposure != NEUTRAL:
        np.multiply(image["rgb"], np.asarray(camera.exposure, np.float32), out=image["rgb"])
    # Elementwise on rows of x, y and z: a matrix product would round a depth by which other Gaussians there are.
    offsets = np.ascontiguousarray(gaussians.means.T) - camera.center.astype(np.float32)[:, None]
    missing = np.full(1, np.nan, np.float32)  # index -1 picks it
    distances = np.concatenate([np.linalg.norm(offsets, axis=0), missing])
    planar = np.concatenate([(offsets * camera.forward.astype(np.float32)[:, None]).sum(axis=0), missing])
    depths = distances[median_index], planar[median_index], image["mean_depth"]
    return Drawing(image["rgb"], image["alpha"], *depths, median_index, notice)


def render_image(
    gaussians: NumpyGaussians, camera: Camera, background: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> Array:
    """(H, W, 3) uint8: the colours of ``draw`` alone, in little more memory than the result takes."""
    gaussians = gaussians.checked()
    _, _, width, height = RasterizeOptions().region_of(camera)
    result = np.empty((height, width, 3), np.uint8)
    rows = max(1, _PIXELS_AT_ONCE // width)
    for top in range(0, height, rows):
        options = RasterizeOptions(region=(0, top, width, min(rows, height - top)))
        image = options.new_image(camera, len(gaussians))
        say(painter().paint(gaussians, camera, background, options, image))
        if camera.exposure != NEUTRAL:
            image["rgb"] *= np.asarray(camera.exposure, np.float32)
        result[top : top + rows] = to_uint8(image["rgb"])
    return result


def to_uint8(rgb: Array) -> Array:
    """Display-referred floats to bytes, rounded."""
    return (np.clip(rgb, 0, 1) * 255 + 0.5).astype(np.uint8)
