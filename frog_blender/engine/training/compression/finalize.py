"""A finished scene as its file plays it: Gaussians in the order that packs and plays best, and what that saves."""

from __future__ import annotations

import numpy as np
import torch

from ...field.names import PER_GAUSSIAN
from ...gaussians import TorchGaussians
from ...playback.player import ScenePlayer
from ...rasterizer import GaussianArrays
from ...scene.compression_report import StepKind
from ...scene.quantization import morton_order_by_range, unpack
from ...scene.scene_file import SceneFile, packed_arrays
from .context import Compression, CompressionStep


def reorder_for_playback(scene: SceneFile) -> SceneFile:
    """The scene with neighbours together, dynamic Gaussians before static ones."""
    count, deformed = len(scene.arrays["means"]), len(scene.arrays.get("embeddings", ()))
    order = morton_order_by_range(scene.arrays["means"], *({deformed} - {0, count}))
    arrays = {n: array[order[: len(array)]] if n in PER_GAUSSIAN else array for n, array in scene.arrays.items()}
    return SceneFile(scene.header, arrays)


def as_packed(scene: SceneFile) -> SceneFile:
    """The scene with numbers as they come back from a packed file; FrogError where none can hold them."""
    packed = packed_arrays(scene.arrays)
    return SceneFile(scene.header, {name: unpack(array.content, array.description) for name, array in packed.items()})


def packing_step(context: Compression, scene: SceneFile, size: int) -> CompressionStep:
    """What packing a reordered scene into ``size`` bytes saves and costs."""
    plain, psnr = sum(array.nbytes for array in scene.arrays.values()), _psnr(context, ScenePlayer(as_packed(scene)))
    loss = context.evaluator().now - psnr
    return CompressionStep(StepKind.PACK, 1.0, plain, size, loss, bytes=plain - size)


def _psnr(context: Compression, scene: ScenePlayer) -> float:
    """Of the scene as it is played, on the validation images."""
    device = context.training.gaussians.device

    def played(time_: float) -> TorchGaussians:
        arrays = vars(scene.at(time_)).values()
        return GaussianArrays(*(torch.from_numpy(np.array(array)).to(device) for array in arrays))

    return context.evaluator(played).now
