"""Gaussians, for a camera at the origin looking along +z, that cannot be drawn, or that are drawn at the edge of it."""

import numpy as np
from support.builders import one_gaussian

from frog_blender.engine.gaussians import NumpyGaussians, joined

NAN, INF = float("nan"), float("inf")

INVISIBLE = {
    "NaN mean": one_gaussian((NAN, 0, 1)),
    "infinite mean": one_gaussian((0, INF, 1)),
    "infinitely deep": one_gaussian((0, 0, INF)),
    "zero quaternion": one_gaussian((0, 0, 1), quaternions=[[0.0, 0, 0, 0]]),
    "NaN quaternion": one_gaussian((0, 0, 1), quaternions=[[1, NAN, 0, 0]]),
    "infinite quaternion": one_gaussian((0, 0, 1), quaternions=[[INF, 0, 0, 0]]),
    "NaN opacity": one_gaussian((0, 0, 1), opacities=[NAN]),
    "infinite opacity": one_gaussian((0, 0, 1), opacities=[INF]),
    "negative opacity": one_gaussian((0, 0, 1), opacities=[-0.5]),
    "opacity below 1/255": one_gaussian((0, 0, 1), opacities=[0.0039]),
    "opacity of exactly 1/255": one_gaussian((0, 0, 1), opacities=[1 / 255]),
    "NaN scale": one_gaussian((0, 0, 1), scales=[[0.1, NAN, 0.1]]),
    "infinite scale": one_gaussian((0, 0, 1), scales=[[0.1, INF, 0.1]]),
    "scale beyond float": one_gaussian((0, 0, 1), scales=[[3e38, 3e38, 3e38]]),
    "scale of 1e30": one_gaussian((0, 0, 1), scales=[[1e30, 0.1, 0.1]]),
    "scales of 1e30": one_gaussian((0, 0, 1), scales=[[1e30, 1e30, 1e30]]),
    "position of 1e30": one_gaussian((1e30, 0, 1)),
    "quaternion of 1e30": one_gaussian((0, 0, 1), quaternions=[[1e30, 0, 0, 0]]),
    "NaN colour": one_gaussian((0, 0, 1), sh=[[[NAN, 0, 0]]]),
    "infinite colour": one_gaussian((0, 0, 1), sh=[[[0, INF, 0]]]),
    "behind the camera": one_gaussian((0, 0, -1)),
    "at the camera": one_gaussian((0, 0, 0)),
    "before the near plane": one_gaussian((0, 0, 0.0099)),
    "off the screen": one_gaussian((50, 0, 1)),
}

# Drawn or not, these must leave a finite image.
STRANGE = {
    "on the near plane": one_gaussian((0, 0, 0.01)),
    "just behind the near plane": one_gaussian((0.0001, 0, 0.0101), scales=[[1.0, 1.0, 1.0]]),
    "huge": one_gaussian((0, 0, 2), scales=[[1e4, 1e4, 1e4]]),
    "gigantic": one_gaussian((0, 0, 2), scales=[[1e9, 1e9, 1e9]]),
    "zero scale": one_gaussian((0, 0, 2), scales=[[0.0, 0, 0]]),
    "negative scale": one_gaussian((0, 0, 2), scales=[[-0.1, 0.1, 0.1]]),
    "opacity above one": one_gaussian((0, 0, 2), opacities=[7.0]),
    "opacity of one": one_gaussian((0, 0, 2), opacities=[1.0]),
    "tiny quaternion": one_gaussian((0, 0, 2), quaternions=[[1e-9, 1e-9, 0, 0]]),
    "needle": one_gaussian((0, 0, 2), scales=[[1e3, 1e-9, 1e-9]], quaternions=[[1, 0.3, 0.7, 0.2]]),
    "far away": one_gaussian((0, 0, 1e9), scales=[[1e7, 1e7, 1e7]]),
    "very bright": one_gaussian((0, 0, 2), sh=[[[1e6, 1e6, 1e6]]]),
    "far to the side, wide": one_gaussian((1e6, 0, 2), scales=[[1e6, 1e6, 1e6]]),
}


def scattered(good: NumpyGaussians) -> tuple[NumpyGaussians, np.ndarray]:
    """These with everything that is invisible among them, one before each, and which ones they are then."""
    parts: list[NumpyGaussians] = []
    for index, bad in enumerate(INVISIBLE.values()):
        parts += [bad, good.part(slice(index, index + 1))]
    kept = 2 * np.arange(len(INVISIBLE)) + 1
    rest = good.part(slice(len(INVISIBLE), None))
    return joined([*parts, rest]), np.concatenate([kept, kept[-1] + 1 + np.arange(len(rest))])
