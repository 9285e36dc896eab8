"""The FRoG model: fresh Gaussians, a network that computes what the formula says, and where training can start."""

import math
from dataclasses import replace

import pytest
import torch
from support.builders import plain_camera
from support.random_models import canonical, model_of
from torch.nn import functional

from frog_blender.engine.field.names import FORMS, FUSIONS, fused_size, network_count
from frog_blender.engine.field.network import fuse
from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.model.canonical import CanonicalField, new_gaussians
from frog_blender.engine.model.deformation import DeformationField, FrogSettings, reduction_factor
from frog_blender.engine.model.frog import Frog, initial_table, total_deformation
from frog_blender.engine.model.interface import FINISHED, ScheduleState, Static
from frog_blender.engine.rasterizer import rasterize

SETTINGS = FrogSettings(temporal_rows=6, coarse_rows=3, temporal_size=7, embedding_size=5, hidden_width=20)


def literal(field: DeformationField, temporal: torch.Tensor, embeddings: torch.Tensor) -> dict[str, torch.Tensor]:
    """The networks in the plainest way: concatenate, one layer, one head after the other; then add up."""
    n, total = field.networks, {}
    for k in range(n):
        weight = torch.cat([field.temporal_weight.chunk(n)[k], field.embedding_weight.chunk(n)[k]], dim=1)
        inputs = torch.cat([temporal[k].expand(len(embeddings), -1), embeddings], dim=1)
        hidden = functional.linear(inputs, weight, field.bias.chunk(n)[k])
        if field.modulated:
            product = embeddings * (temporal[k, : embeddings.shape[1]] - 1)
            hidden = hidden + functional.linear(product, field.modulation_weight.chunk(n)[k])
        hidden = hidden.relu()
        row = 0
        for index, (name, size) in enumerate(field.sizes.items()):
            head = hidden
            if field.head_width:
                part = slice(index * field.head_width, (index + 1) * field.head_width)
                weight, bias = field.head_weight.chunk(n)[k][part], field.head_bias.chunk(n)[k][part]
                head = functional.linear(hidden, weight, bias).relu()
            change = head @ field.output_weight.chunk(n, dim=1)[k][row : row + size].T
            total[name] = total[name] + change if k else change + field.output_bias[row : row + size]
            row += size
    return total


@pytest.mark.parametrize("networks", [1, 2])
@pytest.mark.parametrize("head_width", [0, 6])
@pytest.mark.parametrize("sh_count", [0, 1, 4])
@pytest.mark.parametrize("modulated", [False, True])
def test_the_folded_network_equals_the_literal_one(
    networks: int, head_width: int, sh_count: int, modulated: bool
) -> None:
    torch.manual_seed(3)
    shape = {"head_width": head_width, "deformed_sh": sh_count, "modulation": modulated}
    fusion = "dual" if networks == 2 else "product"
    field = model_of(replace(SETTINGS, fusion=fusion, **shape), 9).deformation
    temporal, embeddings = torch.randn(networks, 7), torch.randn(9, 5)
    changes, expected = field(temporal, embeddings), literal(field, temporal, embeddings)
    names = ["means", "log_scales", "quaternions", "opacity_logits"] + ["sh"] * bool(sh_count)
    assert list(changes) == list(expected) == names
    for name in expected:
        torch.testing.assert_close(changes[name], expected[name], atol=1e-6, rtol=1e-5)
        assert float(changes[name].detach().abs().max()) > 0.01


@pytest.mark.parametrize("size", [64, 9])
def test_the_table_begins_with_every_frequency_and_both_its_phases(size: int) -> None:
    """A pair of columns is a point that goes round: as fast as one of as many equal ranges of frequencies says."""
    settings = replace(SETTINGS, temporal_size=size, temporal_rows=200, coarse_rows=20)
    table = initial_table(settings) - 1
    assert table.shape == (200, size)
    pairs, waves = size // 2, -(-size // 2)
    points = torch.complex(table[:, 1 : 2 * pairs : 2], table[:, : 2 * pairs : 2])
    torch.testing.assert_close(points.abs(), torch.ones(200, pairs))
    frequencies = (points[1:] / points[:-1]).angle().mean(0) * 199 / (2 * math.pi)
    ranges = (frequencies * waves / 5).floor().int().sort().values.tolist()
    assert len(set(ranges)) == pairs and set(ranges) <= set(range(waves))


