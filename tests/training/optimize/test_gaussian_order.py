"""Where Gaussians stand in their arrays: whoever knows them by their places follows."""

from __future__ import annotations

from collections.abc import Callable

import pytest
import torch
from support.builders import steps_between
from support.training_steps import train

from frog_blender.engine.training.optimize.gaussian_state import freeze_motion
from frog_blender.engine.training.optimize.trainer import Trainer

pytestmark = pytest.mark.usefixtures("quick_seeds")
Make = Callable[..., Trainer]


def rest_of(trainer: Trainer, who: torch.Tensor) -> dict[str, torch.Tensor]:
    """A state that tells every Gaussian apart, for freeze_motion."""
    canonical = trainer.model.canonical
    names = ("means", "quaternions", "log_scales", "opacity_logits", "sh")
    return {name: getattr(canonical, name).detach()[: canonical.num_dynamic] + 0.01 for name in names}


def test_rest_is_the_same_at_all_times_and_moves_no_one_else(make_trainer: Make) -> None:
    trainer = train(make_trainer(100), until=50)
    count, who = trainer.count, torch.tensor([3, 10, 11, 200])
    before, state = trainer.deform(0.3, 1.0)[0], rest_of(trainer, who)
    memory = trainer.optimizer.adam.state[trainer.model.canonical.means]["exp_avg"].clone()
    freeze_motion(trainer.gaussians, who, state)
    canonical = trainer.model.canonical
    assert (trainer.count, canonical.num_dynamic) == (count, count - 4)
    others = torch.tensor([i for i in range(count) if i not in who.tolist()])
    for time in (0.3, 0.9):
        after = trainer.deform(time, 1.0)[0]
        torch.testing.assert_close(after.means[count - 4 :], state["means"][who])
        torch.testing.assert_close(after.scales[count - 4 :], state["log_scales"][who].exp())
    after = trainer.deform(0.3, 1.0)[0]
    torch.testing.assert_close(after.means[: count - 4], before.means[others])
    torch.testing.assert_close(after.opacities[: count - 4], before.opacities[others])
    now = trainer.optimizer.adam.state[canonical.means]["exp_avg"]
    torch.testing.assert_close(now, memory[torch.cat([others, who])])
    assert trainer.smoothness.graph is None or int(trainer.smoothness.graph.neighbours.max()) < canonical.num_dynamic
    train(trainer)
    assert torch.isfinite(trainer.model.canonical.means).all()


def test_a_training_leaves_neighbours_together(make_trainer: Make) -> None:
    canonical = train(make_trainer(100, capacity="auto")).model.canonical
    means = canonical.means.detach()[: canonical.num_dynamic].numpy()
    order = torch.randperm(len(means), generator=torch.Generator().manual_seed(1)).numpy()
    assert steps_between(means) < 0.7 * steps_between(means[order])
