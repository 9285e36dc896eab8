"""Gaussians that other trainings share stay as they are, to the bit, whatever a training does."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from support import synthetic_capture as film
from support.training_steps import compression, train

from frog_blender.engine.training.compression.budget import keep_within
from frog_blender.engine.training.optimize.fixed_gaussians import SHARED_ATTRIBUTES, FixedGaussians
from frog_blender.engine.training.optimize.stateful import Tensors
from frog_blender.engine.training.optimize.trainer import Trainer

# Density control, anchors, sorting, size limits and milestones, all within few steps.
BUSY = {"densify_from": 0.05, "densify_until": 0.7, "densify_every": 0.06, "densify_threshold": 1e-9}
BUSY |= {"sampling_from": 0.05, "sampling_every": 0.06, "size_limit": 1e-3, "size_limit_from": 0.1, "sh_degree": 1}


def wall(sh_count: int = 4) -> Tensors:
    """The film's static Gaussians, a little off and some of them faint, so that a training would change them all."""
    still = film.gaussians_at(0)
    count = len(still.means) - 12
    random = torch.Generator().manual_seed(3)
    sh = torch.zeros(count, sh_count, 3)
    sh[:, 0] = torch.from_numpy(still.sh[:count, 0]).float()
    return {
        "means": torch.from_numpy(still.means[:count]).float() + 0.02 * torch.randn(count, 3, generator=random),
        "log_scales": torch.from_numpy(still.scales[:count]).float().log(),
        "quaternions": torch.from_numpy(still.quaternions[:count]).float(),
        "opacity_logits": torch.linspace(-9, 3, count),
        "sh": sh,
    }


def sorted_rows(values: Tensors) -> list[bytes]:
    rows = torch.cat([values[name].reshape(len(values["means"]), -1) for name in SHARED_ATTRIBUTES], dim=1)
    return sorted(row.numpy().tobytes() for row in rows)


def fixed_rows(trainer: Trainer) -> list[bytes]:
    gaussians = trainer.gaussians
    assert gaussians.fixed is not None
    mask = gaussians.fixed.mask
    return sorted_rows({name: getattr(gaussians.canonical, name).detach()[mask] for name in SHARED_ATTRIBUTES})


@pytest.fixture
def shared(make_trainer: Callable[..., Trainer]) -> Callable[..., Trainer]:
    def make(steps: int, **changes: object) -> Trainer:
        trainer = make_trainer(steps, capacity="auto", **{**BUSY, **changes})
        trainer.gaussians.add_fixed(wall())
        return trainer

    return make


def test_they_keep_every_bit_through_a_whole_training(shared: Callable[..., Trainer]) -> None:
    trainer, values = shared(50), wall()
    first = trainer.gaussians.canonical.means.detach()[0].clone()
    train(trainer)
    assert fixed_rows(trainer) == sorted_rows(values)
    assert trainer.finished and trainer.count > len(values["means"])
    assert not (trainer.gaussians.canonical.means == first).all(1).any(), "the others are to learn"


def test_they_are_drawn(shared: Callable[..., Trainer], make_trainer: Callable[..., Trainer]) -> None:
    assert (shared(50).render_image(0) - make_trainer(50, capacity="auto", **BUSY).render_image(0)).any()


def test_no_budget_removes_them(shared: Callable[..., Trainer]) -> None:
    trainer = shared(50, kept_gaussians=60)
    train(trainer)
    keep_within(compression(trainer), 10)
    assert trainer.count == len(wall()["means"])
    assert fixed_rows(trainer) == sorted_rows(wall())


def test_they_are_found_again_in_a_checkpoint(shared: Callable[..., Trainer]) -> None:
    straight = train(shared(40))
    half = train(shared(40), until=22)
    tensors, values = half.state()
    again = shared(40)
    again.load_state({name: value.clone() for name, value in tensors.items()}, values)
    train(again)
    assert fixed_rows(again) == fixed_rows(straight) == sorted_rows(wall())
    for name, value in straight.model.state_dict().items():
        assert torch.equal(value, again.model.state_dict()[name]), name


def test_losing_one_is_an_error(shared: Callable[..., Trainer]) -> None:
    gaussians = shared(50).gaussians
    with pytest.raises(ValueError, match="expected each of"):
        gaussians.keep(torch.arange(gaussians.count - 1))


@pytest.mark.parametrize("which", ["twice", "dynamic", "shape"])
def test_a_checkpoint_that_does_not_fit_is_refused(shared: Callable[..., Trainer], which: str) -> None:
    fixed = shared(50).gaussians.fixed
    assert isinstance(fixed, FixedGaussians)
    found = fixed.state()["fixed.which"].clone()
    if which == "twice":
        found[-1] = found[-2]
    elif which == "dynamic":
        found = found.flip(0)
    else:
        found = found[1:]
    with pytest.raises(ValueError):
        fixed.load_state({"fixed.which": found})
