"""The deformation of all Gaussians as one torch operation, computed by the native library (float32 on the CPU)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch

from ..field.first_layer import first_layer, first_layer_gradients
from ..native.deformation import FieldShape, deform, deform_backward
from ..rasterizer import GaussianArrays
from .canonical import ATTRIBUTES, CanonicalField
from .deformation import DeformationField

_OUTPUTS = ("means", "quaternions", "scales", "opacities", "sh")
_NETWORK = ("output_weight", "output_bias")
_HEADS = ("head_weight", "head_bias")
_FIRST_LAYER = ("temporal_weight", "bias", "embedding_weight")
_MODULATION = ("modulation_weight",)
_LAYER_INPUTS, _LAYER_OUTPUTS = ("temporal", *_FIRST_LAYER, *_MODULATION), ("shared", "embedding_weight")


@dataclass(frozen=True)
class FieldPass:
    """What a pass through the fused field needs for its way back; without automatic differentiation.

    It does not hold what came out: outputs that know their way back and are known there would never be freed.

    Attributes:
        shape: settings.
        inputs: of the first layer.
        arrays: as the library was given them.
    """

    shape: FieldShape
    inputs: dict[str, np.ndarray]
    arrays: dict[str, torch.Tensor]

    def backward(self, by_outputs: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """Gradients by name of what ``forward_field`` was given, from contiguous ones by the Gaussians' attributes."""
        gradients = {name: torch.empty_like(array) for name, array in self.arrays.items()}
        deform_backward(self.shape, self.arrays, by_outputs, gradients)
        by_layer = [gradients.pop(name).numpy() for name in _LAYER_OUTPUTS]
        others = [self.inputs.get(name) for name in ("temporal", "temporal_weight", *_MODULATION)]
        found = first_layer_gradients(*by_layer, *others)
        return gradients | {name: torch.from_numpy(gradient) for name, gradient in found.items()}


def forward_field(shape: FieldShape, arrays: dict[str, torch.Tensor]) -> tuple[FieldPass, GaussianArrays, torch.Tensor]:
    """A pass, the deformed, activated Gaussians with ``shape.sh_active`` coefficients, and the changes (M, outputs) of
    those that move, means in world units.

    Args:
        shape: settings.
        arrays: float32 tensors on the CPU by name: the canonical field's attributes, ``temporal``
            (networks, T), the fused temporal embedding of the moment, and the network's layers.
    """
    arrays = {name: array.detach().contiguous() for name, array in arrays.items()}
    inputs = {name: arrays.pop(name).numpy() for name in _LAYER_INPUTS if name in arrays}
    arrays |= dict(zip(_LAYER_OUTPUTS, map(torch.from_numpy, first_layer(**inputs)), strict=True))
    count, embeddings = len(arrays["means"]), arrays["embeddings"]
    sizes = {"means": (3,), "quaternions": (4,), "scales": (3,), "opacities": (), "sh": (shape.sh_active, 3)}
    result = {name: torch.empty((count, *sizes[name]), dtype=torch.float32, device="cpu") for name in _OUTPUTS}
    changes = embeddings.new_empty((len(embeddings), shape.outputs))
    deform(shape, arrays, {**result, "changes": changes})
    return FieldPass(shape, inputs, arrays), GaussianArrays(**result), changes


class _Deform(torch.autograd.Function):
    """Inputs in the order of ``names`` after ``shape`` and ``names``; outputs _OUTPUTS and the changes."""

    @staticmethod
    def forward(
        ctx: Any, shape: FieldShape, names: tuple[str, ...], *tensors: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        ctx.field, gaussians, changes = forward_field(shape, dict(zip(names, tensors, strict=True)))
        result = [getattr(gaussians, name) for name in _OUTPUTS]
        ctx.names, ctx.sizes = names, [array.shape for array in result]
        ctx.save_for_backward(*tensors)  # torch refuses tensors changed since
        ctx.mark_non_differentiable(changes)
        ctx.set_materialize_grads(False)  # of the changes: zeros that nobody reads
        return *result, changes

    @staticmethod
    def backward(ctx: Any, *by: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        some = ctx.saved_tensors[0]
        by_outputs = {
            name: some.new_zeros(size) if gradient is None else gradient.contiguous()
            for name, size, gradient in zip(_OUTPUTS, ctx.sizes, by, strict=False)
        }
        found = ctx.field.backward(by_outputs)
        return None, None, *(found[name] for name in ctx.names)


def field_arrays(
    canonical: CanonicalField, network: DeformationField, temporal: torch.Tensor
) -> dict[str, torch.Tensor]:
    """What ``forward_field`` is given."""
    arrays = {name: getattr(canonical, name) for name in ATTRIBUTES}
    names = (*_FIRST_LAYER, *(_MODULATION if network.modulated else ()))
    names += (*_NETWORK, *(_HEADS if network.head_width else ()))
    return arrays | {"temporal": temporal} | {name: getattr(network, name) for name in names}


def deform_fused(
    canonical: CanonicalField, network: DeformationField, temporal: torch.Tensor, shape: FieldShape
) -> tuple[GaussianArrays, torch.Tensor]:
    """Deformed, activated Gaussians with ``shape.sh_active`` coefficients, and the changes (M, outputs) of those
    that move, means in world units, without gradients.

    Args:
        temporal: (networks, T) fused temporal embedding of the moment.
    """
    arrays = field_arrays(canonical, network, temporal)
    *outputs, changes = _Deform.apply(shape, tuple(arrays), *arrays.values())
    return GaussianArrays(**dict(zip(_OUTPUTS, outputs, strict=True))), changes
