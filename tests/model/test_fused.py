"""The field by the native library computes what plain torch does, as an operation and with the image of it."""

import copy
import gc
import weakref
from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
import torch
from support.builders import odd_camera, pairwise
from support.deformation_fields import field_arrays, output_arrays
from support.random_models import model_of
from support.torch_drawing import relative_error

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.field.names import FUSIONS, network_count
from frog_blender.engine.model.deformation import FrogSettings
from frog_blender.engine.model.frog import Frog
from frog_blender.engine.model.fused import FusedRenderResult, forward_field
from frog_blender.engine.model.fused import field_arrays as field_model_arrays
from frog_blender.engine.model.interface import RenderResult, SceneModel, ScheduleState
from frog_blender.engine.native.deformation import FieldShape, deform_backward
from frog_blender.engine.rasterizer import RasterizeOptions
from frog_blender.engine.registry import RASTERIZERS

SETTINGS = FrogSettings(
    temporal_rows=6, coarse_rows=3, temporal_size=7, embedding_size=8, hidden_width=32, motion_unit=0.7
)
ODD = replace(SETTINGS, hidden_width=33, embedding_size=3)
DUAL = {"fusion": "dual"}  # E-D3DGS's two networks, whose outputs add up
FUSED = [("product", False), ("product", True), ("dual", False), ("dual", True)]
OUTPUTS = ("means", "quaternions", "scales", "opacities", "sh")


def temporal_of(settings: FrogSettings) -> torch.Tensor:
    """(networks, T)."""
    size = (network_count(settings.fusion), settings.temporal_size)
    return torch.randn(size, generator=torch.Generator().manual_seed(2))


