"""A grade that gives a scene the mean and the spread of other images (Reinhard et al., "Color Transfer between Images",
2001), channel by channel in display-referred sRGB."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..arrays import Array
from ..errors import FrogError
from ..playback.importance import sampled_views
from ..playback.player import ScenePlayer
from ..playback.render import draw

_MOST_VIEWS = 12
_LONGEST_SIDE = 160  # pixels
_LEAST_SPREAD = 1e-3  # of a channel: what has less is one colour
_MOST_GAIN = 10.0


@dataclass(frozen=True)
class Colors:
    """Mean and standard deviation of display-referred colours, (3,) each."""

    mean: Array
    spread: Array

    @classmethod
    def of_pixels(cls, pixels: Array, weights: Array | None = None) -> Colors:
        """Of (P, 3) colours.

        Raises:
            FrogError: if there are none, or they are not finite.
        """
        if weights is None:
            weights = np.ones(len(pixels))
        if not len(pixels) or not np.isfinite(pixels).all() or not weights.sum() > 0:
            raise FrogError("Found no finite colours, expected an image of something.")
        values = pixels.astype(np.float64)
        mean = np.average(values, axis=0, weights=weights)
        return cls(mean, np.sqrt(np.average(np.square(values - mean), axis=0, weights=weights)))

    @classmethod
    def of_scene(cls, scene: ScenePlayer) -> Colors:
        """Of what a scene's own cameras see of it, spread over cameras and times.

        Raises:
            FrogError: for a scene without cameras.
        """
        pixels, weights = [], []
        for camera, frame in sampled_views(scene.header, _MOST_VIEWS):
            if camera is None:
                raise FrogError("Found a capture without cameras, expected one whose images can be matched.")
            factor = min(1.0, _LONGEST_SIDE / max(camera.width, camera.height))
            small = camera.resized(max(1, round(camera.width * factor)), max(1, round(camera.height * factor)))
            image = draw(scene.at_frame(frame), small)
            alpha = image.alpha.reshape(-1)
            pixels.append(np.clip(image.rgb.reshape(-1, 3) / np.maximum(alpha, 1e-3)[:, None], 0, 1))
            weights.append(np.where(alpha > 0.5, alpha, 0.0))
        return cls.of_pixels(np.concatenate(pixels), np.concatenate(weights))


def matched(own: Colors, wanted: Colors) -> tuple[Array, Array]:
    """(3,) gains and (3,) offsets that take colours to the mean and the spread that are wanted."""
    gains = np.clip(wanted.spread / np.maximum(own.spread, _LEAST_SPREAD), 1 / _MOST_GAIN, _MOST_GAIN)
    return gains, wanted.mean - gains * own.mean
