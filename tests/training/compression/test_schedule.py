"""The milestones of ``capacity="auto"``: what passes take, what decides, and that a training goes on afterwards."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from support.training_steps import Make, MakeJob, bits, compression, state_of_dynamic, train

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.training.compression import context as context_module
from frog_blender.engine.training.compression import passes
from frog_blender.engine.training.compression.context import Compression, Proposal
from frog_blender.engine.training.compression.sensitivity import Motion, Sensitivity, peak_weights
from frog_blender.engine.training.compression.settings import DEFAULT
from frog_blender.engine.training.optimize.gaussian_state import freeze_motion
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.checkpoint import restore, state_of
from frog_blender.engine.training.session.recovery import Recovery
from frog_blender.engine.training.session.run import run_training


def test_milestones_make_the_scene_smaller_and_training_goes_on(make_trainer: Make) -> None:
    fixed, auto = train(make_trainer(400)), train(make_trainer(400, capacity="auto"))
    log = compression(auto).log
    whats = [step.what for step in log]
    assert "pruned" in whats and "frozen" in whats
    assert auto.count < fixed.count and 0 < auto.model.canonical.num_dynamic < 0.6 * auto.count
    assert fixed.model.canonical.num_dynamic == fixed.count
    assert auto.evaluate(6)[0] > fixed.evaluate(6)[0] - 1.0
    assert all((step.loss or 0.0) <= max(DEFAULT.max_freeze_loss, DEFAULT.max_prune_loss) for step in log)


@pytest.mark.parametrize(("some_static", "share", "at"), [(False, 0.0, 1.0), (True, 0.0, 0.8), (False, 0.2, 0.8)])
def test_motion_is_learned_to_the_end_unless_some_are_static_already(
    make_trainer: Make, some_static: bool, share: float, at: float
) -> None:
    trainer = train(make_trainer(100, capacity="auto", dynamic_share=share), until=79)
    assert trainer.model.canonical.num_dynamic == trainer.count
    if some_static:
        freeze_motion(trainer.gaussians, torch.arange(20), state_of_dynamic(trainer))
    frozen = [step for step in compression(train(trainer)).log if step.what == "frozen"]
    assert [step.progress for step in frozen] == [at] and frozen[0].after < frozen[0].before


def test_measuring_leaves_no_gradient_behind(make_trainer: Make) -> None:
    """A static model hands out its own parameters."""
    trainer = make_trainer(60, capacity="auto")
    train(trainer, until=17)
    for _ in range(2):
        motion = measured(trainer)
        assert (motion.contribution > 0).any()
        assert all(parameter.grad is None for parameter in trainer.model.parameters())
        trainer.gaussians.reindex(torch.arange(trainer.model.canonical.num_dynamic), 0)


def hold(pass_: Callable[..., Proposal | None], context: Compression, *about: object) -> None:
    """One pass of a milestone."""
    evaluator = context.evaluator()
    context.compress(evaluator, pass_(context, evaluator, *about))


def changed(context: Compression, **settings: float) -> Compression:
    context.settings = replace(context.settings, **settings)
    return context


def measured(trainer: Trainer) -> Sensitivity:
    generator = torch.Generator().manual_seed(0)
    return compression(trainer).measure(compression(trainer).sample_views(generator), generator)


def freeze(context: Compression, motion: Motion, state: dict[str, torch.Tensor]) -> None:
    context.motion, context.mean_state = motion, state
    hold(passes.freeze_motion, context, context.settings.max_freeze_loss)


def test_what_images_miss_is_not_taken(halfway: Make) -> None:
    """However little it seems to add or to move."""
    trainer = halfway()
    context = compression(trainer)
    count, sensitivity = trainer.count, measured(trainer)
    far = {**sensitivity.state, "means": sensitivity.state["means"] + 5.0}
    freeze(context, replace(sensitivity.motion, score=torch.zeros(count)), far)
    assert trainer.model.canonical.num_dynamic > 0.9 * count  # those that nobody sees may go
    reversed_ = replace(sensitivity, contribution=torch.arange(count, 0, -1).float())
    hold(passes.prune, changed(context, max_prune_loss=-100.0), reversed_)
    assert trainer.count == count


def test_what_no_training_image_misses_is_taken_at_the_end_and_a_surface_of_one_camera_stays(
    halfway: Make, capture: Capture
) -> None:
    """Thirty Gaussians lie behind every camera, and one camera alone sees ten."""
    trainer = halfway()
    context, canonical = compression(trainer), trainer.model.canonical
    camera = next(other for other in capture.cameras if other.name not in capture.test_cameras)
    fog, surface = torch.arange(30), torch.arange(30, 40)
    canonical.embeddings.data[:40] = 0
    canonical.means.data[:30] -= 40 * torch.from_numpy(camera.forward).float()
    canonical.means.data[surface] = torch.from_numpy(camera.center + 0.5 * camera.forward).float()
    canonical.log_scales.data[surface], canonical.opacity_logits.data[surface] = math.log(0.01), 3.0
    names = torch.arange(trainer.count).float()
    canonical.sh.data[:, 0, 2] = 1e-3 * names  # tells who is left
    peaks = peak_weights(context.gaussians_at, capture, capture.train_indices)
    assert peaks[fog].max() == 0 and peaks[surface].max() > context.settings.unmissed_weight
    before = context.evaluator().now
    hold(passes.prune_unmissed, context, measured(trainer))
    left = set((1e3 * canonical.sh.detach()[:, 0, 2]).round().long().tolist())
    assert not left & set(fog.tolist()) and left >= set(surface[peaks[surface] > 0.05].tolist())
    assert before - context.evaluator().now <= context.settings.max_unmissed_loss + 1e-6
    (step,) = [logged for logged in context.log if logged.what == "pruned"]
    assert step.after == trainer.count < step.before and step.loss <= context.settings.max_unmissed_loss
    hold(passes.prune_unmissed, changed(context, unmissed_weight=0.0), measured(trainer))
    assert trainer.count == step.after


def test_of_what_no_image_misses_the_largest_goes_first_and_one_that_is_missed_stops_nothing(halfway: Make) -> None:
    trainer = halfway()
    context, canonical = changed(compression(trainer), unmissed_weight=1.1), trainer.model.canonical
    names = torch.arange(trainer.count).float()
    canonical.sh.data[:, 0, 2] = 1e-3 * names  # tells who is left
    canonical.log_scales.data[20], canonical.log_scales.data[30] = 0.0, 0.5
    drawn = context.gaussians_at(0.5)
    hidden = drawn.opacities * drawn.scales.sort(1).values[:, 1:].prod(1)
    missed, largest = hidden.argsort(descending=True)[:2].tolist()
    energy = torch.full((trainer.count,), 1e-9)
    energy[missed] = 1e6
    sensitivity = replace(measured(trainer), energy=energy)
    proposal = passes.prune_unmissed(context, context.evaluator(), sensitivity)
    proposal.apply(1)
    left = (1e3 * canonical.sh.detach()[:, 0, 2]).round().long().tolist()
    assert sorted(set(range(len(names))) - set(left)) == [largest]


def test_what_moves_far_is_not_even_proposed(halfway: Make) -> None:
    trainer = halfway()
    seen = measured(trainer)
    freeze(compression(trainer), replace(seen.motion, score=torch.full((trainer.count,), 50.0)), seen.state)
    assert compression(trainer).log == [] and trainer.model.canonical.num_dynamic == trainer.count


@pytest.mark.parametrize("forced", [False, True])
def test_those_are_frozen_first_that_images_miss_least(
    halfway: Make, monkeypatch: pytest.MonkeyPatch, forced: bool
) -> None:
    trainer = halfway(dynamic_share=0.1 if forced else 0.0)
    state, count = measured(trainer).state, trainer.count
    most = math.ceil(0.9 * count)
    monkeypatch.setattr(context_module, "largest_count_within", lambda loss, expected, allowed: (most, loss(most)))
    energy = torch.randperm(count, generator=torch.Generator().manual_seed(1)).float()
    score = torch.full((count,), 50.0 if forced else 3.0)
    places = trainer.model.canonical.means.detach().clone()
    kept = places[energy.argsort()[-int(0.1 * count) :].sort().values]
    freeze(compression(trainer), Motion(score, energy), state)
    moving = trainer.model.canonical.num_dynamic
    assert moving == int(0.1 * count)
    torch.testing.assert_close(trainer.model.canonical.means.detach()[:moving], kept)


def test_nothing_is_added_after_the_scene_has_settled(make_trainer: Make) -> None:
    trainer = make_trainer(100, capacity="auto", densify_until=1.0, sampling_until=1.0, densify_threshold=0.0)
    train(trainer, until=85)
    count = trainer.count
    assert "pruned" in [step.what for step in compression(trainer).log]
    assert count < trainer.recipe.growth_limit_at(0.85)
    train(trainer, until=99)
    assert trainer.count == count
    train(trainer)
    assert trainer.count <= count


GROWING = {"densify_until": 1.0, "densify_threshold": 0.0}


def test_motion_that_was_measured_outlives_a_resume(make_trainer: Make, halfway: Make) -> None:
    trainer = train(halfway(**GROWING), until=100)
    assert compression(trainer).motion and trainer.model.canonical.num_dynamic == trainer.count
    other = make_trainer(120, capacity="auto", **GROWING)
    restore(other, state_of(trainer))
    record = compression(other)
    assert record.motion
    train(other)
    assert [step.progress for step in record.log if step.what == "frozen"] == [1.0]
    assert len(record.motion.score) == other.model.canonical.num_dynamic < other.count
    assert bits(other) == bits(train(trainer))


def test_memory_that_ends_late_leaves_what_was_measured_of_those_that_stay(make_trainer: Make, halfway: Make) -> None:
    trainer = train(halfway(), until=100)
    record = compression(trainer)
    count, before = trainer.count, record.motion
    Recovery(trainer).rollback(MemoryError())
    after = record.motion
    assert before and after and trainer.count < count and len(after.score) == trainer.model.canonical.num_dynamic
    assert set(after.rest_energy.tolist()) < set(before.rest_energy.tolist())
    other = make_trainer(120, capacity="auto", max_gaussians=trainer.recipe.max_gaussians)
    restore(other, state_of(trainer))
    train(other)
    assert [step.what for step in compression(other).log].count("frozen") == 1


def test_milestones_that_a_resume_would_jump_over_are_run(make_trainer: Make) -> None:
    trainer = make_trainer(200, capacity="auto")
    train(trainer, until=120)
    shorter = make_trainer(130, capacity="auto")
    restore(shorter, state_of(trainer))
    train(shorter)
    assert "frozen" in [step.what for step in compression(shorter).log]


def test_broken_gaussians_do_not_cost_the_scene(make_job: MakeJob) -> None:
    counts: list[int] = []

    class Breaking(Trainer):
        def evaluate(self, limit: int) -> tuple[float, str]:
            if self.finished:
                self.model.canonical.log_scales.data[7, 1] = float("nan")
                self.model.canonical.means.data[-1, 0] = float("inf")
                counts.append(self.count)
            return super().evaluate(limit)

    job = make_job(40, capacity="auto")
    finished = list(run_training(job, trainer_type=Breaking))[-1]
    scene = ScenePlayer.load(job.output)
    assert scene.count == finished.gaussians == counts[0] - 2 and np.isfinite(scene.at(0.5).scales).all()
