"""Random models, small ones, and the scenes that trainings of them would have written."""

from __future__ import annotations

from dataclasses import replace

import torch
from support.builders import scene_file

from frog_blender.engine.model.canonical import CanonicalField
from frog_blender.engine.model.deformation import FrogSettings
from frog_blender.engine.model.frog import Frog
from frog_blender.engine.model.interface import FINISHED, SceneModel
from frog_blender.engine.scene.scene_file import SceneFile


def model_of(
    settings: FrogSettings, count: int = 200, sh_count: int = 16, seed: int = 1, moving: int | None = None
) -> Frog:
    """Random in everything; changes of the size of what they change; the first ``moving`` Gaussians move, or all."""
    generator = torch.Generator().manual_seed(seed)

    def random(*size: int) -> torch.Tensor:
        return torch.randn(*size, generator=generator)

    values = {"means": random(count, 3), "log_scales": random(count, 3) - 2, "quaternions": random(count, 4)}
    values |= {"opacity_logits": 2 * random(count), "sh": random(count, sh_count, 3)}
    values["embeddings"] = random(count if moving is None else moving, settings.embedding_size)
    model = Frog(CanonicalField(values), settings)
    for parameter in model.deformation.parameters():
        parameter.data = random(*parameter.shape) * (0.5 if parameter.ndim == 1 else parameter.shape[1] ** -0.5)
    return model


def canonical_of(scene: SceneFile, embedding_size: int = 0) -> CanonicalField:
    """Its Gaussians, all of which move."""
    names = ("means", "log_scales", "quaternions", "opacity_logits", "sh")
    values = {name: torch.tensor(scene.arrays[name]) for name in names}
    return CanonicalField(values | {"embeddings": torch.randn(len(values["means"]), embedding_size)})


def scene_of(method: str, model: SceneModel) -> SceneFile:
    arrays = {}
    for name, value in model.state_dict().items():
        arrays[name.removeprefix("canonical.").replace("deformation.", "network.")] = value.numpy()
    if not arrays["embeddings"].size:
        del arrays["embeddings"]
    header = replace(scene_file().header, method=method, model=model.stored_settings(FINISHED))
    return SceneFile(header, arrays)
