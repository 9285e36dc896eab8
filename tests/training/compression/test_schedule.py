"""The rounds of ``capacity="auto"``: what they take away, who judges them, and that a training goes on afterwards."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support import synthetic_capture as film
from support.training_steps import train

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.training.compression import passes, schedule
from frog_blender.engine.training.compression.sensitivity import Motion, Sensitivity, mean_state
from frog_blender.engine.training.optimize.gaussian_order import arrange, freeze_motion, gaussians_at
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.checkpoint import load_checkpoint, save_checkpoint
from frog_blender.engine.training.session.job import TrainingJob, run_training
from frog_blender.engine.training.session.recovery import Recovery

pytestmark = pytest.mark.usefixtures("seeds_at_no_cost")
Make = Callable[..., Trainer]


def test_rounds_make_the_scene_smaller_and_training_goes_on(make_trainer: Make) -> None:
    fixed, auto = train(make_trainer(400)), train(make_trainer(400, capacity="auto"))
    assert auto.compression
    whats = [reduction.what for reduction in auto.compression.reductions]
    assert "pruned" in whats and "put to rest" in whats
    assert auto.count < fixed.count and 0 < auto.model.canonical.num_dynamic < auto.count / 2
    assert fixed.model.canonical.num_dynamic == fixed.count
    assert auto.evaluate(6)[0] > fixed.evaluate(6)[0] - 1.0
    worst = max(passes.ALLOWED_LOSS, passes.ALLOWED_PRUNING_LOSS)
    assert all((reduction.loss or 0.0) <= worst for reduction in auto.compression.reductions)


@pytest.mark.parametrize(("some_rest", "share", "at"), [(False, 0.0, 1.0), (True, 0.0, 0.8), (False, 0.2, 0.8)])
def test_motion_is_learned_to_the_end_unless_some_rest_already(
    make_trainer: Make, monkeypatch: pytest.MonkeyPatch, some_rest: bool, share: float, at: float
) -> None:
    def freeze_static_regions(
        rounds: schedule.CompressionSchedule, trainer: Trainer, generator: torch.Generator
    ) -> None:
        if some_rest:
            state = mean_state(lambda moment: gaussians_at(trainer, moment), rounds.sample_views(generator))
            freeze_motion(trainer, torch.arange(5), state)

    monkeypatch.setattr(schedule, "freeze_static_regions", freeze_static_regions)
    trainer = make_trainer(100, capacity="auto", dynamic_share=share)
    train(trainer, until=79)
    assert (trainer.model.canonical.num_dynamic < trainer.count) == some_rest  # copies of those at rest are at rest
    train(trainer)
    assert trainer.compression
    rests = [each for each in trainer.compression.reductions if each.what == "put to rest"]
    assert [each.progress for each in rests] == [at] and rests[0].after < rests[0].before
    assert all(each.progress == 1.0 for each in trainer.compression.reductions if each.what.startswith(("head", "net")))


class Exact:
    """A store of images as they were drawn, without a film's losses."""

    def __init__(self, capture: Capture) -> None:
        self._capture = capture

    def image(self, index: int) -> np.ndarray:
        shot = self._capture.shots[index]
        return film.image(self._capture.cameras[shot.camera], shot.frame)


