"""What need not change of those that move is found at the end of a training, and costs what it may."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support.builders import scene_file
from support.training_steps import train

from frog_blender.engine.capture.frames import FrameStore
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.evaluation.evaluate import evaluate
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.compression_report import reduction_line
from frog_blender.engine.scene.scene_file import SceneFile, read_scene
from frog_blender.engine.training.compression import finalize, static_attributes
from frog_blender.engine.training.compression.finalize import played_by
from frog_blender.engine.training.compression.static_attributes import freeze_attributes
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.export import _scene
from frog_blender.engine.training.session.job import TrainingJob, run_training

Make = Callable[..., Trainer]
STEPS = 400  # after which the ball moves
pytestmark = pytest.mark.usefixtures("seeds_at_no_cost")


@pytest.fixture(scope="module")
def finished(make_trainer: Make) -> Trainer:
    return train(make_trainer(STEPS, capacity="auto"))


def scene_of(trainer: Trainer) -> SceneFile:
    job = TrainingJob(trainer.capture.path, Path("x.frog"), recipe=trainer.recipe)
    return _scene(job, trainer, 1.0, {})


def psnr(trainer: Trainer, scene: SceneFile) -> float:
    assert trainer.compression
    return trainer.compression.judge(trainer, played=played_by(ScenePlayer(scene), trainer.device)).now


def allow(monkeypatch: pytest.MonkeyPatch, fading: float, shape: float, live: float = 2.0) -> None:
    monkeypatch.setattr(static_attributes, "ALLOWED_FADING_LOSS", fading)
    monkeypatch.setattr(static_attributes, "ALLOWED_SHAPE_LOSS", shape)
    monkeypatch.setattr(static_attributes, "_FADING_WORTH_IT", 0.0)
    monkeypatch.setattr(static_attributes, "_SHAPE_WORTH_IT", 0.0)
    monkeypatch.setattr(finalize, "_WORTH_IT", live)  # 2: all scenes come and go


@pytest.mark.parametrize(("fading", "shape"), [(0.05, 0.05), (1e9, 0.05), (-1.0, 1e9)])
def test_it_costs_what_is_said_and_no_more_than_allowed(
    finished: Trainer, monkeypatch: pytest.MonkeyPatch, fading: float, shape: float
) -> None:
    allow(monkeypatch, fading, shape)
    assert finished.compression
    before = scene_of(finished)
    found, reductions = freeze_attributes(finished.compression, finished, before)
    playable, whole = ScenePlayer(found), ScenePlayer(before)
    assert (playable.count, playable.num_dynamic) == (whole.count, whole.num_dynamic)
    lost = 0.0
    for reduction in reductions:
        assert reduction.loss is not None
        assert reduction.loss <= {"only fade": fading, "keep their shape": shape}[reduction.what]
        assert 0 <= reduction.after < reduction.before <= whole.num_dynamic
        assert "Gaussians" in reduction_line(vars(reduction))
        lost += reduction.loss
    assert reductions and psnr(finished, before) - psnr(finished, found) == pytest.approx(lost, abs=0.02)
    if fading > 1:
        assert len(found.arrays["embeddings"]) == 0 and len(found.arrays["fades"]) == whole.num_dynamic
        assert playable.changing == ("base",)
    if fading < 0:
        assert found.header.model["reshaped"] == 0 and {"scales", "quaternions"}.isdisjoint(playable.changing)


def test_who_must_change_most_goes_on_changing(finished: Trainer, monkeypatch: pytest.MonkeyPatch) -> None:
    """Energies decide: with others' energies it would cost more."""
    allow(monkeypatch, 0.05, 0.0)
    assert finished.compression and finished.compression.motion
    motion, before = finished.compression.motion, scene_of(finished)
    _, (right, *_) = freeze_attributes(finished.compression, finished, before)
    monkeypatch.setattr(
        finished.compression, "motion", replace(motion, fade_energy=1 / motion.fade_energy.clamp(1e-12))
    )
    _, wrong = freeze_attributes(finished.compression, finished, before)
    faded = [each.before - each.after for each in wrong if each.what == "only fade"]
    assert right.what == "only fade" and right.before - right.after > max([*faded, 0])


@pytest.mark.parametrize("what", ["nothing known", "heads", "long", "never gone", "few", "larger"])
def test_where_it_is_not_worth_it_the_scene_stays(
    finished: Trainer, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    allow(monkeypatch, 0.5, -1.0)
    assert finished.compression
    before = scene_of(finished)
    if what == "nothing known":
        monkeypatch.setattr(finished.compression, "motion", None)
    elif what == "heads":
        before = SceneFile(replace(before.header, model=before.header.model | {"head_width": 8}), before.arrays)
    elif what == "long":
        monkeypatch.setattr(static_attributes, "_LONGEST", 5)
    elif what == "never gone":
        monkeypatch.setattr(finalize, "_WORTH_IT", -1.0)
    elif what == "few":
        monkeypatch.setattr(static_attributes, "_FADING_WORTH_IT", 1.1)
    else:
        monkeypatch.setattr(static_attributes, "pack", lambda name, array: Bytes(len(array) + 2 * (name == "fades")))
    assert freeze_attributes(finished.compression, finished, before) == (before, [])


class Bytes:
    """As Packed, of a size."""

    def __init__(self, size: int) -> None:
        self.content = np.empty(size)


class Passing:
    """Seven frames of two Gaussians: one is there in the second frame only, one all the time, and both go on."""

    moving, header = 2, scene_file().header

    def at_frame(self, frame: int) -> GaussianArrays:
        gaussians = ScenePlayer(scene_file(2)).at(0.0)
        opacities = np.array([0.9 * (frame == 1), 0.5], np.float32)
        return replace(gaussians, means=gaussians.means * 0 + frame, opacities=opacities)


def test_the_state_is_that_at_which_they_are_seen() -> None:
    state = static_attributes._seen_state(Passing())
    np.testing.assert_allclose(state["means"], [[1.0] * 3, [3.0] * 3], atol=1e-5)
    np.testing.assert_allclose(state["scales"], ScenePlayer(scene_file(2)).at(0.0).scales, rtol=1e-5)


def test_a_training_writes_them_and_says_so(filmed: Path, tmp_path: Path, lively: Callable) -> None:
    with pytest.MonkeyPatch.context() as patch:
        allow(patch, 0.05, 0.05)
        task = TrainingJob(filmed, tmp_path / "x.frog", recipe=lively(STEPS, capacity="auto"))
        done = list(run_training(task))[-1]
        scene = read_scene(task.output)
        assert "fades" in scene.arrays and "reshaped" in scene.header.model
        whats = [each["what"] for each in done.capacity["reductions"]]
        assert whats[-4:-1] == ["only fade", "keep their shape", "packed"] and whats[-1] == "unseen left out"
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
    with pytest.MonkeyPatch.context() as patch:
        allow(patch, 0.05, 0.05)
        assert finished.compression and other.compression
        mine, again = (freeze_attributes(each.compression, each, scene_of(each))[0] for each in (finished, other))
    assert mine.header.model == again.header.model
    for name, array in mine.arrays.items():
        assert np.array_equal(array, again.arrays[name]), name
    assert isinstance(other.compression.motion.fade_energy, torch.Tensor)
