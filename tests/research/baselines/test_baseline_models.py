"""Each baseline starts where it should, as FRoG does, learns with all it has, and computes what its paper says."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support.random_models import COUNT, built, canonical, perturbed, scene_of

from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.recipes import recipe
from frog_blender.engine.registry import METHODS
from frog_blender.engine.scene.scene_file import SceneFile, write_scene
from frog_blender.engine.training.methods import ModelInit
from frog_blender.research.baselines import curves, d3dgs, hexplane
from frog_blender.research.baselines.networks import through_visible_rows

BASELINES = ("d3dgs", "hexplane", "curves")


@pytest.mark.parametrize("method", ["frog", "d3dgs", "hexplane"])
@pytest.mark.parametrize("form", ["unit", "off"])
@pytest.mark.parametrize("width", [{"head_width": 6, "deformed_sh": 4}, {"hidden_width": 128, "head_width": 128}, {}])
def test_training_starts_from_the_undeformed_scene(method: str, form: str, width: dict[str, int]) -> None:
    model = built(method, opacity_reduction=form, **width)
    still = model.canonical.gaussians().arrays
    for time in (0.0, 0.3, 1.0):
        torch.testing.assert_close(model.deform(time)[0].arrays, still, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("wide", [False, True], ids=["small", "paper"])
@pytest.mark.parametrize("method", BASELINES)
def test_gradients_reach_every_parameter(method: str, wide: bool) -> None:
    settings = {"hidden_width": 128, "head_width": 128, "deformed_sh": 4} if wide else {}
    model = perturbed(built(method, **settings))
    for time in (0.0, 0.37, 0.8):
        gaussians = model.deform(time)[0]
        sum(getattr(gaussians, name).square().sum() for name in ATTRIBUTES).backward()
    driven = {id(p) for group in model.rate_groups().values() for p in group}
    for name, parameter in model.named_parameters():
        if parameter.numel():
            assert parameter.grad is not None and float(parameter.grad.abs().max()) > 0, name
        assert name.startswith("canonical.") != (id(parameter) in driven), "no rate drives it, or two do"


@pytest.mark.parametrize("method", BASELINES)
def test_the_world_can_be_as_large_as_it_likes(method: str) -> None:
    """The same scene ten times as large moves ten times as far: no rate or encoding depends on the unit."""
    adapted = METHODS[method].adapted(recipe("draft"))
    motions = []
    for factor in (1.0, 10.0):
        torch.manual_seed(4)
        field = canonical(adapted.embedding_size)
        field.means.data *= factor
        model = perturbed(METHODS[method].model(ModelInit(field, adapted, 9, 36, 3.0 * factor)))
        motions.append((model.deform(0.3)[0].means - field.means).detach() / factor)
    assert float(motions[0].abs().max()) > 0.01
    torch.testing.assert_close(motions[0], motions[1], atol=2e-3, rtol=2e-3)


def test_an_encoding_is_the_values_and_their_octaves() -> None:
    values = torch.tensor([[0.3, -1.2]])
    encoded = d3dgs.encode(values, 3)
    expected = [*values[0]]
    for function in (torch.sin, torch.cos):
        expected += [function(value * octave) for value in values[0] for octave in (1, 2, 4)]
    torch.testing.assert_close(encoded, torch.stack(expected)[None])


def literal_d3dgs(model: d3dgs.D3dgs, time: float) -> torch.Tensor:
    """As the paper draws it: place and time concatenated, and again before the layer of the skip."""
    network, s = model.deformation, model.settings
    position = d3dgs.encode((model.canonical.means - network.origin) / network.extent, s.space_frequencies)
    time_code = d3dgs.encode(torch.tensor([[time]]), s.time_frequencies).expand(len(position), -1)
    encoded = torch.cat([position, time_code], dim=1)
    hidden = encoded
    for index, layer in enumerate(network.layers):
        hidden = layer(torch.cat([encoded, hidden], dim=1) if index == s.skip else hidden).relu()
    return network.output(hidden)


@pytest.mark.parametrize("width", [64, 128])
def test_d3dgs_is_the_literal_network(width: int) -> None:
    model = perturbed(built("d3dgs", hidden_width=width))
    assert (model.settings.depth, model.settings.width, model.settings.skip) == ((4, 64, 3), (8, 256, 5))[width > 64]
    torch.testing.assert_close(
        model.deformation(model.canonical.means, 0.4), literal_d3dgs(model, 0.4), atol=1e-5, rtol=1e-4
    )


def test_d3dgs_keeps_places_out_of_the_gradient() -> None:
    """Only what is added to the mean reaches it."""
    model = perturbed(built("d3dgs"))
    model.deform(0.4)[0].means.sum().backward()
    torch.testing.assert_close(model.canonical.means.grad, torch.ones(COUNT, 3))


def bilinear(plane: torch.Tensor, column: float, row: float) -> torch.Tensor:
    """(C,) of a plane (C, rows, columns) at a place in cells, literally."""
    rows, columns = plane.shape[1:]
    total = torch.zeros(plane.shape[0])
    for r in range(rows):
        for c in range(columns):
            total += max(0.0, 1 - abs(row - r)) * max(0.0, 1 - abs(column - c)) * plane[:, r, c]
    return total


def test_hexplane_features_are_products_over_six_planes() -> None:
    settings = hexplane.HexPlaneSettings(2, (4, 7), 5, 8, 0, 1, True, 1.0)
    torch.manual_seed(0)
    model = perturbed(hexplane.HexPlane(canonical(), settings))
    field = model.deformation
    # One inside the box, one beyond its rim.
    means = torch.stack([field.origin + 0.7 * field.extent, field.origin + field.extent + 5])
    means[1, 0] = field.origin[0] + 0.4 * field.extent[0]
    features_of_both = field.features(means, 0.6)
    for mean, features in zip(means, features_of_both, strict=True):
        u = ((mean - field.origin) / field.extent).clamp(0, 1)
        expected = []
        for space, over_time, size in zip(field.space_planes, field.time_planes, (4, 7), strict=True):
            x, y, z = (u * (size - 1)).tolist()
            product = torch.ones(2)
            for plane, (column, row) in zip(space, ((x, y), (x, z), (y, z)), strict=True):
                product = product * bilinear(plane, column, row)
            for plane, column in zip(over_time, (x, y, z), strict=True):
                product = product * bilinear(plane, column, 0.6 * 4)
            expected.append(product)
        torch.testing.assert_close(features, torch.cat(expected), atol=1e-6, rtol=1e-4)


def test_hexplane_pulls_its_planes_smooth_and_still() -> None:
    model = built("hexplane")
    field = model.deformation
    before = float(model.regularization())
    for space in field.space_planes:
        space.data.fill_(0.3)
    assert float(model.regularization()) == 0 < before
    slope = torch.linspace(-1, 1, 5)[:, None]
    for over_time in field.time_planes:
        over_time.data += slope
    even = float(model.regularization())  # an even change has no second difference; only stillness is lost
    assert even == pytest.approx(2 * hexplane.STILLNESS_WEIGHT * float(slope.abs().mean()), rel=1e-4)
    for over_time in field.time_planes:
        over_time.data += slope.square()
    assert float(model.regularization()) > 4 * even
    model.regularization().backward()
    assert all(p.grad is not None for p in (*field.space_planes, *field.time_planes))


@pytest.mark.parametrize("method", ["d3dgs", "hexplane"])
@pytest.mark.parametrize("rows", [0, 17])
def test_leaving_out_what_was_not_drawn_changes_no_gradient(method: str, rows: int) -> None:
    model = perturbed(built(method))
    field, means = model.deformation, model.canonical.means
    if method == "d3dgs":
        means = means.detach()
    inputs = [*field.parameters()] + [means] * (method == "hexplane")
    weights = torch.randn(COUNT, field(means, 0.3).shape[1], generator=torch.Generator().manual_seed(8))
    weights[torch.randperm(COUNT)[rows:]] = 0
    plain = torch.autograd.grad((field(means, 0.3) * weights).sum(), inputs)
    sparse = torch.autograd.grad((through_visible_rows(field, means, 0.3) * weights).sum(), inputs)
    for one, other in zip(sparse, plain, strict=True):
        torch.testing.assert_close(one, other, atol=1e-5, rtol=1e-4)


def test_curves_are_the_formula_in_their_units() -> None:
    settings = curves.CurveSettings((2.0, 3.0, 4.0), 0.5, 0.1, 0.7, 0.4)
    field = canonical(curves.EMBEDDING_SIZE)
    field.embeddings.data = torch.randn(COUNT, 15, generator=torch.Generator().manual_seed(3))
    model, time = curves.Curves(field, settings), 0.8
    e = field.embeddings
    since = time - (0.5 + 0.1 * e[:, 13:14])
    gaussians = model.deform(time)[0]
    motion = 2 * e[:, 0:3] * since + 3 * e[:, 3:6] * since**2 + 4 * e[:, 6:9] * since**3
    torch.testing.assert_close(gaussians.means, field.means + motion, atol=1e-5, rtol=1e-5)
    torch.testing.assert_close(gaussians.quaternions, field.quaternions + 0.5 * since * e[:, 9:13])
    width = 0.4 * torch.exp(0.7 * e[:, 14])
    expected = torch.sigmoid(field.opacity_logits) * torch.exp(-((since[:, 0] / width) ** 2))
    torch.testing.assert_close(gaussians.opacities, expected)


def test_fresh_curves_stand_still_and_are_there_at_all_times() -> None:
    model = built("curves")
    still = model.canonical.gaussians()
    for time in (0.0, 0.5, 1.0):
        torch.testing.assert_close(model.deform(time)[0].means, still.means)
        torch.testing.assert_close(model.deform(time)[0].quaternions, still.quaternions)
        assert bool((model.deform(time)[0].opacities > 0.3 * still.opacities).all())


TIMES = (0.0, 0.013, 0.25, 0.5, 0.9, 1.0)
SHAPES = [
    ("d3dgs", {}),
    ("d3dgs", {"hidden_width": 128}),
    ("hexplane", {}),
    ("hexplane", {"head_width": 24, "deformed_sh": 4}),
    ("hexplane", {"deformed_opacity": False, "deformed_sh": 0}),
    ("curves", {}),
]


@pytest.mark.parametrize(("method", "settings"), SHAPES, ids=str)
def test_gaussians_at_many_times(tmp_path: Path, method: str, settings: dict) -> None:
    model = perturbed(built(method, **settings))
    write_scene(tmp_path / "x.frog", scene_of(method, model))
    played = ScenePlayer.load(tmp_path / "x.frog")
    still = set(played.columns) - set(played.changing)
    assert ("scales" in still) == (method == "curves") and "sh_3" in played.columns
    for time in TIMES:
        gaussians, part = played.at(time), played.delta_at(time)
        with torch.no_grad():
            expected = model.deform(time)[0]
        assert float((expected.means - model.canonical.means).detach().abs().max()) > 1e-3  # it does move
        expected.quaternions = torch.nn.functional.normalize(expected.quaternions, dim=1)
        kept = ScenePlayer.load(tmp_path / "x.frog").at(time, part)
        for name in ATTRIBUTES:
            values = getattr(gaussians, name)
            assert values.dtype == np.float32 and values.flags.c_contiguous
            np.testing.assert_allclose(
                values, getattr(expected, name).detach().numpy(), rtol=1e-5, atol=1e-5, err_msg=name
            )
            np.testing.assert_array_equal(values, getattr(kept, name), err_msg=name)


HOSTILE = [
    ("d3dgs", "network.layers.1.weight", None),
    ("d3dgs", "network.layers.0.weight", (64, 3)),
    ("d3dgs", "network.extent", "zero"),
    ("d3dgs", "network.layers.2.bias", "nan"),
    ("d3dgs", "depth", 10**9),
    ("d3dgs", "space_frequencies", "many"),
    ("d3dgs", "motion_unit", float("nan")),
    ("hexplane", "network.space_planes.0", (3, 16, 32, 31)),
    ("hexplane", "network.extent", "zero"),
    ("hexplane", "time_rows", 1),
    ("hexplane", "resolutions", (1, 64)),
    ("hexplane", "resolutions", 32),
    ("hexplane", "head_width", 10**6),
    ("curves", "embeddings", (COUNT, 14)),
    ("curves", "motion_units", (1.0, 2.0)),
    ("curves", "first_width", None),
]


@pytest.mark.parametrize(("method", "name", "instead"), HOSTILE, ids=lambda value: str(value))
def test_what_does_not_fit_is_refused_in_a_sentence(method: str, name: str, instead: object) -> None:
    scene = scene_of(method, perturbed(built(method)))
    arrays, model = dict(scene.arrays), dict(scene.header.model)
    if name not in arrays and name in model:
        model[name] = instead
        if instead is None:
            del model[name]
    elif instead is None:
        del arrays[name]
    elif isinstance(instead, tuple):
        arrays[name] = np.ones(instead, np.float32)
    else:
        arrays[name] = np.full_like(arrays[name], 0 if instead == "zero" else np.nan)
    with pytest.raises(FrogError, match=r"^The method \S+ cannot play what a training of it wrote \(.*\)\.$"):
        ScenePlayer(SceneFile(replace(scene.header, model=model), arrays))
