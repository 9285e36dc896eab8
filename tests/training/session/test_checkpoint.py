"""Going on from a checkpoint is as if nothing had happened; what does not fit is refused in a sentence."""

import math
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support import synthetic_capture as film
from support.builders import refused, scene_file
from support.training_steps import Make, MakeJob, bits, compression, train, warnings_of

from frog_blender.engine.io.tensor_files import read_tensors
from frog_blender.engine.scene.scene_file import read_scene, write_scene
from frog_blender.engine.training.compression.sensitivity import Motion
from frog_blender.engine.training.optimize import schedule
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.checkpoint import load_checkpoint, restore_job, state_of, write_checkpoint
from frog_blender.engine.training.session.job import STORED, TrainingJob
from frog_blender.engine.training.session.output_paths import checkpoint_path, header_of, is_of_another
from frog_blender.engine.training.session.run import run_training


@pytest.mark.parametrize(  # before the first round, between rounds, within a burst
    ("method", "stop", "steps"),
    [
        *[("frog", 1, 80), ("frog", 33, 80), ("static", 33, 80), ("auto", 52, 80), ("auto", 75, 80)],
        *[("on rectangles", 2, 60), ("on rectangles", 33, 60)],  # before and after every image was seen whole
        *[("d3dgs", 13, 30), ("hexplane", 13, 30), ("curves", 13, 30)],
    ],
)
def test_resumed_bits_are_those_of_an_undisturbed_training(
    make_trainer: Make, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, method: str, stop: int, steps: int
) -> None:
    changes: dict[str, Any] = {"dssim_period": 25, "dssim_burst": 6}
    if method == "auto":
        method, changes = "frog", {**changes, "capacity": "auto"}
    if method == "on rectangles":
        monkeypatch.setattr(schedule, "_LEAST_SIDE", 16)  # of images of 48 x 36 pixels
        method, changes = "frog", {**changes, "region_share": 0.7, "region_size": 0.4}
    undisturbed = train(make_trainer(steps, method, seed=3, **changes))
    write_checkpoint(tmp_path / "c", state_of(train(make_trainer(steps, method, seed=3, **changes), until=stop)))
    resumed = make_trainer(steps, method, seed=99, **changes)
    load_checkpoint(tmp_path / "c", resumed)
    assert resumed.step_count == stop and resumed.progress == stop / steps
    train(resumed)
    assert bits(resumed) == bits(undisturbed)
    assert resumed.loss == undisturbed.loss


def test_saving_disturbs_nothing(make_trainer: Make, tmp_path: Path) -> None:
    undisturbed, trainer = train(make_trainer(40)), make_trainer(40)
    while not trainer.finished:
        trainer.step()
        if trainer.step_count % 9 == 0:
            write_checkpoint(tmp_path / "c", state_of(trainer))
    assert bits(trainer) == bits(undisturbed)
    assert [entry.name for entry in tmp_path.iterdir()] == ["c"]


def test_more_steps_may_be_asked_for(make_trainer: Make, tmp_path: Path) -> None:
    write_checkpoint(tmp_path / "c", state_of(train(make_trainer(20))))
    longer = make_trainer(40)
    load_checkpoint(tmp_path / "c", longer)
    assert longer.step_count == 20 and longer.progress == 0.5
    assert train(longer).step_count == 40


@pytest.mark.parametrize(
    ("method", "changes", "word"),
    [
        ("static", {}, "method"),
        ("frog", {"hidden_width": 32}, "hidden_width"),
        ("frog", {"sh_degree": 2, "dssim_weight": 0.1}, "sh_degree, dssim_weight"),
    ],
)
def test_another_training_is_refused(make_trainer: Make, tmp_path: Path, method: str, changes: dict, word: str) -> None:
    write_checkpoint(tmp_path / "c", state_of(train(make_trainer(20), until=3)))
    refused(f"{word} differ", load_checkpoint, tmp_path / "c", make_trainer(20, method, **changes))


