"""Gaussians that need no more than their opacity are found at the end of a training, and cost what they may."""

from __future__ import annotations

import copy
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support.builders import scene_file
from support.training_steps import compression, train

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.evaluation.evaluate import evaluate
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.compression_report import reduction_line
from frog_blender.engine.scene.scene_file import SceneFile, read_scene
from frog_blender.engine.training.compression import finalize
from frog_blender.engine.training.compression.context import CompressionContext
from frog_blender.engine.training.compression.finalize import freeze_all_but_opacity, played_by, seen_state, with_tracks
from frog_blender.engine.training.compression.sensitivity import Motion
from frog_blender.engine.training.compression.settings import CompressionSettings
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.export import build_scene
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training
from frog_blender.engine.training.session.session import Session

Make = Callable[..., Trainer]
STEPS = 400  # after which the ball moves
pytestmark = pytest.mark.usefixtures("quick_seeds")


@pytest.fixture(scope="module")
def finished(make_trainer: Make) -> Trainer:
    return train(make_trainer(STEPS, capacity="auto"))


def scene_of(trainer: Trainer) -> SceneFile:
    job = TrainingJob(trainer.capture.path, Path("x.frog"), recipe=trainer.recipe)
    return build_scene(Session(replace(job, lossless=True), trainer), {}).scene


def psnr(trainer: Trainer, scene: SceneFile) -> float:
    return compression(trainer).evaluator(played=played_by(ScenePlayer(scene), trainer.device)).now


def allowing(loss: float, **settings: float) -> CompressionSettings:
    """However few it is for, and in scenes of which nothing comes and goes."""
    return CompressionSettings(max_fade_loss=loss, **{"min_fading": 0.0, "max_visible": 2.0, **settings})


def context_of(trainer: Trainer, settings: CompressionSettings) -> CompressionContext:
    return replace(compression(trainer), settings=settings)


def having_measured(context: CompressionContext, motion: Motion | None) -> CompressionContext:
    """The same with another measurement; what the training remembers stays."""
    record = copy.copy(context.record)
    record.motion = motion
    return replace(context, record=record)


@pytest.mark.parametrize("allowed", [0.05, 1e9])
def test_it_costs_what_is_said_and_no_more_than_allowed(finished: Trainer, allowed: float) -> None:
    before = scene_of(finished)
    found, step = freeze_all_but_opacity(context_of(finished, allowing(allowed)), before)
    playable, whole = ScenePlayer(found), ScenePlayer(before)
    assert (playable.count, playable.num_dynamic) == (whole.count, whole.num_dynamic)
    assert step is not None and step.what == "only fade" and step.loss is not None and step.loss <= allowed
    assert 0 <= step.after < step.before <= whole.num_dynamic and "Gaussians" in reduction_line(vars(step))
    assert psnr(finished, before) - psnr(finished, found) == pytest.approx(step.loss, abs=0.02)
    if allowed > 1:
        assert len(found.arrays["embeddings"]) == 0 and len(found.arrays["fades"]) == whole.num_dynamic
        assert playable.changing == ("base",)


def test_what_must_change_most_goes_on_changing(finished: Trainer) -> None:
    """Energies decide: with others' energies it would cost more."""
    context, before = context_of(finished, allowing(0.05)), scene_of(finished)
    motion = context.record.motion
    assert motion
    _, right = freeze_all_but_opacity(context, before)
    reversed_ = replace(motion, fade_energy=1 / motion.fade_energy.clamp(1e-12))
    _, wrong = freeze_all_but_opacity(having_measured(context, reversed_), before)
    assert right is not None and right.before - right.after > (wrong.before - wrong.after if wrong else 0)


def test_others_stay_in_front_of_those_with_tracks() -> None:
    scene, chosen = scene_file(10, moving=8), np.array([0, 6])
    tracks = np.array([100, 200], np.uint8)[:, None].repeat(scene.header.frame_count, axis=1)
    found = with_tracks(scene, chosen, tracks)
    others = [1, 2, 3, 4, 5, 7]
    np.testing.assert_array_equal(found.arrays["means"], scene.arrays["means"][[*others, 0, 6, 8, 9]])
    np.testing.assert_array_equal(found.arrays["embeddings"], scene.arrays["embeddings"][others])
    before, after = ScenePlayer(scene).at(0.3), ScenePlayer(found).at(0.3)
    np.testing.assert_allclose(after.means[:6], before.means[others], atol=1e-6)
    np.testing.assert_allclose(after.opacities[6:8], [100 / 255, 200 / 255], atol=1e-3)


