"""No Gaussian wraps the cameras: what reaches one shrinks, and nothing else changes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.training.optimize.camera_clearance import (
    CameraClearance,
    camera_centers,
    clearance_hooks,
    standard_deviations,
)
from frog_blender.engine.training.recipe import recipe


def clearances(trainer: Any, capture: Capture) -> np.ndarray:
    """(N,) by the covariance of each Gaussian, in another way than the hook's."""
    gaussians = trainer.gaussians.canonical.gaussians(1)
    w, x, y, z = torch.nn.functional.normalize(gaussians.quaternions.detach().double(), dim=1).T
    rows = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
    ]
    turned = torch.stack([torch.stack(row, 1) for row in rows], 1) * gaussians.scales.detach().double()[:, None]
    inverse = np.linalg.inv((turned @ turned.mT).numpy())
    centers = np.array([capture.cameras[shot.camera].center for shot in capture.train_shots])
    offsets = centers[None] - gaussians.means.detach().double().numpy()[:, None]
    return np.asarray(np.sqrt(np.einsum("nci,nij,ncj->nc", offsets, inverse, offsets)).min(1))


def test_what_reaches_a_camera_shrinks_and_nothing_else_changes(
    capture: Capture, make_trainer: Callable[..., Any]
) -> None:
    trainer = make_trainer(100)
    canonical = trainer.gaussians.canonical
    canonical.quaternions.data += 0.4 * torch.randn(canonical.quaternions.shape, generator=torch.Generator())
    canonical.log_scales.data[:3] = torch.tensor([2.0, 1.5, 1.0])  # these wrap all cameras
    before, known = canonical.log_scales.detach().clone(), clearances(trainer, capture)
    hook = CameraClearance(capture, 10.0)
    hook.after_step(trainer, 0.011, 0.019)  # not due
    assert torch.equal(canonical.log_scales, before)
    hook.after_step(trainer, 0.019, 0.021)
    assert known[:3].max() < 10 < np.median(known)
    np.testing.assert_allclose(clearances(trainer, capture), np.maximum(known, 10.0), rtol=1e-3)
    now = canonical.log_scales.detach()
    assert torch.equal(now[known > 10.001], before[known > 10.001])
    torch.testing.assert_close(now - now[:, :1], before - before[:, :1])  # shapes stay


def test_a_wide_wall_before_a_camera_is_no_fog() -> None:
    means, upright = torch.tensor([[0.0, 0.0, 5.0]]).repeat(2, 1), torch.tensor([[1.0, 0.0, 0.0, 0.0]]).repeat(2, 1)
    scales = torch.tensor([[8.0, 8.0, 0.1], [2.0, 2.0, 2.0]]).log()
    found = standard_deviations(means, upright, scales, torch.tensor([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0]]))
    torch.testing.assert_close(found, torch.tensor([50.0, 2.5]))


def test_held_out_cameras_do_not_count(capture: Capture) -> None:
    trained = {shot.camera for shot in capture.train_shots}
    assert len(camera_centers(capture)) == len(trained) < len(capture.cameras)


def test_it_is_asked_for(capture: Capture) -> None:
    assert clearance_hooks(recipe("draft"), capture) == []
    assert len(clearance_hooks(recipe("draft", camera_clearance=10.0), capture)) == 1
