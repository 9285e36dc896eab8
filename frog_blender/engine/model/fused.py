"""The deformation of all Gaussians as one torch operation, computed by the native library (float32 on the CPU)."""

from __future__ import annotations

from typing import Any

import torch

from ..rasterizer import GaussianArrays
from ..rasterizer.native_deformation import FieldShape, deform, deform_backward
from .canonical import ATTRIBUTES, CanonicalField
from .deformation import DeformationField
from .first_layer import first_layer, first_layer_gradients

_OUTPUTS = ("means", "quaternions", "scales", "opacities", "sh")
_NETWORK = ("output_weight", "output_bias")
_HEADS = ("head_weight", "head_bias")
_FIRST_LAYER = ("temporal_weight", "bias", "embedding_weight")
_MODULATION = ("modulation_weight",)
_LAYER_INPUTS, _LAYER_OUTPUTS = ("temporal", *_FIRST_LAYER, *_MODULATION), ("shared", "embedding_weight")


class _Deform(torch.autograd.Function):
    """Inputs in the order of ``names`` after ``shape`` and ``names``; outputs _OUTPUTS and the changes."""

    @staticmethod
    def forward(
        ctx: Any, shape: FieldShape, names: tuple[str, ...], *tensors: torch.Tensor
    ) -> tuple[torch.Tensor, ...]:
        tensors = tuple(tensor.contiguous() for tensor in tensors)
        arrays = dict(zip(names, tensors, strict=True))
        layer = first_layer(**{name: arrays.pop(name).numpy() for name in _LAYER_INPUTS if name in arrays})
        ctx.layer = dict(zip(_LAYER_OUTPUTS, map(torch.from_numpy, layer), strict=True))
        arrays |= ctx.layer
        count = len(tensors[0])
        sizes = {"means": (3,), "quaternions": (4,), "scales": (3,), "opacities": (), "sh": (shape.sh_active, 3)}
        result = {name: torch.empty((count, *sizes[name]), dtype=torch.float32, device="cpu") for name in _OUTPUTS}
        result["changes"] = arrays["embeddings"].new_empty((len(arrays["embeddings"]), shape.outputs))
        deform(shape, arrays, result)
        ctx.shape, ctx.names, ctx.sizes = shape, names, {name: result[name].shape for name in _OUTPUTS}
        ctx.save_for_backward(*tensors)
        ctx.mark_non_differentiable(result["changes"])
        ctx.set_materialize_grads(False)  # of the changes: zeros that nobody reads
        return tuple(result.values())

    @staticmethod
    def backward(ctx: Any, *by: torch.Tensor) -> tuple[torch.Tensor | None, ...]:
        arrays = dict(zip(ctx.names, ctx.saved_tensors, strict=True))
        inputs = {name: arrays.pop(name).numpy() for name in _LAYER_INPUTS if name in arrays}
        arrays |= ctx.layer
        gradients = {name: torch.empty_like(array) for name, array in arrays.items()}
        some = ctx.saved_tensors[0]
        by_outputs = {
            name: some.new_zeros(ctx.sizes[name]) if gradient is None else gradient.contiguous()
            for name, gradient in zip(_OUTPUTS, by, strict=False)
        }
        deform_backward(ctx.shape, arrays, by_outputs, gradients)
        by_shared, by_weights = (gradients.pop(name).numpy() for name in _LAYER_OUTPUTS)
        found = first_layer_gradients(
            by_shared, by_weights, inputs["temporal"], inputs["temporal_weight"], inputs.get("modulation_weight")
        )
        gradients |= {name: torch.from_numpy(gradient) for name, gradient in found.items()}
        return (None, None, *(gradients[name] for name in ctx.names))


def deform_fused(
    canonical: CanonicalField, network: DeformationField, temporal: torch.Tensor, shape: FieldShape
) -> tuple[GaussianArrays, torch.Tensor]:
    """Deformed, activated Gaussians with ``shape.sh_active`` coefficients, and the changes (M, outputs) of those
    that move, means in world units, without gradients.

    Args:
        temporal: (networks, T) fused temporal embedding of the moment.
    """
    arrays = {name: getattr(canonical, name) for name in ATTRIBUTES}
    names = (*_FIRST_LAYER, *(_MODULATION if network.modulated else ()))
    names += (*_NETWORK, *(_HEADS if network.head_width else ()))
    arrays |= {"temporal": temporal} | {name: getattr(network, name) for name in names}
    *outputs, changes = _Deform.apply(shape, tuple(arrays), *arrays.values())
    return GaussianArrays(**dict(zip(_OUTPUTS, outputs, strict=True))), changes