def test_the_embedding_is_the_product_of_coarse_and_fine() -> None:
    model = Frog(canonical(5), SETTINGS)
    table = model.temporal_table.detach()
    # Time 0.5 of six rows lies between rows 2 and 3; of three rows it is the middle one, which lies there too.
    middle = (table[2] + table[3]) / 2
    torch.testing.assert_close(model.temporal_embedding(0.5).detach(), (middle * middle)[None])
    coarse = table[0] * 0.5 + middle * 0.5
    fine = table[1] * 0.75 + table[2] * 0.25
    torch.testing.assert_close(model.temporal_embedding(0.25).detach(), (coarse * fine)[None])
    begun = model.temporal_embedding(0.25, ScheduleState(fine_rows=0.0))
    torch.testing.assert_close(begun.detach(), (coarse * coarse)[None])


def test_every_fusion_is_what_its_name_says() -> None:
    expected = {
        "product": [[0.5, -2, -6]],
        "add": [[1.5, 1, -1]],
        "concat": [[1.0, 2, -3, 0.5, -1, 2]],
        "coarse": [[1.0, 2, -3]],
        "fine": [[0.5, -1, 2]],
        "dual": [[1.0, 2, -3], [0.5, -1, 2]],
        "attention": [[0.625, -0.25, 0.75]],
    }
    assert expected.keys() == set(FUSIONS)
    for form, value in expected.items():
        fused = fuse(form, torch.tensor(expected["dual"]), lambda _: torch.tensor([0.25, 0.75]))
        assert torch.equal(fused, torch.tensor(value)), form
        assert fused.shape == (network_count(form), fused_size(form, 3))


def test_attention_lies_between_the_embeddings_and_follows_its_scores() -> None:
    model = Frog(canonical(5), replace(SETTINGS, fusion="attention"))
    model.attention_weight = torch.nn.Parameter(torch.eye(2) * 9)  # tanh is 1 where the embedding is
    for query, share in ((torch.zeros(2), 0.5), (torch.tensor([20.0, 0.0]), 1.0), (torch.tensor([0.0, 20.0]), 0.0)):
        model.attention_query = torch.nn.Parameter(query)
        fused = fuse("attention", torch.eye(2), model._shares)
        torch.testing.assert_close(fused, torch.tensor([[share, 1 - share]]), atol=1e-6, rtol=0)


@pytest.mark.parametrize("fusion", FUSIONS)
@pytest.mark.parametrize("head_width", [0, 6])
def test_every_fusion_learns_all_its_parameters(fusion: str, head_width: int) -> None:
    model = model_of(replace(SETTINGS, fusion=fusion, head_width=head_width), 12, 4)
    gaussians, _ = model.deform(0.37)
    sum(getattr(gaussians, name).square().sum() for name in ATTRIBUTES).backward()
    learned = {parameter for group in model.rate_groups().values() for parameter in group}
    assert learned == {p for name, p in model.named_parameters() if not name.startswith("canonical.")}
    for parameter in learned:
        assert parameter.grad is not None and bool(parameter.grad.any())


def test_an_opacity_that_does_not_deform_is_never_reduced() -> None:
    """The trap of sigmoid(k 0) = 1/2: without an opacity head the factor is one, in every form."""
    settings = replace(SETTINGS, opacity_reduction="paper", deformed_opacity=False)
    model = Frog(canonical(5), settings)
    optimizer = torch.optim.Adam(model.deformation.parameters(), lr=0.1)
    for _ in range(3):
        optimizer.zero_grad()
        (model.deform(0.4)[0].opacities.sum() + model.deform(0.4)[0].means.square().sum()).backward()
        optimizer.step()
    torch.testing.assert_close(model.deform(0.4)[0].opacities, model.canonical.gaussians().opacities)
    assert float((model.deform(0.4)[0].means - model.canonical.means).detach().abs().max()) > 1e-3
    assert model.stored_settings(FINISHED)["opacity_reduction"] == "off"


def test_the_table_is_smoothed_only_where_asked() -> None:
    assert Frog(canonical(5), SETTINGS).regularization() is None
    model = Frog(canonical(5), SETTINGS, table_smoothness=2.0)
    table = model.temporal_table.detach()
    torch.testing.assert_close(model.regularization().detach(), 2 * (table[1:] - table[:-1]).square().mean())
    table[:] = 1.5
    assert float(model.regularization().detach()) == 0.0


