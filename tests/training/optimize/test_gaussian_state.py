"""Whatever is kept by Gaussian follows every change of the rows, and whatever a training remembers is in its state."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
import torch
from support.training_steps import compression, train

from frog_blender.engine.training.compression import passes
from frog_blender.engine.training.compression.budget import keep_within
from frog_blender.engine.training.optimize.gaussian_state import Reindexing, freeze_motion, sort_by_morton_code
from frog_blender.engine.training.optimize.stateful import Tensors, Values
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.optimize.training import Hook, Training
from frog_blender.engine.training.session.checkpoint import load_checkpoint, save_checkpoint
from frog_blender.engine.training.session.export import remove_non_finite
from frog_blender.engine.training.session.recovery import Recovery

Make = Callable[..., Trainer]
NEW = -1.0


class Labels:
    """A label for every Gaussian, all of them and the dynamic ones alone, and the means that they had."""

    def __init__(self, trainer: Trainer) -> None:
        gaussians = trainer.gaussians
        self.all = torch.arange(float(gaussians.count))
        self.dynamic = self.all[: gaussians.num_dynamic].clone()
        self.colors = gaussians.canonical.sh.detach()[:, 0].clone()
        self.changes = 0
        gaussians.register(self.reindex)

    def reindex(self, change: Reindexing) -> None:
        self.changes += 1
        assert (len(self.all), len(self.dynamic)) == (change.count, change.num_dynamic)
        fresh = torch.tensor([NEW])
        self.all = torch.cat([self.all, fresh])[change.indices.clamp(max=change.count)]
        self.dynamic = torch.cat([self.dynamic, fresh])[change.dynamic.clamp(max=change.num_dynamic)]

    def check(self, trainer: Trainer, frozen: bool = False) -> None:
        """Each label is where its Gaussian is, whose colour no operation changes but freezing."""
        gaussians = trainer.gaussians
        assert self.changes > 0
        assert (len(self.all), len(self.dynamic)) == (gaussians.count, gaussians.num_dynamic)
        old = self.dynamic != NEW
        assert torch.equal(self.dynamic[old], self.all[: len(old)][old])
        kept = self.all != NEW
        if not frozen:
            torch.testing.assert_close(gaussians.canonical.sh.detach()[kept, 0], self.colors[self.all[kept].long()])


def state_of_dynamic(trainer: Trainer) -> Tensors:
    names = ("means", "quaternions", "log_scales", "opacity_logits", "sh")
    canonical = trainer.gaussians.canonical
    return {name: getattr(canonical, name).detach()[: trainer.gaussians.num_dynamic].clone() for name in names}


def grow(trainer: Trainer) -> None:
    trainer.density.gradient_sum += 1.0
    trainer.density.seen += 1.0
    trainer.density.peak_opacity[:5] = 0.0
    trainer.density.round(trainer.gaussians, trainer.count + 50, trainer.generator)


def prune_by_images(trainer: Trainer) -> None:
    context, generator = compression(trainer), torch.Generator().manual_seed(0)
    evaluator, measured = context.evaluator(), context.measure(context.sample_views(generator, 4), generator)
    context.compress(evaluator, passes.prune(context, evaluator, measured))


def spoil(trainer: Trainer) -> None:
    trainer.gaussians.canonical.means.data[[4, 9]] = torch.nan
    remove_non_finite(trainer.gaussians)


OPERATIONS: dict[str, Callable[[Trainer], object]] = {
    "densification": grow,
    "anchors": lambda trainer: trainer.inject_anchors(0.5, 8),
    "sorting": lambda trainer: sort_by_morton_code(trainer.gaussians),
    "freezing": lambda trainer: freeze_motion(trainer.gaussians, torch.arange(3, 90), state_of_dynamic(trainer)),
    "pruning": prune_by_images,
    "a budget": lambda trainer: keep_within(compression(trainer), trainer.count - 7),
    "out of memory": lambda trainer: Recovery(trainer).rollback(MemoryError()),
    "broken Gaussians": spoil,
}


@pytest.mark.parametrize("operation", OPERATIONS)
def test_every_follower_follows_every_operation(make_trainer: Make, operation: str) -> None:
    trainer = train(make_trainer(60, capacity="auto", sampling_share=0.05), until=20)
    labels = Labels(trainer)
    OPERATIONS[operation](trainer)
    labels.check(trainer)
    trainer.step()


def test_a_follower_follows_a_whole_training(make_trainer: Make) -> None:
    trainer = make_trainer(60, capacity="auto", sampling_share=0.05)
    labels = Labels(trainer)
    train(trainer)
    assert labels.changes > 20
    labels.check(trainer, frozen=True)


class Counting(Hook):
    """Counts steps and milestones."""

    def __init__(self) -> None:
        self.steps = self.milestones = 0

    def after_step(self, training: Training, before: float, now: float) -> None:
        self.steps += 1

    def before_milestone(self) -> None:
        self.milestones += 1

    def allows_growth(self, progress: float) -> bool:
        return False

    def validation_at(self, progress: float) -> tuple[int, ...]:
        return (8,)

    def state(self) -> tuple[Tensors, Values]:
        return {}, {"counted": self.steps}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        self.steps = values["counted"]


def test_a_hook_is_called_asked_and_saved(make_trainer: Make, watched: Callable, tmp_path: Path) -> None:
    frames = watched()
    trainer, hook = make_trainer(40, capacity="auto", watched=frames, sampling="off"), Counting()
    frames.read.clear()
    trainer.add_hook(hook)
    count = trainer.count
    train(trainer, until=20)
    assert (hook.steps, hook.milestones, trainer.count) == (20, 1, count)
    assert 8 not in frames.read[1:]  # from the second step on
    path = tmp_path / "c"
    save_checkpoint(path, trainer)
    other = make_trainer(40, capacity="auto", sampling="off")
    other.add_hook(again := Counting())
    load_checkpoint(path, other)
    assert again.steps == 20