def looked_at(
    model: Frog, fused: bool, share: float, sh_active: int
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Outputs and changes by name, and gradients of a random linear loss by every parameter and the embedding of the
    time; in the precision of the model."""
    state, dtype = ScheduleState(opacity=share, sh_count=sh_active), model.canonical.means.dtype
    temporal = temporal_of(model.settings).to(dtype).requires_grad_()
    parameters = {name: value for name, value in model.named_parameters() if name != "temporal_table"}
    if fused:
        arrays = field_model_arrays(model.canonical, model.deformation, temporal=temporal)
        field, gaussians, changes = forward_field(model.field_shape(state), arrays)
    else:
        gaussians, parts = model.deform_reference(temporal, state)
        changes = torch.cat([part.flatten(1) for part in parts.values()], 1)
    outputs, generator = {name: getattr(gaussians, name) for name in OUTPUTS}, torch.Generator().manual_seed(3)
    by = {name: torch.randn(output.shape, generator=generator).to(dtype) for name, output in outputs.items()}
    if fused:
        by_name = field.backward(by)
        gradients = {name: by_name[name.split(".")[-1]].numpy() for name in (*parameters, "temporal")}
    else:
        model.zero_grad()
        sum((output * by[name]).sum() for name, output in outputs.items()).backward()
        gradients = {name: value.grad.numpy().copy() for name, value in {**parameters, "temporal": temporal}.items()}
    values = {name: output.detach().numpy() for name, output in outputs.items()}
    return values | {"changes": changes.detach().numpy()}, gradients


def assert_equal_to_plain(model: Frog, share: float = 1.0, sh_active: int = 16) -> None:
    native, gradients = looked_at(model, True, share, sh_active)
    expected, by = looked_at(copy.deepcopy(model).double(), False, share, sh_active)
    for name, values in expected.items():
        assert native[name].shape == values.shape and native[name].dtype == np.float32
        np.testing.assert_allclose(native[name], values, atol=1e-5, rtol=1e-5, err_msg=name)
    assert gradients.keys() == by.keys()
    for name, gradient in by.items():
        assert gradients[name].shape == gradient.shape
        assert relative_error(gradients[name], gradient) < 1e-5, name


@pytest.mark.parametrize(
    ("settings", "shape", "opacity", "share", "sh_active"),
    pairwise(
        [SETTINGS, ODD],
        [(head, fusion, modulation) for head in (0, 1, 16, 24) for fusion, modulation in FUSED],
        ["paper", "unit", "off"],
        [0.0, 0.5, 1.0],
        [(0, 1), (1, 4), (4, 4), (4, 9), (16, 9), (16, 16)],
    ),
)
def test_every_shape_of_the_network(
    settings: FrogSettings, shape: tuple[int, str, bool], opacity: str, share: float, sh_active: tuple[int, int]
) -> None:
    """Its heads and fusions, every form of the opacity, and harmonics below, at and above those that deform."""
    head_width, fusion, modulation = shape
    changed = {"head_width": head_width, "fusion": fusion, "modulation": modulation, "deformed_sh": sh_active[0]}
    model = model_of(replace(settings, temporal_size=9, opacity_reduction=opacity, **changed))
    assert_equal_to_plain(model, share, sh_active[1])


@pytest.mark.parametrize(
    ("moving", "form", "head_width"), pairwise([0, 1, 95, 96, 961, 1999], ["off", "paper", "unit"], [0, 16])
)
def test_static_gaussians(moving: int, form: str, head_width: int) -> None:
    settings = replace(SETTINGS, opacity_reduction=form, head_width=head_width, modulation=True, temporal_size=9)
    model = model_of(settings, 2000, 4, moving=moving)
    assert_equal_to_plain(model, 0.7, 4)
    still = model.canonical.gaussians()
    moved = model.deform(0.3)[0]
    for name in OUTPUTS:
        assert torch.allclose(getattr(moved, name)[moving:], getattr(still, name)[moving:], rtol=1e-6)


@pytest.mark.parametrize(("hidden", "embedding"), [(1, 1), (15, 16), (16, 17), (64, 32), (100, 40)])
def test_other_sizes(hidden: int, embedding: int) -> None:
    for head_width in (0, 128):
        settings = replace(SETTINGS, hidden_width=hidden, embedding_size=embedding, head_width=head_width)
        assert_equal_to_plain(model_of(settings, 100))
        assert_equal_to_plain(model_of(replace(settings, **DUAL), 100))


@pytest.mark.parametrize("form", ["paper", "unit"])
def test_where_nothing_changes_yet_gradients_are_the_same(form: str) -> None:
    """All outputs are zero when training starts, which is where the unit form has its kink."""
    model = model_of(replace(SETTINGS, opacity_reduction=form))
    model.deformation.output_weight.data.zero_()
    model.deformation.output_bias.data.zero_()
    assert_equal_to_plain(model)


@pytest.mark.parametrize("count", [1, 2, 95, 96, 97, 960, 961, 2000])
def test_any_number_of_gaussians(count: int) -> None:
    """Blocks hold 96 Gaussians and chunks 960. With this seed no unit is within 2e-6 of zero, where rounding decides
    whether a gradient passes."""
    for settings in (ODD, replace(ODD, head_width=24), replace(ODD, head_width=24, **DUAL)):
        assert_equal_to_plain(model_of(settings, count, seed=23))


@pytest.mark.parametrize("head_width", [0, 24])
@pytest.mark.parametrize("fusion", ["product", "dual"])
def test_no_gaussians(head_width: int, fusion: str) -> None:
    values, gradients = looked_at(model_of(replace(SETTINGS, head_width=head_width, fusion=fusion), 0), True, 1.0, 16)
    assert values["sh"].shape == (0, 16, 3) and values["changes"].shape == (0, 14)
    assert not any(gradient.any() for gradient in gradients.values())


def test_extreme_logits_and_scales_stay_finite() -> None:
    model = model_of(SETTINGS, 8)
    model.canonical.opacity_logits.data = torch.tensor([-200.0, -90, -30, 0, 30, 90, 200, 1000])
    model.canonical.log_scales.data[:, 0] = torch.tensor([-80.0, -60, -20, 0, 5, 10, 20, 30])
    model.deformation.output_bias.data[10] = -50
    for form in ("paper", "unit", "off"):
        model.settings = replace(SETTINGS, opacity_reduction=form)
        values, gradients = looked_at(model, True, 1.0, 16)
        expected, _ = looked_at(copy.deepcopy(model).double(), False, 1.0, 16)
        np.testing.assert_allclose(values["opacities"], expected["opacities"], atol=1e-6)
        np.testing.assert_allclose(values["scales"], expected["scales"], rtol=1e-5, atol=1e-30)
        assert all(np.isfinite(gradient).all() for gradient in gradients.values())


@pytest.mark.parametrize(("head_width", "fusion"), [(0, "product"), (24, "product"), (24, "dual")])
def test_the_same_bits_on_any_number_of_threads(
    head_width: int, fusion: str, same_on_threads: Callable[..., None]
) -> None:
    model = model_of(replace(ODD, head_width=head_width, fusion=fusion), 5000)
    same_on_threads(lambda: [array for arrays in looked_at(model, True, 1.0, 16) for array in arrays.values()])


@pytest.mark.parametrize(
    ("pulled", "head_width", "moving"), pairwise([0, 1, 300, 3740, 3760, 5000], [0, 24], [5000, 1234])
)
def test_gaussians_without_a_gradient_cost_nothing_and_change_nothing(
    pulled: int, head_width: int, moving: int
) -> None:
    """The backward pass leaves them out: theirs are zero, the others' are as before, and the weights' add up."""
    count = 5000
    shape = FieldShape(head_width, 9, 4, "unit", 10.0, 0.6, 0.5)
    arrays = field_arrays(shape, 33, 3, count)
    arrays["embeddings"] = arrays["embeddings"][:moving]
    random = np.random.default_rng(5)
    seen = np.zeros(count, bool)
    seen[random.permutation(count)[:pulled]] = True
    whole = {name: np.float32(random.normal(size=array.shape)) for name, array in output_arrays(shape, count).items()}

    def gradients(of: np.ndarray) -> dict[str, np.ndarray]:
        by = {n: np.where(of.reshape(-1, *[1] * (a.ndim - 1)), a, np.float32(0)) for n, a in whole.items()}
        result = {name: np.full_like(array, np.nan) for name, array in arrays.items()}
        deform_backward(shape, arrays, by, result)
        return result

    of_seen, of_others, expected = gradients(seen), gradients(~seen), gradients(np.ones(count, bool))
    for name, value in expected.items():
        if len(value) in (count, moving):
            looked = seen[: len(value)]
            assert not of_seen[name][~looked].any(), name
            np.testing.assert_allclose(of_seen[name][looked], value[looked], rtol=1e-5, atol=1e-6)
        else:
            assert relative_error(of_seen[name] + of_others[name], value) < 1e-5, name
        assert np.isfinite(of_seen[name]).all()


def test_a_gradient_that_is_not_a_number_is_not_lost() -> None:
    shape = FieldShape(0, 4, 1, "unit", 10.0, 1.0, 0.5)
    arrays = field_arrays(shape, 16, 3, 50)
    by = {name: np.zeros_like(array) for name, array in output_arrays(shape, 50).items()}
    by["scales"][7, 1] = np.nan
    result = {name: np.zeros_like(array) for name, array in arrays.items()}
    deform_backward(shape, arrays, by, result)
    assert np.isnan(result["log_scales"][7, 1]) and np.isfinite(np.delete(result["log_scales"], 7, 0)).all()


SHAPE = FrogSettings(temporal_rows=6, coarse_rows=3, temporal_size=9, embedding_size=8, hidden_width=32)
BACKGROUND = (0.2, 0.5, 0.1)
HALFWAY = ScheduleState(fine_rows=0.5, opacity=0.7, sh_count=4)


def view(**changes: Any) -> Camera:
    looking_on = np.eye(4)
    looking_on[2, 3] = 5.0
    return replace(odd_camera(50, 40).with_pose(looking_on), **changes)


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
    leaves = dict(model.named_parameters()) | ({} if pose is None else {"pose": pose})
    gradients = {name: leaf.grad.clone() for name, leaf in leaves.items() if leaf.grad is not None}
    return drawn, gradients | {"screen": drawn.image.screen.grad}


def assert_same(model: Frog, camera: Camera, options: RasterizeOptions | None = None, posed: bool = False) -> None:
    options = options or RasterizeOptions(weights=True)
    (fused, ours), (expected, theirs) = (
        drawn_by(draw, model, camera, options, posed) for draw in (Frog.draw, SceneModel.draw)
    )
    assert type(fused) is FusedRenderResult and type(expected) is RenderResult
    for name in ("rgb", "alpha", "max_weights"):
        one, other = getattr(fused.image, name), getattr(expected.image, name)
        assert (one is None and other is None) or torch.allclose(one, other, atol=1e-5), name
    for group in (fused.gaussians.arrays, fused.changes):
        others = expected.gaussians.arrays if group is not fused.changes else expected.changes
        assert group.keys() == others.keys()
        assert all(torch.allclose(value, others[name], rtol=1e-5, atol=1e-5) for name, value in group.items())
    assert ours.keys() == theirs.keys() and {"canonical.means", "temporal_table", "screen"} <= ours.keys()
    for name, gradient in theirs.items():
        assert relative_error(ours[name].numpy(), gradient.numpy()) < 1e-4, name
        assert name in ("canonical.sh", "pose") or bool(gradient.any()), name


@pytest.mark.parametrize(("fusion", "heads"), [*((fusion, 0) for fusion in FUSIONS), ("product", 16)])
def test_every_fusion_and_the_papers_heads(fusion: str, heads: int) -> None:
    settings = replace(SHAPE, fusion=fusion, head_width=heads, modulation=fusion != "dual" and not heads)
    assert_same(model_of(settings), view(exposure=(0.7, 1.3, 1.1)))


def test_static_gaussians_a_rectangle_and_a_pose() -> None:
    model = model_of(replace(SHAPE, modulation=True), moving=70)
    assert_same(model, view(), RasterizeOptions(region=(10, 5, 30, 20)), posed=True)


def test_opacities_that_do_not_deform_stay_as_they_are() -> None:
    model = model_of(replace(SHAPE, deformed_opacity=False))
    assert_same(model, view())
    rows = model.output_rows("opacity_logits")
    grad = model.deformation.output_weight.grad
    assert grad is not None and not grad[rows].any() and bool(grad.any())


def test_gradients_add_up() -> None:
    model, camera, options = model_of(SHAPE), view(), RasterizeOptions()
    _, once = drawn_by(Frog.draw, model, camera, options, False)
    by_rgb = torch.randn((40, 50, 3), generator=torch.Generator().manual_seed(5))
    model.draw(0.37, camera, BACKGROUND, options, HALFWAY).backward(by_rgb)
    for name, parameter in model.named_parameters():
        assert parameter.grad is not None
        torch.testing.assert_close(parameter.grad, 2 * once[name], rtol=1e-6, atol=0)


@pytest.mark.parametrize("name", ["means", "embeddings", "what was drawn"])
def test_arrays_that_were_changed_since_are_refused(name: str) -> None:
    model = model_of(SHAPE)
    drawn = model.draw(0.37, view(), BACKGROUND, RasterizeOptions())
    with torch.no_grad():
        getattr(model.canonical, name, drawn.gaussians.scales).add_(1.0)
    with pytest.raises(RuntimeError, match="has been changed"):
        drawn.backward(torch.ones_like(drawn.image.rgb))
    assert all(parameter.grad is None for parameter in model.parameters())


def test_without_gradients_nothing_is_kept_for_the_way_back() -> None:
    with torch.no_grad():
        drawn = model_of(SHAPE).draw(0.37, view(), BACKGROUND, RasterizeOptions(depth=True))
    assert type(drawn) is RenderResult and drawn.image.median_depth is not None


def test_a_drawing_goes_when_nobody_holds_it() -> None:
    gc.disable()  # no cycle keeps it
    try:
        drawn = model_of(SHAPE).draw(0.37, view(), BACKGROUND, RasterizeOptions())
        assert isinstance(drawn, FusedRenderResult)
        frame = weakref.ref(drawn.drawing.frame)
        drawn.backward(torch.ones_like(drawn.image.rgb))
        del drawn
        assert frame() is None
    finally:
        gc.enable()


def test_a_model_is_drawn_by_the_backend_it_is_given() -> None:
    """By torch alone then, whatever the native library could do."""
    model, camera = model_of(SHAPE), view()
    model.backend = backend = MagicMock(wraps=RASTERIZERS["reference"])
    drawn = model.draw(0.37, camera, BACKGROUND, RasterizeOptions(), HALFWAY)
    assert [call.args[1] for call in backend.call_args_list] == [camera] and type(drawn) is RenderResult
    model.backend = None
    expected = model.draw(0.37, camera, BACKGROUND, RasterizeOptions(), HALFWAY)
    torch.testing.assert_close(drawn.image.rgb, expected.image.rgb, atol=1e-4, rtol=1e-3)
