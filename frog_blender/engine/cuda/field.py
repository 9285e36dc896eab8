"""The deformation field on a GPU: one launch forward, three backward, and nothing that the host waits for."""

from collections.abc import Sequence
from ctypes import Structure
from dataclasses import dataclass

import numpy as np
import torch

from ..arrays import Array
from ..field.names import FUSIONS
from ..field.network import num_outputs
from ..gaussians import GaussianArrays, TorchGaussians
from ..native import structs
from ..native.deformation import FieldShape
from . import launch
from .sources import kernel

_EMBEDDINGS, _OUTPUTS = (32, 48, 64), (16, 64)  # what kernels are compiled for; less is padded
_TEMPORAL = 1024  # TEMPORAL in kernels/field.cuh
_BLOCKS = 264  # of the backward pass at most: each leaves sums of its own, in as much memory as the weights take


def can_compute(fusion: str, temporal_size: int, embedding_size: int, head_width: int) -> bool:
    """Whether there are kernels for a field; plain torch computes others (the papers' heads, fusion by attention)."""
    return (
        not head_width
        and fusion != "attention"
        and 2 * temporal_size <= _TEMPORAL
        and embedding_size <= _EMBEDDINGS[-1]
    )


@dataclass(frozen=True)
class FieldPass:
    """As ``model.fused.FieldPass``.

    Attributes:
        sizes: structs.FieldSizes.
        arrays: what ``forward_field`` was given.
        drawn: what of its results the backward pass reads.
    """

    sizes: Structure
    arrays: dict[str, torch.Tensor]
    drawn: dict[str, torch.Tensor]

    def backward(self, by_outputs: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
        """Gradients by name of ``arrays``, from contiguous ones by the Gaussians' attributes. The same bits in every
        run; some are the given ones."""
        sizes, launcher = self.sizes, launch.launcher_for(by_outputs["means"].device)
        whole = sizes.sh_active == sizes.sh_count
        copied = {name: by_outputs[name] for name in ("means", "quaternions", *(["sh"] if whole else []))}
        filled = {name: torch.empty_like(array) for name, array in self.arrays.items() if name not in copied}
        padded = _padded(sizes)
        columns, units = sum(padded.values()), -(-sizes.units // 64) * 64  # whole tiles of either width
        partial = units * (columns + 1) + padded["OUTPUTS"]
        blocks = max(1, min(launch.blocks_for(sizes.count), _BLOCKS))
        partials = torch.empty(blocks * partial, dtype=torch.float32, device=by_outputs["means"].device)
        arrays, gradients = (structs.pointers(structs.FieldArrays, of) for of in (self.arrays, filled))
        outputs = [structs.pointers(structs.Deformed, of) for of in (self.drawn, by_outputs)]
        backward = kernel("field_backward", **padded)
        launcher.launch(backward, blocks, sizes, arrays, *outputs, gradients, partials, partial, blocks)
        rest = partials, partial, blocks, padded["EMBEDDING"], columns
        launcher.launch(kernel("field_sums"), -(-partial // 32), sizes, arrays, gradients, *rest)
        launcher.launch(kernel("field_table"), -(-sizes.temporal_size // 32), sizes, arrays, gradients)
        return copied | filled


def forward_field(
    shape: FieldShape, fusion: str, rows: Sequence[Array], arrays: dict[str, torch.Tensor], low_pass: float
) -> tuple[FieldPass, TorchGaussians, torch.Tensor]:
    """As ``model.fused.forward_field``.

    Args:
        shape: settings.
        fusion: one that ``can_compute`` knows.
        rows: two of ``field.network.temporal_weights``, of the coarse and the fine embedding.
        arrays: float32 tensors on a GPU, of the names of structs.FieldArrays.
        low_pass: the Gaussians'.
    """
    arrays = {name: array.detach().contiguous() for name, array in arrays.items()}
    means, embeddings, table = (arrays[name] for name in ("means", "embeddings", "temporal_table"))
    sizes = structs.FieldSizes(
        *(len(means), *embeddings.shape, len(arrays["bias"]), shape.networks),
        *(table.shape[1], len(table), FUSIONS.index(fusion)),
        *(arrays["sh"].shape[1], shape.sh_active, shape.sh_deformed, structs.OPACITY_FORMS[shape.opacity_form]),
        *(shape.opacity_sharpness, shape.opacity_share, shape.motion_unit),
    )
    for which, weights in enumerate(rows):
        for k, row in enumerate(np.flatnonzero(weights), 4 * which):
            sizes.rows[k], sizes.weights[k] = row, weights[row]
    result = {name: means.new_empty((len(means), *own)) for name, own in shape.result_shapes.items()}
    changes = means.new_empty((len(embeddings), shape.outputs))
    addresses = structs.pointers(structs.Deformed, {**result, "changes": changes})
    launcher, blocks = launch.launcher_for(means.device), launch.blocks_for(len(means))
    launcher.launch(
        kernel("field", **_padded(sizes)), blocks, sizes, structs.pointers(structs.FieldArrays, arrays), addresses
    )
    drawn = {"scales": result["scales"], "changes": changes}
    return FieldPass(sizes, arrays, drawn), GaussianArrays.of(result, low_pass), changes


def _padded(sizes: Structure) -> dict[str, int]:
    """The kernels' constants."""
    outputs = num_outputs(sizes.sh_deformed)
    return {
        "EMBEDDING": next(size for size in _EMBEDDINGS if size >= sizes.embedding_size),
        "OUTPUTS": next(size for size in _OUTPUTS if size >= outputs),
    }
