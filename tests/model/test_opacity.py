"""Aggressive opacity reduction in its three forms."""

from __future__ import annotations

import math

import pytest
import torch

from frog_blender.engine.field.names import FORMS
from frog_blender.engine.model.deformation import reduction_factor

CHANGES = torch.linspace(-3, 3, 601)


def test_the_formula_as_printed_halves_what_does_not_change() -> None:
    assert float(reduction_factor(torch.zeros(1), "paper", 10.0)) == 0.5
    found = reduction_factor(torch.tensor([0.1, -0.2]), "paper", 10.0)
    torch.testing.assert_close(found, torch.tensor([1 / (1 + math.exp(-1)), 1 / (1 + math.exp(2))]))


def test_the_unit_form_is_one_where_nothing_changes() -> None:
    assert float(reduction_factor(torch.zeros(1), "unit", 10.0)) == 1.0
    assert (reduction_factor(CHANGES[CHANGES > 0], "unit", 10.0) == 1.0).all()
    assert float(reduction_factor(torch.tensor([-0.5]), "unit", 10.0)) < 0.02


@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("share", [0.0, 0.4, 1.0])
def test_factors_rise_with_the_change_and_stay_in_range(form: str, share: float) -> None:
    factor = reduction_factor(CHANGES, form, 10.0, share)
    assert (factor.diff() >= 0).all()
    assert float(factor.min()) >= 0 and float(factor.max()) <= 1


def test_off_is_one() -> None:
    assert torch.equal(reduction_factor(CHANGES, "off", 10.0), torch.ones_like(CHANGES))


def test_sharpness_is_the_slope() -> None:
    change = torch.tensor([-0.05], requires_grad=True)
    reduction_factor(change, "paper", 10.0).sum().backward()
    at = 1 / (1 + math.exp(0.5))
    torch.testing.assert_close(change.grad, torch.tensor([10 * at * (1 - at)]))
