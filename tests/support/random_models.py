"""Random models, small ones, and the scenes that trainings of them would have written."""

from dataclasses import replace

import torch
from support.builders import scene_file

from frog_blender.engine.model.canonical import CanonicalField, new_gaussians
from frog_blender.engine.model.deformation import FrogSettings
from frog_blender.engine.model.frog import Frog
from frog_blender.engine.model.interface import FINISHED, SceneModel
from frog_blender.engine.recipes import recipe
from frog_blender.engine.registry import METHODS
from frog_blender.engine.scene.scene_file import SceneFile
from frog_blender.engine.training.methods import ModelInit

COUNT = 40  # Gaussians of a baseline


def model_of(
    settings: FrogSettings, count: int = 200, sh_count: int = 16, seed: int = 1, moving: int | None = None
) -> Frog:
    """Random in everything; changes of the size of what they change; the first ``moving`` Gaussians move, or all."""
    generator = torch.Generator().manual_seed(seed)
    torch.manual_seed(seed)  # a new temporal table is drawn from it

    def random(*size: int) -> torch.Tensor:
        return torch.randn(*size, generator=generator)

    values = {"means": random(count, 3), "log_scales": random(count, 3) - 2, "quaternions": random(count, 4)}
    values |= {"opacity_logits": 2 * random(count), "sh": random(count, sh_count, 3)}
    values["embeddings"] = random(count if moving is None else moving, settings.embedding_size)
    model = Frog(CanonicalField(values), settings)
    for parameter in model.deformation.parameters():
        parameter.data = random(*parameter.shape) * (0.5 if parameter.ndim == 1 else parameter.shape[1] ** -0.5)
    return model


def canonical(embedding_size: int = 0) -> CanonicalField:
    generator = torch.Generator().manual_seed(1)
    points = torch.randn(COUNT, 3, generator=generator)
    colors = torch.rand(COUNT, 3, generator=generator)
    return CanonicalField(new_gaussians(points, colors, torch.full((COUNT,), 0.1), 4, embedding_size))


def built(method: str, **settings: object) -> SceneModel:
    torch.manual_seed(0)
    adapted = METHODS[method].adapted(recipe("draft", **settings))
    return METHODS[method].model(ModelInit(canonical(adapted.embedding_size), adapted, 9, 36, 3.0))


def perturbed(model: SceneModel) -> SceneModel:
    """With outputs and curves that are not zero."""
    generator = torch.Generator().manual_seed(2)
    for name, parameter in model.named_parameters():
        if "output" in name or "embeddings" in name or "time_planes" in name:
            parameter.data = parameter.data + torch.randn(parameter.shape, generator=generator) * 0.3
    return model


def scene_of(method: str, model: SceneModel) -> SceneFile:
    arrays = {}
    for name, value in model.state_dict().items():
        arrays[name.removeprefix("canonical.").replace("deformation.", "network.")] = value.numpy()
    if not arrays["embeddings"].size:
        del arrays["embeddings"]
    header = replace(scene_file().header, method=method, model=model.stored_settings(FINISHED))
    return SceneFile(header, arrays)