def test_total_deformation_weighs_attributes_equally_and_finds_the_calmest() -> None:
    """In plain norms the first would win; in units of each attribute's mean the third does."""
    changes = {
        "means": torch.tensor([[0.0, 0, 0], [200.0, 0, 0], [100.0, 0, 0]]),
        "opacity_logits": torch.tensor([[0.05], [0.04], [0.0]]),
        "quaternions": torch.tensor([[0.01, 0, 0, 0], [0.01, 0, 0, 0], [0.001, 0, 0, 0]]),
    }
    total = total_deformation(changes)
    expected = torch.tensor([0.05 / 0.03 + 0.01 / 0.007, 2.0 + 0.04 / 0.03 + 0.01 / 0.007, 1.0 + 0.001 / 0.007])
    torch.testing.assert_close(total, expected)
    assert int(total.argmin()) == 2


def test_the_static_baseline_is_the_canonical_field() -> None:
    model = Static(canonical())
    gaussians, changes = model.deform(0.8)
    assert changes == {}
    torch.testing.assert_close(gaussians.arrays, model.canonical.gaussians().arrays, rtol=0, atol=0)


CHANGES = torch.linspace(-3, 3, 601)


def test_the_factor_is_what_each_form_says() -> None:
    """As printed it halves what does not change; in the unit form it is one there, and off it is one everywhere."""
    assert float(reduction_factor(torch.zeros(1), "paper", 10.0)) == 0.5
    factors = reduction_factor(torch.tensor([0.1, -0.2]), "paper", 10.0)
    torch.testing.assert_close(factors, torch.tensor([1 / (1 + math.exp(-1)), 1 / (1 + math.exp(2))]))
    assert float(reduction_factor(torch.zeros(1), "unit", 10.0)) == 1.0
    assert (reduction_factor(CHANGES[CHANGES > 0], "unit", 10.0) == 1.0).all()
    assert float(reduction_factor(torch.tensor([-0.5]), "unit", 10.0)) < 0.02
    assert torch.equal(reduction_factor(CHANGES, "off", 10.0), torch.ones_like(CHANGES))


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_factors_rise_with_the_change_and_stay_in_range(form: str, share: float) -> None:
    factor = reduction_factor(CHANGES, form, 10.0, share)
    assert (factor.diff() >= 0).all()
    assert float(factor.min()) >= 0 and float(factor.max()) <= 1


def test_fresh_gaussians_are_what_they_were_made_from() -> None:
    points, colors = torch.randn(6, 3), torch.rand(6, 3)
    spacing = torch.rand(6) + 0.1
    field = CanonicalField(new_gaussians(points, colors, spacing, 9, 4))
    gaussians = field.gaussians()
    assert len(field) == 6 and gaussians.sh.shape == (6, 9, 3) and field.embeddings.shape == (6, 4)
    torch.testing.assert_close(gaussians.means, points)
    torch.testing.assert_close(gaussians.scales, spacing[:, None].expand(6, 3))
    torch.testing.assert_close(gaussians.opacities, torch.full((6,), 0.1))
    torch.testing.assert_close(gaussians.sh[:, 0] * 0.28209479177387814 + 0.5, colors)
    assert not gaussians.sh[:, 1:].any() and not field.embeddings.any()
    assert gaussians.quaternions.tolist() == [[1, 0, 0, 0]] * 6


def test_a_spacing_of_zero_is_survived() -> None:
    field = CanonicalField(new_gaussians(torch.zeros(2, 3), torch.zeros(2, 3), torch.zeros(2), 1, 0))
    assert torch.isfinite(field.log_scales).all()


def test_black_seeds_learn_colours() -> None:
    """A colour that is clipped at 0 gets no gradient; a seed's must not be."""
    camera = plain_camera()
    attributes = new_gaussians(torch.tensor([[0.0, 0, 2]]), torch.tensor([[0.9, 0.0, 1.0]]), torch.ones(1), 4, 8)
    field = CanonicalField(attributes)
    rasterize(field.gaussians(4), camera).rgb.sum().backward()
    assert field.sh.grad is not None and (field.sh.grad[0, 0] > 0).all()
