"""Perceptual metrics that need optional packages: FLIP, and LPIPS where its weights are on this machine.

Nothing is downloaded. LPIPS builds on torchvision's AlexNet or VGG16, whose weights torchvision would fetch by itself.
It is built only where the file is already in torch's cache.
"""

from __future__ import annotations

import functools
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ..errors import FrogError
from .metrics import Image, Metric, flip

if TYPE_CHECKING:
    import torch

_WEIGHTS = {"alex": "alexnet-owt-*.pth", "vgg": "vgg16-*.pth"}  # torchvision's names in the folder of torch.hub
_SMALLEST_SIDE = 31  # pixels; AlexNet's last pooling has nothing left of a smaller image


def is_installed(package: str) -> bool:
    """True where a package can be imported; it is not imported."""
    return find_spec(package) is not None


def perceptual_metrics() -> tuple[dict[str, Metric], dict[str, str]]:
    """Metrics by name ("flip", "lpips", "lpips_vgg"), and by name the reason why the others cannot be computed here."""
    metrics: dict[str, Metric] = {"flip": flip, "lpips": lpips, "lpips_vgg": lpips_vgg}
    reasons = {
        "flip": "" if is_installed("flip_evaluator") else "not installed",
        "lpips": _why_no_lpips("alex"),
        "lpips_vgg": _why_no_lpips("vgg"),
    }
    computable = {name: metric for name, metric in metrics.items() if not reasons[name]}
    return computable, {name: reason for name, reason in reasons.items() if reason}


def _why_no_lpips(net: str) -> str:
    """Why LPIPS cannot be computed offline; empty where it can."""
    if not all(is_installed(name) for name in ("torch", "torchvision", "lpips")):
        return "not installed"
    import torch

    weights = (Path(torch.hub.get_dir()) / "checkpoints").glob(_WEIGHTS[net])
    return "" if any(weights) else "weights missing"


def lpips(image: Image, truth: Image) -> float:
    """LPIPS 0.1 with AlexNet (Zhang et al. 2018): the mean over an image, 0 for equal ones, NaN for too small ones.

    Raises:
        FrogError: where it cannot be computed without a download.
    """
    return _lpips(image, truth, "alex")


def lpips_vgg(image: Image, truth: Image) -> float:
    """``lpips`` with VGG16, which Deformable-3DGS reports."""
    return _lpips(image, truth, "vgg")


def _lpips(image: Image, truth: Image, net: str) -> float:
    network = _network(net)
    import torch

    if min(image.shape[:2]) < _SMALLEST_SIDE:
        return float("nan")
    pixels = (torch.from_numpy(np.ascontiguousarray(array, np.float32)) for array in (image, truth))
    with torch.inference_mode():
        return float(network(*(array.permute(2, 0, 1)[None] * 2 - 1 for array in pixels)).mean())


@functools.cache
def _network(net: str) -> torch.nn.Module:
    """Compares (1, 3, H, W) tensors in [-1, 1]; FrogError where it cannot be built without a download."""
    if reason := _why_no_lpips(net):
        raise FrogError(f"LPIPS cannot be computed here: {reason}.")
    import lpips

    network: torch.nn.Module = lpips.LPIPS(net=net, version="0.1", verbose=False).eval()
    return network