def test_what_lies_where_images_hardly_change_rests_early(
    make_trainer: Make, capture: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    for bound in ("_WORTH_IT", "_MOSTLY_STILL"):  # of a wall of broad Gaussians few are clear of the ball
        monkeypatch.setattr(passes, bound, 0.0)
    trainer = make_trainer(100, watched=Exact(capture), capacity="auto")
    train(trainer, until=10)
    assert trainer.compression
    (found,) = trainer.compression.reductions
    moving = trainer.model.canonical.num_dynamic
    assert found.what == "put to rest" and found.before == trainer.count and found.after == moving
    assert 3 < trainer.count - moving < trainer.count / 10
    height = trainer.model.canonical.means[:, 1].detach().abs()  # the ball's path is at most 0.4 from the middle
    assert float(height[moving:].min()) > 0.45
    crossed = height < 0.45
    assert int(crossed.sum()) > 50 and int(crossed[:moving].sum()) == int(crossed.sum())


@pytest.mark.parametrize(
    ("what", "value"),
    [
        ("ALLOWED_LOSS", -100.0),
        ("_UNCHANGED", -1.0),
        ("_LEAST_CHANGE", 0.0),
        ("_WORTH_IT", 0.1),
        ("_MOSTLY_STILL", 1.1),
    ],
)
def test_what_the_images_would_miss_does_not_rest_early_and_neither_do_few(
    make_trainer: Make, capture: Capture, monkeypatch: pytest.MonkeyPatch, what: str, value: float
) -> None:
    for bound in ("_WORTH_IT", "_MOSTLY_STILL"):
        monkeypatch.setattr(passes, bound, 0.0)
    monkeypatch.setattr(passes, what, value)
    trainer = make_trainer(100, watched=Exact(capture), capacity="auto")
    train(trainer, until=20)
    assert trainer.compression and trainer.compression.reductions == []
    assert trainer.model.canonical.num_dynamic == trainer.count


def test_many_rest_early_as_they_are(make_trainer: Make, capture: Capture, monkeypatch: pytest.MonkeyPatch) -> None:
    for what, value in (("ALLOWED_LOSS", 100.0), ("_UNCHANGED", 1e9), ("_LEAST_CHANGE", 0.2)):  # of the display range
        monkeypatch.setattr(passes, what, value)
    trainer = make_trainer(100, watched=Exact(capture), capacity="auto")
    train(trainer, until=10)
    assert trainer.compression
    (found,) = trainer.compression.reductions
    assert found.what == "put to rest" and found.after < 0.75 * found.before


def test_a_scene_that_was_frozen_too_early_wakes(make_trainer: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(schedule, "is_static_capture", lambda *_: True)
    trainer = train(make_trainer(300, capacity="auto"))
    assert trainer.compression
    first, *_ = [each for each in trainer.compression.reductions if each.what == "woken"]
    assert first.before == 0 and 0 < first.after < trainer.count


def test_looking_leaves_no_gradient_behind(make_trainer: Make) -> None:
    """A model at rest hands out its own parameters."""
    trainer = make_trainer(60, capacity="auto")
    train(trainer, until=17)
    assert trainer.compression
    for _ in range(2):
        motion = measured(trainer)
        assert (motion.contribution > 0).any()
        passes.unfreeze_high_error(trainer.compression, trainer, torch.Generator().manual_seed(0))
        assert all(parameter.grad is None for parameter in trainer.model.parameters())
        everyone = torch.arange(trainer.model.canonical.num_dynamic)
        arrange(trainer, everyone, everyone[:0])


def test_a_silenced_head_stays_silent(make_trainer: Make) -> None:
    trainer = make_trainer(60)
    train(trainer, until=30)
    model = trainer.model
    assert model.heads == ["means", "log_scales", "quaternions", "opacity_logits", "sh"]
    rows = model.output_rows("log_scales")
    assert rows == slice(3, 6) and model.deformation.output_weight[rows].abs().sum() > 0
    model.prune_head("log_scales")
    trainer.optimizer.stop(model.deformation.output_weight, rows)
    trainer.optimizer.stop(model.deformation.output_bias, rows)
    train(trainer)
    assert model.heads == ["means", "quaternions", "opacity_logits", "sh"]
    assert not model.deformation.output_weight[rows].any() and not model.deformation.output_bias[rows].any()
    assert model.deformation.output_weight[:3].abs().sum() > 0
    assert model.stored_settings(trainer.schedule_state(1.0))["silent_heads"] == ("log_scales",)


def hold(reduction: Callable[..., object], trainer: Trainer, *about: object) -> None:
    """One reduction of a round."""
    assert trainer.compression
    reduction(trainer.compression, trainer, trainer.compression.judge(trainer), *about)


def test_colours_are_cut_where_nobody_misses_them(make_trainer: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = make_trainer(40, sh_degree=2, capacity="auto")
    train(trainer, until=15)
    assert trainer.compression
    trainer.model.canonical.sh.data[:, 4:] = 0
    hold(passes.reduce_sh_degree, trainer)
    assert trainer.model.canonical.sh.shape[1] == 4
    monkeypatch.setattr(passes, "ALLOWED_COLOR_LOSS", -100.0)
    hold(passes.reduce_sh_degree, trainer)
    assert trainer.model.canonical.sh.shape[1] == 4
    assert [each.what for each in trainer.compression.reductions].count("SH degree") == 1
    train(trainer)


def test_degrees_that_nobody_misses_go_one_after_the_other(make_trainer: Make) -> None:
    trainer = make_trainer(40, sh_degree=3, capacity="auto", sh_growth=(0.0, 0.0, 0.0))
    train(trainer, until=15)
    assert trainer.compression and trainer.model.canonical.sh.shape[1] == 16
    trainer.model.canonical.sh.data[:, 4:] = 0
    hold(passes.reduce_sh_degree, trainer)
    cuts = [each for each in trainer.compression.reductions if each.what == "SH degree"]
    assert [(each.before, each.after) for each in cuts] == [(3, 2), (2, 1)]
    assert [each.loss for each in cuts] == pytest.approx([0.0, 0.0], abs=1e-5)


def measured(trainer: Trainer) -> Sensitivity:
    assert trainer.compression
    generator = torch.Generator().manual_seed(0)
    return trainer.compression.measure(trainer, trainer.compression.sample_views(generator), generator)


def test_what_images_miss_is_not_taken(halfway: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    """However little it seems to add or to move."""
    trainer = halfway()
    assert trainer.compression
    count, found = trainer.count, measured(trainer)
    far = {**found.state, "means": found.state["means"] + 5.0}
    hold(passes.rest, trainer, replace(found.motion, score=torch.zeros(count)), far)
    assert trainer.model.canonical.num_dynamic > 0.9 * count  # those that nobody sees may go
    monkeypatch.setattr(passes, "ALLOWED_PRUNING_LOSS", -100.0)
    hold(passes.prune, trainer, replace(found, contribution=torch.arange(count, 0, -1).float()))
    assert trainer.count == count


def test_what_moves_far_is_not_even_proposed(halfway: Make) -> None:
    trainer = halfway()
    assert trainer.compression
    found = measured(trainer)
    hold(passes.rest, trainer, replace(found.motion, score=torch.full((trainer.count,), 50.0)), found.state)
    assert trainer.compression.reductions == [] and trainer.model.canonical.num_dynamic == trainer.count


@pytest.mark.parametrize("forced", [False, True])
def test_those_rest_first_that_images_miss_least(halfway: Make, monkeypatch: pytest.MonkeyPatch, forced: bool) -> None:
    trainer = halfway(dynamic_share=0.1 if forced else 0.0)
    assert trainer.compression
    state, count = measured(trainer).state, trainer.count
    most = math.ceil(0.9 * count)
    monkeypatch.setattr(passes, "largest_count_within", lambda loss, expected, allowed: (most, loss(most)))
    energy = torch.randperm(count, generator=torch.Generator().manual_seed(1)).float()
    score = torch.full((count,), 50.0 if forced else 3.0)
    places = trainer.model.canonical.means.detach().clone()
    kept = places[energy.argsort()[-int(0.1 * count) :].sort().values]
    hold(passes.rest, trainer, Motion(score, energy, energy, energy), state)
    moving = trainer.model.canonical.num_dynamic
    assert moving == int(0.1 * count)
    torch.testing.assert_close(trainer.model.canonical.means.detach()[:moving], kept)


def test_a_share_of_those_that_move_may_be_forced(halfway: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    trainer = halfway(dynamic_share=0.1)
    assert trainer.compression
    found = measured(trainer)
    hold(passes.rest, trainer, replace(found.motion, score=found.motion.score + 50.0), found.state)
    assert trainer.model.canonical.num_dynamic == int(0.1 * trainer.count)
    monkeypatch.setattr(passes, "_WAKES_ABOVE", 0.0)
    passes.unfreeze_high_error(trainer.compression, trainer, torch.Generator().manual_seed(0))
    assert trainer.model.canonical.num_dynamic == int(0.1 * trainer.count)


def test_heads_that_nobody_misses_are_silenced(
    make_trainer: Make, halfway: Make, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    trainer = halfway()
    assert trainer.compression
    trainer.model.prune_head("sh")  # as if nothing had been learned there
    trainer.model._pruned_heads.clear()
    hold(passes.silence_heads, trainer)
    assert "sh" not in trainer.model.heads and "means" in trainer.model.heads
    assert [each.what for each in trainer.compression.reductions][-1].startswith("head ")
    save_checkpoint(tmp_path / "c", trainer)
    other = make_trainer(120, capacity="auto")
    load_checkpoint(tmp_path / "c", other)
    assert other.model.heads == trainer.model.heads and other.compression
    assert other.compression.reductions == trainer.compression.reductions


def test_nothing_is_added_after_the_scene_has_settled(make_trainer: Make) -> None:
    trainer = make_trainer(100, capacity="auto", densify_until=1.0, sampling_until=1.0, densify_threshold=0.0)
    train(trainer, until=85)
    count = trainer.count
    assert trainer.compression and "pruned" in [each.what for each in trainer.compression.reductions]
    assert count < trainer.recipe.growth_limit_at(0.85)
    train(trainer)
    assert trainer.count == count


@pytest.mark.parametrize("steps", [120, 240])
def test_motion_that_was_measured_outlives_a_resume(
    make_trainer: Make, halfway: Make, bits: Callable, tmp_path: Path, steps: int
) -> None:
    """And is forgotten where the training goes on for more steps, in which Gaussians come and go."""
    growing = {"densify_until": 1.0, "densify_threshold": 0.0}
    trainer = train(halfway(**growing), until=100)
    assert trainer.compression and trainer.compression.motion and trainer.model.canonical.num_dynamic == trainer.count
    save_checkpoint(tmp_path / "c", trainer)
    resumed = make_trainer(steps, capacity="auto", **growing)
    load_checkpoint(tmp_path / "c", resumed)
    assert resumed.compression and resumed.compression.motion
    if steps > 120:
        resumed.step()
        assert resumed.compression.motion is None
    train(resumed)
    rests = [each.progress for each in resumed.compression.reductions if each.what == "put to rest"]
    assert rests == [1.0] and resumed.compression.motion
    assert len(resumed.compression.motion.score) == resumed.model.canonical.num_dynamic < resumed.count
    assert steps > 120 or bits(resumed) == bits(train(trainer))


def test_memory_that_ends_late_leaves_what_was_measured_of_those_that_stay(
    make_trainer: Make, halfway: Make, tmp_path: Path
) -> None:
    trainer = train(halfway(), until=100)
    assert trainer.compression and trainer.compression.motion
    count, before = trainer.count, trainer.compression.motion
    Recovery(trainer).rollback(trainer, MemoryError())
    after = trainer.compression.motion
    assert after and trainer.count < count and len(after.score) == trainer.model.canonical.num_dynamic
    assert set(after.rest_energy.tolist()) < set(before.rest_energy.tolist())
    save_checkpoint(tmp_path / "c", trainer)
    resumed = make_trainer(120, capacity="auto", max_gaussians=trainer.recipe.max_gaussians)
    load_checkpoint(tmp_path / "c", resumed)
    train(resumed)
    assert resumed.compression and [each.what for each in resumed.compression.reductions].count("put to rest") == 1


def test_rounds_that_a_resume_would_jump_over_are_held(make_trainer: Make, tmp_path: Path) -> None:
    trainer = make_trainer(200, capacity="auto")
    train(trainer, until=120)
    save_checkpoint(tmp_path / "c", trainer)
    shorter = make_trainer(130, capacity="auto")
    load_checkpoint(tmp_path / "c", shorter)
    train(shorter)
    assert shorter.compression and "put to rest" in [each.what for each in shorter.compression.reductions]


def test_broken_gaussians_do_not_cost_the_scene(
    filmed: Path, tmp_path: Path, lively: Callable, monkeypatch: pytest.MonkeyPatch
) -> None:
    evaluate, counts = Trainer.evaluate, []

    def breaking(trainer: Trainer, limit: int) -> tuple[float, str]:
        if trainer.finished:
            trainer.model.canonical.log_scales.data[7, 1] = float("nan")
            trainer.model.canonical.means.data[-1, 0] = float("inf")
            counts.append(trainer.count)
        return evaluate(trainer, limit)

    monkeypatch.setattr(Trainer, "evaluate", breaking)
    finished = list(run_training(TrainingJob(filmed, tmp_path / "x.frog", recipe=lively(40, capacity="auto"))))[-1]
    scene = ScenePlayer.load(tmp_path / "x.frog")
    assert scene.count == finished.gaussians == counts[0] - 2 and np.isfinite(scene.at(0.5).scales).all()
