"""What a training begins with: the scene's scale, and a model made of the seed points."""

from __future__ import annotations

import numpy as np
import torch

from ..capture.capture import Capture
from ..capture.seeds import Seeds
from ..model.baselines.static import Static
from ..model.canonical import CanonicalField, new_gaussians
from ..model.frog import Frog, FrogSettings, rows_for
from .neighbours import spacings
from .recipe import Recipe


def scale_of(capture: Capture, points: np.ndarray) -> float:
    """Median distance from camera to seed point (N, 3), world units."""
    centers = np.array([camera.center for camera in capture.cameras])
    some = points[:: max(1, len(points) // 2000)]
    distances = np.linalg.norm(some[:, None] - centers[None, :: max(1, len(centers) // 20)], axis=2)
    return float(np.median(distances))


def first_model(
    capture: Capture, seeds: Seeds, recipe: Recipe, method: str, scene_scale: float, device: torch.device
) -> Frog | Static:
    """The model before its first step, on ``device``; its random numbers are torch's own of the CPU on any device."""
    points, colors = (torch.from_numpy(array).to(device) for array in (seeds.points, seeds.colors))
    sh_count = (recipe.sh_degree + 1) ** 2
    embedding_size = recipe.embedding_size if method == "frog" else 0
    canonical = CanonicalField(new_gaussians(points, colors, spacings(points), sh_count, embedding_size))
    if method == "frog":
        return Frog(canonical, _settings(capture, recipe, sh_count, scene_scale)).to(device)
    return Static(canonical)


def _settings(capture: Capture, recipe: Recipe, sh_count: int, scene_scale: float) -> FrogSettings:
    rows, coarse_rows = rows_for(capture.frame_count)
    return FrogSettings(
        temporal_rows=rows,
        coarse_rows=coarse_rows,
        temporal_size=recipe.temporal_size,
        embedding_size=recipe.embedding_size,
        hidden_width=recipe.hidden_width,
        head_width=recipe.head_width,
        deformed_sh=min(recipe.deformed_sh, sh_count),
        opacity_reduction=recipe.opacity_reduction,
        opacity_sharpness=recipe.opacity_sharpness,
        motion_unit=0.2 * scene_scale,
    )
