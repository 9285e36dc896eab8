"""Perceptual metrics that need optional packages: FLIP, and LPIPS where its weights are on this machine.

Nothing is downloaded. LPIPS builds on torchvision's AlexNet, whose weights torchvision would fetch by itself. It is
built only where the file is already in torch's cache.
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ..errors import FrogError
from .metrics import Image, Metric, flip

_ALEXNET = "alexnet-owt-*.pth"  # torchvision's name for it in the folder of torch.hub
_SMALLEST_SIDE = 31  # pixels; AlexNet's last pooling has nothing left of a smaller image


def is_installed(package: str) -> bool:
    """True where a package can be imported; it is not imported."""
    return find_spec(package) is not None


def perceptual_metrics(installed: Callable[[str], bool] = is_installed) -> tuple[dict[str, Metric], dict[str, str]]:
    """Metrics by name ("flip", "lpips"), and by name the reason why the others cannot be computed here.

    Args:
        installed: whether a package of this name can be imported.
    """
    reasons = {"flip": "" if installed("flip_evaluator") else "not installed", "lpips": _why_no_lpips(installed)}
    metrics: dict[str, Metric] = {} if reasons["flip"] else {"flip": flip}
    if not reasons["lpips"]:
        metrics["lpips"] = _lpips()
    return metrics, {name: reason for name, reason in reasons.items() if reason}


def _why_no_lpips(installed: Callable[[str], bool]) -> str:
    """Why LPIPS cannot be computed offline; empty where it can."""
    if not all(installed(name) for name in ("torch", "torchvision", "lpips")):
        return "not installed"
    import torch

    weights = (Path(torch.hub.get_dir()) / "checkpoints").glob(_ALEXNET)
    return "" if any(weights) else "weights missing"


def lpips(image: Image, truth: Image) -> float:
    """LPIPS 0.1 with AlexNet (Zhang et al. 2018): the mean over an image, 0 for equal ones.

    Raises:
        FrogError: where it cannot be computed without a download.
    """
    return _lpips_here()(image, truth)


@functools.cache
def _lpips_here() -> Metric:
    if reason := _why_no_lpips(is_installed):
        raise FrogError(f"LPIPS cannot be computed here: {reason}.")
    return _lpips()


def _lpips() -> Metric:
    """Builds the network."""
    import lpips
    import torch

    network = lpips.LPIPS(net="alex", version="0.1", verbose=False).eval()

    def on_network(image: Image) -> torch.Tensor:
        """(1, 3, H, W) in [-1, 1]."""
        return torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None] * 2 - 1

    def metric(image: Image, truth: Image) -> float:
        if min(image.shape[:2]) < _SMALLEST_SIDE:
            return float("nan")
        with torch.inference_mode():
            return float(network(on_network(image), on_network(truth)).mean())

    return metric