def test_files_that_are_no_checkpoint(make_trainer: Make, tmp_path: Path) -> None:
    trainer = make_trainer(20)
    write_checkpoint(tmp_path / "c", state_of(train(trainer, until=2)))
    content = (tmp_path / "c").read_bytes()
    write_scene(tmp_path / "scene", scene_file())
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "cut").write_bytes(content[: len(content) // 2])
    (tmp_path / "other").write_bytes(b"\x80\x04\x95" + bytes(100))
    for name in ("scene", "empty", "cut", "other", "missing"):
        refused(str(tmp_path / name), load_checkpoint, tmp_path / name, make_trainer(20))
    assert checkpoint_path(tmp_path / "a.frog") == tmp_path / "a.frog.checkpoint"


def whole(array: np.ndarray) -> np.ndarray:
    return array.astype(np.float64)


def negative(array: np.ndarray) -> np.ndarray:
    return -np.ones_like(array)


def broken(array: np.ndarray) -> np.ndarray:
    return np.full_like(array, np.nan)


def cut(array: np.ndarray) -> np.ndarray:
    return array[:-1].copy()


DAMAGE: list[tuple[str, Callable[[np.ndarray], np.ndarray]]] = [
    *[("adam.means.0.exp_avg", change) for change in (cut, whole)],
    *[("adam.sh.0.step", change) for change in (negative, broken)],
    *[("model.canonical.means", change) for change in (cut, broken, lambda array: array[:0])],
    *[("model.canonical.embeddings", change) for change in (whole, lambda array: array[:, :-1].copy())],
    *[("model.temporal_table", broken), ("density.seen", cut), ("regions.1", negative)],
    *[("poses", change) for change in (cut, broken)],
    *[("poses.moved", broken), ("exposures", negative), ("exposures.sums", broken)],
    *[("motion.score", cut), ("motion.rest_energy", whole)],
    *[("neighbourhood.anchors", change) for change in (cut, negative, lambda array: array + 10_000)],
    *[("neighbourhood.neighbours", negative), ("neighbourhood.weights", cut)],
    *[("random", change) for change in (cut, lambda array: np.zeros_like(array))],
]
VALUES: list[tuple[str, Any]] = [
    *[("rate_factor", value) for value in (-1, 1e9, float("nan"), "x", None)],
    *[("step_count", value) for value in (-1, float("inf"), None)],
    *[("progress", -0.5), ("seconds", float("nan")), ("burst_shot", 10_000), ("loss", float("inf"))],
    *[("version", 12), ("version", None)],
    *[("parsimony", {"seed": 2**62, "reductions": []}), ("parsimony", {"seed": 0, "reductions": [{}]})],
]


@pytest.fixture(scope="module")
def trained(make_trainer: Make) -> Trainer:
    trainer = train(make_trainer(40, capacity="auto"), until=37)
    moving = trainer.model.canonical.num_dynamic
    compression(trainer).motion = Motion(*torch.rand(2, moving))  # as where none is static before the end
    return trainer


@pytest.mark.parametrize(("name", "wrong"), [*DAMAGE, *VALUES])
def test_damaged_arrays_and_values_never_reach_the_training(
    trained: Trainer, make_trainer: Make, tmp_path: Path, name: str, wrong: Any
) -> None:
    """The training that was to go on from them can begin instead."""
    arrays, values = state_of(trained)
    if callable(wrong):
        arrays[name] = np.array(wrong(arrays[name]))
    else:
        values = {**values, name: wrong}
    write_checkpoint(tmp_path / "c", (arrays, values))
    trainer = make_trainer(40, capacity="auto")
    before = bits(trainer)
    refused(str(tmp_path / "c"), load_checkpoint, tmp_path / "c", trainer)
    assert bits(trainer) == before and trainer.step_count == 0 and trainer.optimizer.rate_factor == 1
    trainer.step()


@pytest.fixture
def task(filmed: Path, tmp_path: Path, make_job: MakeJob) -> TrainingJob:
    """Six steps are done, and it goes on to nine."""
    shutil.copytree(filmed, tmp_path / "capture")
    began = make_job(6, {"capture": tmp_path / "capture"})
    list(run_training(began))
    return replace(began, resume=True, steps=9)


def said(task: TrainingJob) -> list[str]:
    """Warnings of a training that finishes."""
    stream = list(run_training(task))
    assert isinstance(stream[-1], events.Finished)
    return warnings_of(stream)


def test_the_same_capture_elsewhere_goes_on(task: TrainingJob, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "link").symlink_to(task.capture)
    assert not said(replace(task, capture=tmp_path / "link"))
    monkeypatch.chdir(tmp_path)
    assert not said(replace(task, capture=Path("capture"), steps=12))
    shutil.copytree(task.capture, tmp_path / "copy")
    assert not said(replace(task, capture=tmp_path / "copy", steps=13))


@pytest.mark.parametrize("left", [False, True])
def test_a_capture_that_moved_goes_on(task: TrainingJob, tmp_path: Path, left: bool) -> None:
    task.capture.rename(tmp_path / "moved")
    if left:  # a folder that is no capture any more
        task.capture.mkdir()
    assert not said(replace(task, capture=tmp_path / "moved"))


def test_a_capture_that_changed_since_is_refused_with_what_changed(task: TrainingJob) -> None:
    assert not said(task)
    film.write_capture(task.capture, range(film.FRAMES)[::-1])
    began = r"x\.frog\.checkpoint: found other images in .*capture than its training began"
    refused(began, list, run_training(replace(task, steps=12)))
    shutil.rmtree(task.capture)
    task.capture.mkdir()
    film.write_capture(task.capture)
    poses = np.load(task.capture / "poses_bounds.npy")
    poses[0, 3] += 0.01
    np.save(task.capture / "poses_bounds.npy", poses)
    other = r"found another calibration or image size in .*capture than"
    refused(other, list, run_training(replace(task, steps=12)))
    assert read_scene(task.output).header.steps == 9


def test_only_settings_that_the_user_chose_are_said_to_be_ignored(task: TrainingJob) -> None:
    other = replace(task, seed=3, holdout_frames=3, scale=0.5, lossless=True)
    assert not said(other)
    told = "Resuming with the original settings: method frog, recipe draft, capacity fixed; ignored: seed, exact."
    assert said(replace(other, chosen={"seed": "seed", "lossless": "exact", "method": "method"}, steps=12)) == [told]


def rewritten(task: TrainingJob, **settings: Any) -> TrainingJob:
    """The task, whose checkpoint says something else of how it began."""
    path = checkpoint_path(task.output)
    values = header_of(path)
    changed = {**values, "settings": values["settings"] | settings}
    write_checkpoint(path, (read_tensors(path, "a training checkpoint")[0], changed))
    return task


def test_what_a_checkpoint_says_of_its_job_is_looked_at(task: TrainingJob) -> None:
    restore_job(task)
    before = header_of(checkpoint_path(task.output))["settings"]
    hostile = [*((name, "x\ny") for name in STORED), ("seed", 2**40), ("scale", math.nan), ("steps", True)]
    hostile += [("method", ["frog"]), ("steps", -5), ("pixel_offsets", {"cam00": 3})]
    for name, value in [*hostile, ("pixel_offsets", {"a": [1, math.nan]})]:
        refused(rf"settings that do not fit \({name} is ", restore_job, rewritten(task, **{name: value}))
        rewritten(task, **{name: before[name]})
    restore_job(task)


def test_a_recipe_that_none_can_be_never_begins(task: TrainingJob) -> None:
    """A negative number of seed points was looked for without an end."""
    recipe = header_of(checkpoint_path(task.output))["settings"]["recipe"]
    wrong = (("seed_gaussians", -1), ("seed_gaussians", 0), ("head_width", 10**9), ("speed", 1), ("fusion", "x"))
    for name, value in (*wrong, ("steps", "x")):
        refused(name, list, run_training(rewritten(task, recipe=recipe | {name: value})))


def test_no_computer_is_called_that_a_checkpoint_names(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    looked_at: list[str] = []
    task.output.unlink()
    for share in (r"\\evil\share\other", "/\\evil/share/other", "//evil/share/other"):
        rewritten(task, capture=share)
        with monkeypatch.context() as watched:
            watched.setattr("os.path.exists", lambda path: looked_at.append(str(path)) or False)
            assert is_of_another(task.output.with_name("none.frog"), task.capture) is False
            assert is_of_another(task.output, Path("/somewhere/other"))
        restore_job(task)
    assert not [path for path in looked_at if "evil" in path]
