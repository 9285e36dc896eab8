"""The field computed by the native library, or on a GPU by kernels (float32), without automatic differentiation.

``FusedRenderResult`` is an image that was made by native calls one after the other, and so is its backward pass. It is
held equal to automatic differentiation of plain torch, which keeps track of some twenty arrays between deformation and
rasterizer and takes a tenth of a training's step for that.
"""

from dataclasses import dataclass

import torch

from ..arrays import Array
from ..capture.camera import NEUTRAL
from ..cuda import field as cuda_field
from ..field.network import first_layer, first_layer_gradients
from ..gaussians import LOW_PASS, TorchGaussians
from ..native.deformation import FieldShape, deform, deform_backward
from ..rasterizer import GaussianArrays
from ..rasterizer.differentiable import RasterPass, gains_of
from .canonical import ATTRIBUTES, CanonicalField
from .deformation import DeformationField
from .interface import RenderResult

_LAYER_INPUTS = ("temporal", "temporal_weight", "bias", "embedding_weight", "modulation_weight")
_LAYER_OUTPUTS = ("shared", "embedding_weight")


@dataclass(frozen=True)
class FieldPass:
    """A forward pass through the fused field, kept for its backward pass; without automatic differentiation.

    It does not hold the outputs: they would refer to it and it to them, and neither would be freed.

    Attributes:
        shape: settings.
        inputs: of the first layer.
        arrays: as the library was given them.
    """

    shape: FieldShape
    inputs: dict[str, Array]
    arrays: dict[str, torch.Tensor]

    def backward(self, by_outputs: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """Gradients by name of what ``forward_field`` was given, from contiguous ones by the Gaussians' attributes."""
        gradients = {name: torch.empty_like(array) for name, array in self.arrays.items()}
        deform_backward(self.shape, self.arrays, by_outputs, gradients)
        by_layer = [gradients.pop(name).numpy() for name in _LAYER_OUTPUTS]
        others = [self.inputs.get(name) for name in ("temporal", "temporal_weight", "modulation_weight")]
        of_inputs = first_layer_gradients(*by_layer, *others)
        return gradients | {name: torch.from_numpy(gradient) for name, gradient in of_inputs.items()}


def forward_field(
    shape: FieldShape, arrays: dict[str, torch.Tensor], low_pass: float = LOW_PASS
) -> tuple[FieldPass, TorchGaussians, torch.Tensor]:
    """A pass, the deformed, activated Gaussians with ``shape.sh_active`` coefficients, and the changes (M, outputs) of
    those that move, means in world units.

    Args:
        shape: settings.
        arrays: float32 tensors on the CPU by name: the canonical field's attributes, ``temporal``
            (networks, T), the fused temporal embedding of the time, and the network's layers.
        low_pass: the Gaussians'.
    """
    arrays = {name: array.detach().contiguous() for name, array in arrays.items()}
    inputs = {name: arrays.pop(name).numpy() for name in _LAYER_INPUTS if name in arrays}
    arrays |= dict(zip(_LAYER_OUTPUTS, map(torch.from_numpy, first_layer(**inputs)), strict=True))
    count, embeddings = len(arrays["means"]), arrays["embeddings"]
    shapes = shape.result_shapes.items()
    result = {name: torch.empty((count, *own), dtype=torch.float32, device="cpu") for name, own in shapes}
    changes = embeddings.new_empty((len(embeddings), shape.outputs))
    deform(shape, arrays, {**result, "changes": changes})
    return FieldPass(shape, inputs, arrays), GaussianArrays.of(result, low_pass), changes


def field_arrays(
    canonical: CanonicalField, network: DeformationField, **temporal: torch.Tensor
) -> dict[str, torch.Tensor]:
    """What ``forward_field`` is given; ``temporal`` is the array of this name, or on a GPU ``temporal_table``."""
    arrays = {name: getattr(canonical, name) for name in ATTRIBUTES}
    return arrays | temporal | dict(network.named_parameters())


@dataclass(frozen=True)
class FusedRenderResult(RenderResult):
    """See RenderResult.

    Attributes:
        arrays: what was drawn, by name: parameters, and on the CPU ``temporal`` with the gradients' way to the table.
        pose: the camera's, to receive its gradient, or None.
        field, drawing: for the backward pass.
        silent_rows: rows of the network's outputs that no gradient passes; None where there are none.
        versions: of arrays and Gaussians, when they were drawn.
    """

    arrays: dict[str, torch.Tensor]
    pose: torch.Tensor | None
    field: FieldPass | cuda_field.FieldPass
    drawing: RasterPass
    silent_rows: slice | None
    versions: list[int]

    @property
    def state(self) -> torch.Tensor | None:
        """See RenderResult."""
        return self.drawing.state

    def backward(self, by_rgb: torch.Tensor, by_alpha: torch.Tensor | None = None) -> None:
        """See RenderResult; RuntimeError when an array has been changed in place since."""
        if versions_of(self.arrays, self.gaussians) != self.versions:
            raise RuntimeError("one of the scene's arrays has been changed since the image was drawn")
        if self.drawing.camera.exposure != NEUTRAL:
            by_rgb = by_rgb * gains_of(self.drawing.camera, by_rgb)
        by_gaussians = self.drawing.backward(by_rgb, by_alpha, None if self.pose is None else self.pose.shape)
        self.image.screen.grad = by_gaussians.pop("screen")
        if self.pose is not None:
            self.pose.grad = by_gaussians.pop("pose")
        gradients = self.field.backward(by_gaussians)
        if self.silent_rows is not None:
            for name in ("output_weight", "output_bias"):
                gradients[name][self.silent_rows] = 0
        if "temporal" in gradients:
            self.arrays["temporal"].backward(gradients.pop("temporal"))
        for name, gradient in gradients.items():
            parameter = self.arrays[name]
            parameter.grad = gradient if parameter.grad is None else parameter.grad + gradient


def versions_of(arrays: dict[str, torch.Tensor], gaussians: TorchGaussians) -> list[int]:
    """How often each array, and each of what was drawn from them, has been changed in place."""
    return [array._version for array in (*arrays.values(), *gaussians.arrays.values())]
