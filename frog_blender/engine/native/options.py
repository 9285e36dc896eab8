"""Settings of one drawing, and the constants of the blending rule that all implementations share."""

from dataclasses import dataclass, field

import numpy as np

from ..arrays import Array
from ..capture.camera import MAX_SIDE, Camera

ALPHA_MIN = 1.0 / 255.0
"""Fainter contributions are skipped."""
ALPHA_MAX = 0.999
"""Alpha is clamped here, and passes no gradient to the Gaussian's shape beyond it."""
TRANSMITTANCE_MIN = 1e-4
"""The Gaussian that would take a pixel's transmittance below this is left out, and so is everything behind it."""
MAX_PIXELS = 2**30
"""Of what is drawn at once."""


@dataclass(frozen=True)
class RasterizeOptions:
    """What to draw besides RGB and alpha, and how.

    Attributes:
        depth: also median and mean depth.
        weights: also each Gaussian's largest blending weight.
        near_plane: planar depth below which a Gaussian is culled, world units.
        region: (left, top, width, height) in pixels, the only part of the camera's image that is drawn; images
            then have its size. None is all of it.
        depth_limit: (H, W) float32 of the region, planar depth beyond which nothing is drawn; None for no limit.
    """

    depth: bool = False
    weights: bool = False
    near_plane: float = 0.01
    region: tuple[int, int, int, int] | None = None
    depth_limit: Array | None = field(default=None, compare=False)

    def region_of(self, camera: Camera) -> tuple[int, int, int, int]:
        """The region, checked; ValueError for one that is empty, too large or reaches out of the camera's image."""
        region = self.region or (0, 0, camera.width, camera.height)
        left, top, width, height = region
        if min(left, top) < 0 or min(width, height) < 1 or left + width > camera.width or top + height > camera.height:
            raise ValueError(f"region {region} does not lie in an image of {camera.width} x {camera.height}")
        if max(camera.width, camera.height) > MAX_SIDE or width * height > MAX_PIXELS:
            raise ValueError(f"region {region} is too large to draw, expected sides of at most {MAX_SIDE} pixels")
        return region

    def new_image(self, camera: Camera, count: int) -> dict[str, Array]:
        """What a drawing of ``count`` Gaussians fills, by name: see ``binding.Frame``. The numbers are not set."""
        size = self.region_of(camera)[3:1:-1]
        image = {"rgb": np.empty((*size, 3), np.float32), "alpha": np.empty(size, np.float32)}
        if self.depth:
            image |= {"median_index": np.empty(size, np.int32), "mean_depth": np.empty(size, np.float32)}
        return image | ({"max_weights": np.empty(count, np.float32)} if self.weights else {})
