"""The native library against the reference in float64 on random scenes of every kind.

Images: where float32 decides a threshold the other way a whole contribution appears or goes, which no tolerance can
hide. Such pixels ("flips", beyond FLIP) are counted over all scenes together and must be very rare; all others are held
to a mean error. A single scene may hold a few more of them than its share.

Gradients: the relative L2 error of every parameter's, where no pixel flipped: where the images agree within AGREEMENT
everywhere. Over all scenes together it is held to GRADIENT_ERROR. In a few of a hundred scenes float32 does not suffice
(1 - alpha of an alpha near 0.999 has lost three digits; hundreds of pixels' parts cancel): alone they may be beyond
that, never by much.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np
import torch
from hypothesis import HealthCheck, given, settings
from support.random_scenes import Scene, scenes
from support.torch_drawing import draw_with_gradients, relative_error

EXAMPLES = 120
FLIP, FLIPPED_SHARE, FLIPS_IN_ONE = 1e-4, 3e-4, 8
MEAN_ERROR = 1e-6
AGREEMENT = 1e-5
GRADIENT_ERROR, LARGEST_ERROR, INEXACT_SHARE = 1e-5, 3e-4, 0.04


@dataclass
class Totals:
    scenes: int = 0
    pixels: int = 0
    error: float = 0.0
    flips: int = 0
    compared: int = 0
    inexact: int = 0
    squares: Counter[str] = field(default_factory=Counter)  # of each parameter's gradients, and of their errors
    squared_errors: Counter[str] = field(default_factory=Counter)


def compare(scene: Scene, totals: Totals) -> None:
    camera, gaussians, options = scene.camera(), scene.gaussians(), scene.drawing()
    pose = camera.world_to_camera if scene.posed else None
    image, found = draw_with_gradients(gaussians, camera, "cpu", options=options, pose=pose)
    reference, expected = draw_with_gradients(gaussians, camera, "reference", torch.float64, options, pose=pose)
    for name, gradient in found.items():
        assert np.isfinite(gradient).all(), name
    difference = (image.rgb.detach() - reference.rgb.detach()).abs()
    alpha_difference = (image.alpha.detach() - reference.alpha.detach()).abs()
    flips = int((difference.amax(-1) > FLIP).sum())
    assert flips <= FLIPS_IN_ONE
    totals.scenes += 1
    totals.pixels += image.alpha.numel()
    totals.error += float(difference.mean(-1).sum())
    totals.flips += flips
    if max(float(difference.max()), float(alpha_difference.max())) > AGREEMENT:
        return
    totals.compared += 1
    errors = {name: relative_error(found[name], gradient) for name, gradient in expected.items()}
    assert max(errors.values()) <= LARGEST_ERROR, errors
    totals.inexact += max(errors.values()) > GRADIENT_ERROR
    for name, gradient in expected.items():
        totals.squares[name] += float(np.square(gradient).sum())
        totals.squared_errors[name] += float(np.square(found[name] - gradient).sum())


def test_random_scenes() -> None:
    totals = Totals()

    @settings(
        max_examples=EXAMPLES, derandomize=True, deadline=None, database=None, suppress_health_check=list(HealthCheck)
    )
    @given(scenes())
    def check(scene: Scene) -> None:
        compare(scene, totals)

    check()
    assert totals.scenes >= EXAMPLES
    assert totals.compared >= 0.98 * totals.scenes
    assert totals.inexact <= INEXACT_SHARE * totals.compared
    pooled = {name: (totals.squared_errors[name] / square) ** 0.5 for name, square in totals.squares.items()}
    assert len(pooled) == 7 and max(pooled.values()) <= GRADIENT_ERROR, pooled
    assert totals.error / totals.pixels <= MEAN_ERROR
    assert totals.flips <= FLIPPED_SHARE * totals.pixels
