"""Perceptual figures that need packages of their own: FLIP, and LPIPS where its weights lie on this machine.

Nothing is downloaded. LPIPS stands on torchvision's AlexNet, whose weights torchvision would fetch by itself; it is
only built where the file is already in torch's cache.
"""

from __future__ import annotations

from importlib.util import find_spec
from pathlib import Path

import numpy as np

from ..engine.evaluation.evaluate import Measure
from ..engine.evaluation.metrics import flip

_ALEXNET = "alexnet-owt-*.pth"  # torchvision's name for it in the folder of torch.hub
_SMALLEST_SIDE = 31  # pixels; AlexNet's last pooling has nothing left of a smaller image


def perceptual_measures() -> tuple[dict[str, Measure], dict[str, str]]:
    """Measures by name ("flip", "lpips"), and for those that cannot be computed here why not, in a few words."""
    found: dict[str, Measure] = {}
    missing: dict[str, str] = {}
    if find_spec("flip_evaluator") is not None:
        found["flip"] = flip
    else:
        missing["flip"] = "not installed"
    reason = _why_no_lpips()
    if reason:
        missing["lpips"] = reason
    else:
        found["lpips"] = _lpips()
    return found, missing


def _why_no_lpips() -> str:
    """ "" where LPIPS can be computed without the network."""
    if any(find_spec(name) is None for name in ("torch", "torchvision", "lpips")):
        return "not installed"
    return "" if _alexnet_weights() else "weights missing"


def _alexnet_weights() -> list[Path]:
    import torch

    return sorted((Path(torch.hub.get_dir()) / "checkpoints").glob(_ALEXNET))


def _lpips() -> Measure:
    """LPIPS 0.1 with AlexNet (Zhang et al. 2018): the mean over an image, 0 for equal ones."""
    import lpips
    import torch

    network = lpips.LPIPS(net="alex", version="0.1", verbose=False).eval()

    def on_network(image: np.ndarray) -> torch.Tensor:
        """(1, 3, H, W) in [-1, 1]."""
        return torch.from_numpy(np.ascontiguousarray(image, np.float32)).permute(2, 0, 1)[None] * 2 - 1

    def measure(image: np.ndarray, truth: np.ndarray) -> float:
        if min(image.shape[:2]) < _SMALLEST_SIDE:
            return float("nan")
        with torch.inference_mode():
            return float(network(on_network(image), on_network(truth)).mean())

    return measure
