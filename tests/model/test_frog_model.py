"""The FRoG model: its network computes what the formula says, and starts where training can start."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch.nn import functional

from frog_blender.engine.model.baselines.static import Static
from frog_blender.engine.model.canonical import CanonicalField, new_gaussians
from frog_blender.engine.model.deformation import DeformationField
from frog_blender.engine.model.frog import Frog, FrogSettings, Progressing, total_deformation

SETTINGS = FrogSettings(temporal_rows=6, coarse_rows=3, temporal_size=7, embedding_size=5, hidden_width=20)
ATTRIBUTES = ("means", "quaternions", "scales", "opacities", "sh")


def canonical(count: int = 12, sh_count: int = 4, embedding_size: int = 5) -> CanonicalField:
    generator = torch.Generator().manual_seed(1)
    points = torch.randn(count, 3, generator=generator)
    colors = torch.rand(count, 3, generator=generator)
    values = new_gaussians(points, colors, torch.full((count,), 0.1), sh_count, embedding_size)
    values["embeddings"] = torch.randn(count, embedding_size, generator=generator)
    return CanonicalField(values)


def awake(field: DeformationField) -> DeformationField:
    """With outputs that are not zero."""
    generator = torch.Generator().manual_seed(2)
    for parameter in (field.output_weight, field.output_bias):
        parameter.data = torch.randn(parameter.shape, generator=generator) * 0.3
    return field


def literal(field: DeformationField, temporal: torch.Tensor, embeddings: torch.Tensor) -> dict[str, torch.Tensor]:
    """The network as a newcomer would write it: concatenate, one layer, one head after the other."""
    weight = torch.cat([field.temporal_weight, field.embedding_weight], dim=1)
    inputs = torch.cat([temporal.expand(len(embeddings), -1), embeddings], dim=1)
    hidden = functional.linear(inputs, weight, field.bias).relu()
    changes, row = {}, 0
    for number, (name, size) in enumerate(field.sizes.items()):
        head = hidden
        if field.head_width:
            part = slice(number * field.head_width, (number + 1) * field.head_width)
            head = functional.linear(hidden, field.head_weight[part], field.head_bias[part]).relu()
        changes[name] = functional.linear(
            head, field.output_weight[row : row + size], field.output_bias[row : row + size]
        )
        row += size
    return changes


@pytest.mark.parametrize("head_width", [0, 6])
@pytest.mark.parametrize("sh_count", [0, 1, 4])
def test_the_folded_network_equals_the_literal_one(head_width: int, sh_count: int) -> None:
    torch.manual_seed(3)
    field = awake(DeformationField(5, 7, 20, head_width, sh_count))
    temporal, embeddings = torch.randn(7), torch.randn(9, 5)
    found, expected = field(temporal, embeddings), literal(field, temporal, embeddings)
    assert (
        list(found)
        == list(expected)
        == ["means", "log_scales", "quaternions", "opacity_logits"] + ["sh"] * bool(sh_count)
    )
    for name in expected:
        torch.testing.assert_close(found[name], expected[name], atol=1e-6, rtol=1e-5)
        assert float(found[name].detach().abs().max()) > 0.01


@pytest.mark.parametrize("head_width", [0, 6])
def test_every_weight_has_the_gradient_of_the_literal_network(head_width: int) -> None:
    torch.manual_seed(3)
    field = awake(DeformationField(5, 7, 20, head_width, 1))
    temporal, embeddings = torch.randn(7), torch.randn(9, 5)
    targets = {name: torch.randn(9, size) for name, size in field.sizes.items()}
    gradients = []
    for network in (field, lambda *inputs: literal(field, *inputs)):
        field.zero_grad()
        sum((change * targets[name]).sum() for name, change in network(temporal, embeddings).items()).backward()
        gradients.append([parameter.grad.clone() for parameter in field.parameters()])
    for found, expected in zip(*gradients, strict=True):
        torch.testing.assert_close(found, expected, atol=1e-5, rtol=1e-4)


@pytest.mark.parametrize("form", ["unit", "off"])
@pytest.mark.parametrize("head_width", [0, 6])
def test_training_starts_from_the_undeformed_scene(form: str, head_width: int) -> None:
    model = Frog(canonical(), replace(SETTINGS, opacity_reduction=form, head_width=head_width, deformed_sh=4))
    for time in (0.0, 0.3, 1.0):
        moved, still = model(time), model.canonical.gaussians()
        for name in ATTRIBUTES:
            torch.testing.assert_close(getattr(moved, name), getattr(still, name), rtol=1e-6, atol=1e-7)


def test_the_paper_form_starts_at_half_the_opacity() -> None:
    model = Frog(canonical(), replace(SETTINGS, opacity_reduction="paper"))
    torch.testing.assert_close(model(0.5).opacities, model.canonical.gaussians().opacities / 2)
    torch.testing.assert_close(model(0.5, Progressing(opacity=0.0)).opacities, model.canonical.gaussians().opacities)


def table_gradient(model: Frog) -> torch.Tensor:
    awake(model.deformation)
    model(0.37).means.square().sum().backward()
    return model.temporal_table.grad


def test_the_table_learns_from_the_start() -> None:
    gradient = table_gradient(Frog(canonical(), SETTINGS))
    assert float(gradient.abs().max()) > 1e-4
    used = gradient.abs().amax(1) > 0
    assert int(used.sum()) >= 2


def test_a_table_of_zeros_would_never_learn() -> None:
    """The trap that the initialisation around one avoids."""
    model = Frog(canonical(), SETTINGS)
    model.temporal_table.data.zero_()
    assert not table_gradient(model).any()


def test_the_embedding_is_the_product_of_coarse_and_fine() -> None:
    model = Frog(canonical(), SETTINGS)
    table = model.temporal_table.detach()
    # Time 0.5 of six rows lies between rows 2 and 3; of three rows it is the middle one, which lies there too.
    middle = (table[2] + table[3]) / 2
    torch.testing.assert_close(model.temporal_embedding(0.5).detach(), middle * middle)
    coarse = table[0] * 0.5 + middle * 0.5
    fine = table[1] * 0.75 + table[2] * 0.25
    torch.testing.assert_close(model.temporal_embedding(0.25).detach(), coarse * fine)
    torch.testing.assert_close(model.temporal_embedding(0.25, Progressing(fine_rows=0.0)).detach(), coarse * coarse)


def test_changes_of_the_means_are_in_world_units() -> None:
    model = Frog(canonical(), replace(SETTINGS, motion_unit=3.0))
    awake(model.deformation)
    gaussians, changes = model.deform(0.4)
    raw = model.deformation(model.temporal_embedding(0.4), model.canonical.embeddings)["means"]
    torch.testing.assert_close(changes["means"], 3 * raw)
    torch.testing.assert_close(gaussians.means - model.canonical.means, 3 * raw, atol=1e-5, rtol=1e-4)


def test_only_the_deformed_coefficients_change() -> None:
    model = Frog(canonical(sh_count=9), replace(SETTINGS, deformed_sh=4))
    awake(model.deformation)
    change = (model(0.4).sh - model.canonical.sh).detach()
    assert (change[:, :4].abs().amax((0, 2)) > 1e-3).all() and not change[:, 4:].any()


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


def test_total_deformation_without_any_change_is_finite() -> None:
    model = Frog(canonical(), SETTINGS)
    total = total_deformation(model.deform(0.3)[1])
    assert total.shape == (12,) and torch.isfinite(total).all() and not total.requires_grad


def test_the_static_baseline_is_the_canonical_field() -> None:
    model = Static(canonical(embedding_size=0))
    gaussians, changes = model.deform(0.8)
    assert changes == {}
    for name in ATTRIBUTES:
        assert torch.equal(getattr(gaussians, name), getattr(model.canonical.gaussians(), name))
