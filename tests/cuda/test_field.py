"""The field's kernels against plain torch in float64: what they give, and gradients of everything."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from emulated import Emulator
from support.builders import odd_camera, pairwise
from support.field_gradients import TIME, assert_as_reference, gradients_by
from support.random_models import model_of
from support.torch_drawing import relative_error

from frog_blender.engine.cuda import field
from frog_blender.engine.field.names import FORMS, FUSIONS
from frog_blender.engine.model.deformation import FrogSettings
from frog_blender.engine.model.frog import Frog
from frog_blender.engine.model.fused import FusedRenderResult
from frog_blender.engine.model.interface import FINISHED, RenderResult, SceneModel, ScheduleState
from frog_blender.engine.rasterizer import RasterizeOptions

SETTINGS = FrogSettings(
    temporal_rows=11, coarse_rows=4, temporal_size=40, embedding_size=9, hidden_width=33, motion_unit=0.7
)


@pytest.mark.parametrize(
    ("fusion", "modulation", "form", "share", "sh", "moving", "pulled"),
    pairwise(
        [fusion for fusion in FUSIONS if fusion != "attention"],
        [False, True],
        FORMS,
        [0.0, 0.5, 1.0],
        [(0, 1, 4), (1, 1, 1), (1, 4, 4), (4, 9, 16), (9, 4, 9), (16, 16, 16)],  # deformed, active, stored
        [0, 1, 256, 300, 515],
        [0.0, 0.1, 1.0],
    ),
)
def test_every_shape_of_the_network(
    fusion: str,
    modulation: bool,
    form: str,
    share: float,
    sh: tuple[int, int, int],
    moving: int,
    pulled: float,
    emulator: Emulator,
) -> None:
    deformed, active, stored = sh
    settings = replace(SETTINGS, fusion=fusion, modulation=modulation, opacity_reduction=form, deformed_sh=deformed)
    model = model_of(settings, 515, stored, moving=moving)
    assert_as_reference(model, ScheduleState(0.6, share, active), pulled)
    assert [kernel.name for kernel in emulator.launched] == ["field", "field_backward", "field_sums", "field_table"]


@pytest.mark.parametrize(
    ("hidden", "embedding", "deformed", "fusion"),
    [(1, 1, 0, "product"), (64, 32, 1, "add"), (65, 40, 1, "dual"), (100, 64, 4, "concat"), (128, 33, 16, "dual")],
)
def test_other_sizes_and_turned_threads(
    hidden: int, embedding: int, deformed: int, fusion: str, emulator: Emulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A missing barrier shows with the threads in the opposite order; so do sums whose order is left to chance. A block
    of the backward pass takes more chunks than one."""
    monkeypatch.setattr(field, "_BLOCKS", 2)
    sizes = {"hidden_width": hidden, "embedding_size": embedding, "deformed_sh": deformed, "temporal_size": 64}
    model = model_of(replace(SETTINGS, **sizes, fusion=fusion, modulation=True), 700, moving=600)
    found = assert_as_reference(model, ScheduleState(), 0.5)
    emulator.turned = True
    turned = gradients_by(model, ScheduleState(), 0.5, True)
    assert all(np.array_equal(values, turned[name]) for name, values in found.items())


@pytest.mark.parametrize("changed", [{}, {"deformed_opacity": False}, {"head_width": 16}, {"fusion": "attention"}])
def test_an_image_and_its_gradients(changed: dict[str, object], emulator: Emulator) -> None:
    """Kernels draw it, without torch's differentiation but for fields that have no kernels; the native library draws
    what it is held to."""
    model = model_of(replace(SETTINGS, **changed), moving=150)
    camera = replace(odd_camera(50, 40), world_to_camera=np.eye(4) + np.eye(4, k=1) * [[0], [0], [5], [0]])
    found: list[dict[str, torch.Tensor]] = []
    for draw, kind in ((Frog.draw, FusedRenderResult), (SceneModel.draw, RenderResult)):
        pose = torch.from_numpy(camera.world_to_camera).float().requires_grad_()
        model.zero_grad()
        drawn = draw(model, TIME, camera, (0.2, 0.5, 0.1), RasterizeOptions(), ScheduleState(0.5, 0.7, 4), pose=pose)
        assert type(drawn) is (RenderResult if {"head_width", "fusion"} & changed.keys() else kind)
        drawn.backward(torch.randn(drawn.image.rgb.shape, generator=torch.Generator().manual_seed(5)))
        leaves = dict(model.named_parameters()) | {"pose": pose, "screen": drawn.image.screen}
        found.append({name: leaf.grad for name, leaf in leaves.items()} | {"rgb": drawn.image.rgb.detach()})
    for name, value in found[1].items():
        assert relative_error(found[0][name].numpy(), value.numpy()) < 1e-4, name


@torch.no_grad()
def test_without_gradients(emulator: Emulator) -> None:
    model = model_of(SETTINGS, 300, moving=100)
    gaussians, changes = model.deform(TIME)
    assert [kernel.name for kernel in emulator.launched] == ["field"]
    expected, their_changes = model.deform_reference(model.temporal_embedding(TIME), FINISHED)
    torch.testing.assert_close(gaussians.arrays, expected.arrays)
    torch.testing.assert_close(changes, their_changes)
