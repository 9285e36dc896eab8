"""The baselines' finished scenes, played by the models that were trained: torch alone knows their formulas."""

from collections.abc import Callable
from dataclasses import fields
from math import inf
from typing import Any

import numpy as np
import torch

from ...engine import CanonicalField, JsonMapping, NumpyGaussians, SceneArrays, SceneModel, restored


class Playable:
    """Moves a scene's Gaussians as training did.

    Args:
        model: makes the model of canonical Gaussians and settings.
        settings: their type. Its ``changing`` are the columns that are not the same at all times.
        arrays: the scene file's.
        stored: the model's settings in its header.

    Raises:
        KeyError, RuntimeError, TypeError, ValueError: arrays and settings are not those of one model.
    """

    def __init__(
        self, model: Callable[[Any, Any], SceneModel], settings: type[Any], arrays: SceneArrays, stored: JsonMapping
    ) -> None:
        chosen = {field.name: stored[field.name] for field in fields(settings)}
        for name, value in chosen.items():
            if not all(0 <= entry < inf for entry in (value if isinstance(value, list | tuple) else [value])):
                raise ValueError(f"{name} is {value}, expected numbers from 0 on")
        shape = settings(**chosen)

        def build(canonical: CanonicalField) -> SceneModel:
            with torch.device("meta"):  # nothing is allocated for sizes that the arrays do not have
                return model(canonical, shape)

        none = np.empty((len(arrays["means"]), 0), np.float32)
        self._model = restored(build, {"embeddings": none, **arrays})
        for name, value in self._model.state_dict().items():
            if not value.isfinite().all():
                raise ValueError(f"{name} holds numbers that are not finite")
            if name == "deformation.extent" and not (value > 0).all():
                raise ValueError(f"{name} is {value.tolist()}, expected numbers above 0")
        self.num_dynamic = len(self._model.canonical)
        self.changing: frozenset[str] = shape.changing
        self.at(0.0)  # what cannot be played is refused now

    @torch.inference_mode()
    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated; quaternions are not normalised."""
        gaussians, _ = self._model.deform(time)
        return gaussians.mapped(torch.Tensor.numpy)
