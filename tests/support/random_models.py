"""Random FRoG models, small ones."""

from __future__ import annotations

import torch

from frog_blender.engine.model.canonical import CanonicalField
from frog_blender.engine.model.deformation import FrogSettings
from frog_blender.engine.model.frog import Frog


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
