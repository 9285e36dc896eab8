"""What a training begins with: the scene's scale, and a model made of the seed points."""

from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from ...capture.capture import Capture
from ...capture.seeds import Seeds
from ...model.canonical import CanonicalField, new_gaussians
from ...model.frog import Frog
from ...model.interface import SceneModel
from ...model.time_windows import open_windows
from ...rasterizer import RasterizeOptions
from ...recipes import Recipe
from ...registry import METHODS
from ..methods import ModelInit
from .neighbours import spacings


def scale_of(capture: Capture, points: NDArray[np.float32]) -> float:
    """Median distance from camera to seed point (N, 3), world units."""
    centers = np.array([camera.center for camera in capture.cameras])
    some = points[:: max(1, len(points) // 2000)]
    distances = np.linalg.norm(some[:, None] - centers[None, :: max(1, len(centers) // 20)], axis=2)
    return float(np.median(distances))


def doubt_of_scale(scene_scale: float) -> str | None:
    """What is to be said of a scene that is small beside the near plane, in front of which nothing is drawn."""
    near = RasterizeOptions.near_plane
    if scene_scale >= 10 * near:
        return None
    return (
        f"The scene is {scene_scale:.2g} units away from its cameras, and nothing nearer than {near} is drawn: "
        "expected camera poses in larger units, such as metres."
    )


def first_model(
    capture: Capture, seeds: Seeds, recipe: Recipe, method: str, scene_scale: float, device: torch.device
) -> SceneModel:
    """The model before its first step, on ``device``; its random numbers are of the CPU's generator, on any device."""
    points, colors = (torch.from_numpy(array).to(device) for array in (seeds.points, seeds.colors))
    sh_count = (recipe.sh_degree + 1) ** 2
    canonical = CanonicalField(new_gaussians(points, colors, spacings(points), sh_count, recipe.embedding_size))
    canonical.low_pass = recipe.low_pass
    begin = ModelInit(canonical, recipe, capture.frame_count, len(capture.train_shots), scene_scale)
    if seeds.frames is not None and recipe.moments_for(capture.frame_count, len(capture.train_shots)):
        begin = replace(begin, times=torch.from_numpy(seeds.frames / max(capture.frame_count - 1, 1)).to(device))
    model: SceneModel = METHODS[method].model(begin).to(device)
    if begin.times is not None and isinstance(model, Frog):
        open_windows(model, begin.times)
    return model