@pytest.mark.parametrize("what", ["nothing known", "heads", "long", "never gone", "few", "larger"])
def test_where_it_is_not_worth_it_the_scene_stays(
    finished: Trainer, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    settings, before, motion = {}, scene_of(finished), compression(finished).record.motion
    if what == "nothing known":
        motion = None
    elif what == "heads":
        before = SceneFile(replace(before.header, model=before.header.model | {"head_width": 8}), before.arrays)
    elif what == "long":
        settings = {"max_track_frames": 5}
    elif what == "never gone":
        settings = {"max_visible": -1.0}
    elif what == "few":
        settings = {"min_fading": 1.1}
    else:
        monkeypatch.setattr(finalize, "pack", lambda name, array: Bytes(len(array) + 2 * (name == "fades")))
    context = having_measured(context_of(finished, allowing(0.5, **settings)), motion)
    assert freeze_all_but_opacity(context, before) == (before, None)


class Bytes:
    """As Packed, of a size."""

    def __init__(self, size: int) -> None:
        self.content = np.empty(size)


class Passing:
    """Seven frames of two Gaussians: one is there in the second frame only, one all the time, and both go on."""

    num_dynamic, header = 2, scene_file().header

    def at_frame(self, frame: int) -> GaussianArrays:
        gaussians = ScenePlayer(scene_file(2)).at(0.0)
        opacities = np.array([0.9 * (frame == 1), 0.5], np.float32)
        return replace(gaussians, means=gaussians.means * 0 + frame, opacities=opacities)


def test_the_state_is_that_at_which_they_are_seen() -> None:
    state = seen_state(Passing(), 32)
    np.testing.assert_allclose(state["means"], [[1.0] * 3, [3.0] * 3], atol=1e-5)
    np.testing.assert_allclose(state["scales"], ScenePlayer(scene_file(2)).at(0.0).scales, rtol=1e-5)


def test_a_training_writes_them_and_says_so(filmed: Path, tmp_path: Path, lively: Callable) -> None:
    settings, recipe = allowing(0.05), lively(STEPS, capacity="auto")
    task = TrainingJob(filmed, tmp_path / "x.frog", recipe=recipe, compression=settings)
    done = list(run_training(task))[-1]
    scene = read_scene(task.output)
    assert "fades" in scene.arrays
    whats = [each["what"] for each in done.capacity["reductions"]]
    assert whats[-3:] == ["only fade", "packed", "unseen left out"]
    assert done.capacity["dynamic"] == ScenePlayer(scene).num_dynamic == scene.header.capacity["dynamic"]
    packed = next(each for each in done.capacity["reductions"] if each["what"] == "packed")
    assert abs(packed["loss"]) < 0.05  # what others cost is not counted again
    rebuilt = open_capture(filmed).with_cameras(scene.header.cameras)
    found = evaluate(ScenePlayer(scene), rebuilt, FrameStore.open(rebuilt))["psnr"]
    assert done.psnr == scene.header.metrics["psnr"] == pytest.approx(found, abs=0.05)
    plain = replace(task, output=tmp_path / "y.frog", max_bytes=10**6)
    list(run_training(plain))
    assert "fades" not in read_scene(plain.output).arrays


def test_the_same_scene_from_a_checkpoint(finished: Trainer, make_trainer: Make, tmp_path: Path) -> None:
    from frog_blender.engine.training.session.checkpoint import load_checkpoint, save_checkpoint

    save_checkpoint(tmp_path / "c", finished)
    other = make_trainer(STEPS, capacity="auto")
    load_checkpoint(tmp_path / "c", other)
    contexts = [context_of(each, allowing(0.05)) for each in (finished, other)]
    mine, again = (freeze_all_but_opacity(each, scene_of(each.training))[0] for each in contexts)
    assert mine.header.model == again.header.model
    for name, array in mine.arrays.items():
        assert np.array_equal(array, again.arrays[name]), name
    motion = compression(other).record.motion
    assert motion and isinstance(motion.fade_energy, torch.Tensor)
