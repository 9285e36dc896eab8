"""FLIP and LPIPS where they can be computed, the reason where they cannot, and never a download."""

from __future__ import annotations

import sys
import types
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from frog_blender.engine.evaluation.metrics import flip
from frog_blender.engine.evaluation.perceptual import is_installed, perceptual_metrics

IMAGE = np.random.default_rng(0).random((40, 48, 3)).astype(np.float32)


def test_flip_is_zero_for_equal_images_and_grows_with_the_error() -> None:
    pytest.importorskip("flip_evaluator")
    noise = np.random.default_rng(1).normal(size=IMAGE.shape)
    errors = [flip((IMAGE + size * noise).clip(0, 1), IMAGE.astype(np.float64)) for size in (0, 0.05, 0.2)]
    assert errors[0] == 0 and 0 < errors[1] < errors[2] < 1
    dark, bright = np.zeros((8, 8, 3)), np.ones((8, 8, 3))
    assert flip(dark, bright) > 0.9, "black for white is nearly the largest error there is"


def test_missing_packages_are_named() -> None:
    assert perceptual_metrics(lambda name: False) == ({}, {"flip": "not installed", "lpips": "not installed"})
    found, missing = perceptual_metrics({"flip_evaluator", "torch", "lpips"}.__contains__)
    assert list(found) == ["flip"] and missing == {"lpips": "not installed"}
    assert is_installed("numpy") and not is_installed("a_package_that_nobody_has")


def all_but_flip(name: str) -> bool:
    """As if LPIPS were installed."""
    return name in ("torch", "torchvision", "lpips")


@pytest.fixture
def fake_lpips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[dict[str, Any]]:
    """A package of that name whose distance is the mean difference; the list has the options of each network built."""
    asked: list[dict[str, Any]] = []

    class LPIPS(torch.nn.Module):
        def __init__(self, **options: Any) -> None:
            super().__init__()
            asked.append(options)

        def forward(self, first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
            assert first.shape == second.shape == (1, 3, 40, 48)
            assert min(first.min(), second.min()) >= -1
            return (first - second).abs().mean().reshape(1, 1, 1, 1)

    module = types.ModuleType("lpips")
    module.LPIPS = LPIPS  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "lpips", module)
    monkeypatch.setenv("TORCH_HOME", str(tmp_path))
    return asked


def test_lpips_without_its_weights_is_not_even_built(fake_lpips: list[dict[str, Any]]) -> None:
    found, missing = perceptual_metrics(all_but_flip)
    assert "lpips" not in found and missing["lpips"] == "weights missing"
    assert fake_lpips == [], "building it would fetch the weights"


def test_lpips_with_its_weights(fake_lpips: list[dict[str, Any]], tmp_path: Path) -> None:
    weights = tmp_path / "hub" / "checkpoints" / "alexnet-owt-7be5be79.pth"
    weights.parent.mkdir(parents=True)
    weights.write_bytes(b"")
    found, missing = perceptual_metrics(all_but_flip)
    assert "lpips" not in missing and fake_lpips[0]["net"] == "alex"
    assert found["lpips"](IMAGE, IMAGE) == 0
    assert found["lpips"](np.ones_like(IMAGE), np.zeros_like(IMAGE)) == pytest.approx(2.0)
    assert np.isnan(found["lpips"](IMAGE[:20], IMAGE[:20])), "too small for the network"
