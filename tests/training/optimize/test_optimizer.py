"""Who stands where after Gaussians came and went, and that values and Adam's memory went with them."""

from __future__ import annotations

import pytest
import torch
from support.training_steps import OnlyGaussians

from frog_blender.engine.model.canonical import ATTRIBUTES, CanonicalField, new_gaussians
from frog_blender.engine.recipes import RECIPES
from frog_blender.engine.training.optimize.gaussian_state import GaussianState

COUNT, MOVING = 12, 8


def values_of(count: int, first: float) -> dict[str, torch.Tensor]:
    """Attributes whose every number says whose it is: ``first``, ``first`` + 1 and so on."""
    values = new_gaussians(torch.zeros(count, 3), torch.zeros(count, 3), torch.ones(count), 4, 3)
    rows = torch.arange(first, first + count)
    return {name: rows.view(-1, *[1] * (value.dim() - 1)).expand_as(value).clone() for name, value in values.items()}


def scene() -> GaussianState:
    """Twelve Gaussians, of which eight move, whose Adam remembers of each which one it is."""
    values = values_of(COUNT, 1.0)
    canonical = CanonicalField(values | {"embeddings": values["embeddings"][:MOVING]})
    gaussians = GaussianState(OnlyGaussians(canonical), RECIPES["draft"], 1.0)
    for name in ATTRIBUTES:
        parameter = getattr(canonical, name)
        parameter.grad = parameter.detach().clone()
    gaussians.optimizer.step()
    for group in gaussians.optimizer.adam.param_groups:
        for parameter in group["params"]:
            parameter.data[...] = torch.arange(1.0, len(parameter) + 1).view(-1, *[1] * (parameter.dim() - 1))
    return gaussians


def told(array: torch.Tensor) -> list[float]:
    """The number that a Gaussian's every number is, for each."""
    rows = array.detach()[:, None].flatten(1)
    assert (rows == rows[:, :1]).all()
    return rows[:, 0].tolist()


@pytest.mark.parametrize(
    ("leaving", "movers", "resting", "expected"),
    [
        ([], 0, 0, [1, 2, 3, 4, 5, 6, 7, 8, 9, 10, 11, 12]),
        ([2], 1, 0, [1, 2, 101, 4, 5, 6, 7, 8, 9, 10, 11, 12]),
        ([2, 9], 1, 1, [1, 2, 101, 4, 5, 6, 7, 8, 9, 102, 11, 12]),
        ([2, 9], 2, 0, [1, 2, 101, 4, 5, 6, 7, 8, 102, 9, 11, 12]),
        ([1, 4, 6], 2, 0, [1, 101, 3, 4, 102, 6, 8, 9, 10, 11, 12]),
        ([3], 3, 2, [1, 2, 3, 101, 5, 6, 7, 8, 102, 103, 9, 10, 11, 12, 104, 105]),
        ([*range(MOVING)], 0, 1, [9, 10, 11, 12, 101]),
        ([*range(COUNT)], 3, 1, [101, 102, 103, 104]),
    ],
)
def test_new_gaussians_take_the_rows_that_become_free(
    leaving: list[int], movers: int, resting: int, expected: list[int]
) -> None:
    gaussians = scene()
    canonical, optimizer = gaussians.canonical, gaussians.optimizer
    keep = torch.tensor([i for i in range(COUNT) if i not in leaving], dtype=torch.int64)
    new = values_of(movers + resting, 101.0)
    indices = gaussians.replace(keep, new | {"embeddings": new["embeddings"][:movers]})
    assert [i + 1 if i < COUNT else i - COUNT + 101 for i in indices.tolist()] == expected
    moving = MOVING - sum(i < MOVING for i in leaving) + movers
    for name in ATTRIBUTES:
        parameter = getattr(canonical, name)
        mine = expected[:moving] if name == "embeddings" else expected
        assert told(parameter) == mine, name
        (group,) = (group for group in optimizer.adam.param_groups if group["name"] == name)
        assert len(group["params"]) == 1 and group["params"][0] is parameter
        state = optimizer.adam.state[parameter]
        remembered = [0.0 if i > 100 else float(i) for i in mine]
        torch.testing.assert_close(torch.tensor(told(10 * state["exp_avg"])), torch.tensor(remembered))
        squares = torch.tensor(remembered).square()
        torch.testing.assert_close(torch.tensor(told(1000 * state["exp_avg_sq"])), squares, rtol=1e-4, atol=0)
        assert state["step"] == 1 and len(optimizer.adam.state) == len(ATTRIBUTES)
