"""An image and its way back by native calls: the same bits as the two operations with automatic differentiation."""

from __future__ import annotations

import gc
import weakref
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from support.builders import odd_camera
from support.random_models import model_of

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.field.names import FUSIONS
from frog_blender.engine.model.deformation import FrogSettings
from frog_blender.engine.model.frog import Frog
from frog_blender.engine.model.fused import FusedRenderResult
from frog_blender.engine.model.interface import RenderResult, SceneModel, ScheduleState
from frog_blender.engine.rasterizer import Image, RasterizeOptions
from frog_blender.engine.registry import RASTERIZERS

SETTINGS = FrogSettings(temporal_rows=6, coarse_rows=3, temporal_size=9, embedding_size=8, hidden_width=32)
BACKGROUND = (0.2, 0.5, 0.1)
HALFWAY = ScheduleState(fine_rows=0.5, opacity=0.7, sh_count=4)


def view(**changes: Any) -> Camera:
    looking_on = np.eye(4)
    looking_on[2, 3] = 5.0
    return replace(odd_camera(50, 40).with_pose(looking_on), **changes)


def leaves(model: Frog, pose: torch.Tensor | None) -> dict[str, torch.Tensor]:
    return dict(model.named_parameters()) | ({} if pose is None else {"pose": pose})


def drawn_by(
    draw: Any, model: Frog, camera: Camera, options: RasterizeOptions, posed: bool, by_rgb: torch.Tensor | None = None
) -> tuple[RenderResult, dict[str, torch.Tensor]]:
    """An image, and the gradients that a random one by its colours (or ``by_rgb``) brings, by name."""
    pose = torch.from_numpy(camera.world_to_camera[:3]).float().requires_grad_() if posed else None
    model.zero_grad()
    drawn = draw(model, 0.37, camera, BACKGROUND, options, HALFWAY, pose=pose)
    if by_rgb is None:
        by_rgb = torch.randn(drawn.image.rgb.shape, generator=torch.Generator().manual_seed(5))
    drawn.backward(by_rgb)
    gradients = {name: leaf.grad.clone() for name, leaf in leaves(model, pose).items() if leaf.grad is not None}
    return drawn, gradients | {"screen": drawn.image.screen.grad}


def assert_same(model: Frog, camera: Camera, options: RasterizeOptions | None = None, posed: bool = False) -> None:
    options = options or RasterizeOptions(weights=True)
    (found, ours), (expected, theirs) = (
        drawn_by(draw, model, camera, options, posed) for draw in (Frog.draw, SceneModel.draw)
    )
    assert type(found) is FusedRenderResult and type(expected) is RenderResult
    for name in ("rgb", "alpha", "radii", "max_weights"):
        one, other = getattr(found.image, name), getattr(expected.image, name)
        assert (one is None and other is None) or torch.equal(one, other), name
    for group in (vars(found.gaussians), found.changes):
        others = vars(expected.gaussians) if group is not found.changes else expected.changes
        assert group.keys() == others.keys()
        assert all(torch.equal(value, others[name]) for name, value in group.items())
    assert ours.keys() == theirs.keys() and {"canonical.means", "temporal_table", "screen"} <= ours.keys()
    for name, gradient in theirs.items():
        assert torch.equal(ours[name], gradient), name
        assert name in ("canonical.sh", "pose") or bool(gradient.any()), name


@pytest.mark.parametrize(("fusion", "heads"), [*((fusion, 0) for fusion in FUSIONS), ("product", 16)])
def test_every_fusion_and_the_papers_heads(fusion: str, heads: int) -> None:
    settings = replace(SETTINGS, fusion=fusion, head_width=heads, modulation=fusion != "dual" and not heads)
    assert_same(model_of(settings), view(exposure=(0.7, 1.3, 1.1)))


def test_static_gaussians_a_rectangle_and_a_pose() -> None:
    model = model_of(replace(SETTINGS, modulation=True), moving=70)
    assert_same(model, view(), RasterizeOptions(region=(10, 5, 30, 20)), posed=True)


def test_opacities_that_do_not_deform_stay_as_they_are() -> None:
    model = model_of(replace(SETTINGS, deformed_opacity=False))
    assert_same(model, view())
    rows = model.output_rows("opacity_logits")
    grad = model.deformation.output_weight.grad
    assert grad is not None and not grad[rows].any() and bool(grad.any())


def test_gradients_add_up() -> None:
    model, camera, options = model_of(SETTINGS), view(), RasterizeOptions()
    _, once = drawn_by(Frog.draw, model, camera, options, False)
    by_rgb = torch.randn((40, 50, 3), generator=torch.Generator().manual_seed(5))
    model.draw(0.37, camera, BACKGROUND, options, HALFWAY).backward(by_rgb)
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None
        torch.testing.assert_close(parameter.grad, 2 * once[name], rtol=1e-6, atol=0)


@pytest.mark.parametrize("name", ["means", "embeddings", "what was drawn"])
def test_arrays_that_were_changed_since_are_refused(name: str) -> None:
    model = model_of(SETTINGS)
    drawn = model.draw(0.37, view(), BACKGROUND, RasterizeOptions())
    with torch.no_grad():
        getattr(model.canonical, name, drawn.gaussians.scales).add_(1.0)
    with pytest.raises(RuntimeError, match="has been changed"):
        drawn.backward(torch.ones_like(drawn.image.rgb))
    assert all(parameter.grad is None for parameter in model.parameters())


def test_without_gradients_nothing_is_kept_for_the_way_back() -> None:
    with torch.no_grad():
        drawn = model_of(SETTINGS).draw(0.37, view(), BACKGROUND, RasterizeOptions(depth=True))
    assert type(drawn) is RenderResult and drawn.image.median_depth is not None


def test_a_drawing_goes_when_nobody_holds_it() -> None:
    gc.disable()  # no cycle keeps it
    try:
        drawn = model_of(SETTINGS).draw(0.37, view(), BACKGROUND, RasterizeOptions())
        assert isinstance(drawn, FusedRenderResult)
        frame = weakref.ref(drawn.drawing.frame)
        drawn.backward(torch.ones_like(drawn.image.rgb))
        del drawn
        assert frame() is None
    finally:
        gc.enable()


def test_a_model_is_drawn_by_the_backend_it_is_given() -> None:
    """By torch alone then, whatever the native library could do."""
    model, drawn_with = model_of(SETTINGS), []

    def backend(*arguments: Any) -> Image:
        drawn_with.append(arguments[1])
        return RASTERIZERS["reference"](*arguments)

    model.backend = backend
    camera = view()
    drawn = model.draw(0.37, camera, BACKGROUND, RasterizeOptions(), HALFWAY)
    assert drawn_with == [camera] and type(drawn) is RenderResult
    model.backend = None
    expected = model.draw(0.37, camera, BACKGROUND, RasterizeOptions(), HALFWAY)
    torch.testing.assert_close(drawn.image.rgb, expected.image.rgb, atol=1e-4, rtol=1e-3)
