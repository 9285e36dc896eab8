"""A training from folder to file: its events, its files, cancelling and going on."""

import gc
import itertools
import os
import weakref
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import synthetic_capture as film
from support.builders import refused
from support.training_steps import MakeJob, cancelled_at, stepping, warnings_of

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.evaluation.evaluate import TrueImages, evaluate_images
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene import header as scene_header
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.optimize.initialization import scale_of
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.output_paths import checkpoint_path
from frog_blender.engine.training.session.run import run_training

STEPS = 30


@pytest.fixture
def task(make_job: MakeJob) -> TrainingJob:
    """With an event for every step."""
    return make_job(STEPS, {"event_seconds": 0.0})


def names(stream: list[Any]) -> list[str]:
    """Kinds of events, repetitions told once."""
    kinds = [type(event).__name__ for event in stream]
    return [kind for i, kind in enumerate(kinds) if i == 0 or kind != kinds[i - 1]]


def test_old_objects_are_left_alone_while_it_trains_and_when_nobody_listens_any_more(task: TrainingJob) -> None:
    stream = run_training(task)
    while not isinstance(next(stream), events.Progress):
        pass
    assert gc.get_freeze_count() > 0
    stream.close()
    assert gc.get_freeze_count() == 0


def test_what_a_training_held_is_free_when_it_ends(task: TrainingJob) -> None:
    """Without a collector's help, which is rare in a Blender: the frames' lock would keep a full disk full."""
    trained: list[weakref.ref[Trainer]] = []
    watched = stepping(lambda trainer: trained.append(weakref.ref(trainer)))
    gc.collect()
    gc.disable()
    try:
        list(run_training(task, trainer_type=watched))
        assert len(trained) == STEPS and trained[0]() is None
    finally:
        gc.enable()


def test_a_capture_that_no_scene_could_tell_of_is_refused_before_the_first_step(
    task: TrainingJob, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is read has limits; a training that does not know them would lose its scene at the end."""
    monkeypatch.setattr(scene_header, "MAX_FRAMES", film.FRAMES - 1)
    seen = []
    refused(f"no scene of it could be opened: found .* {film.FRAMES - 1}", seen.extend, run_training(task))
    assert events.Progress not in map(type, seen) and not task.output.exists()


def test_events_come_in_order_and_are_plain(task: TrainingJob) -> None:
    stream = list(run_training(task))
    kinds = [kind for kind in names(stream) if kind != "Stage"]
    assert kinds[0] == "Started" and kinds[-3:] == ["Evaluated", "Saved", "Finished"]
    assert set(kinds[1:-3]) == {"Progress", "Statistics", "Evaluated", "Preview"}
    for event in stream:
        assert is_dataclass(event) and isinstance(event, events.Event)
        for field in fields(event):
            assert type(getattr(event, field.name)) in (int, float, str, type(None), np.ndarray, dict)
    steps = [event.step for event in stream if isinstance(event, events.Progress)]
    assert steps == list(range(1, STEPS + 1))
    progress = [event for event in stream if isinstance(event, events.Progress)]
    assert all(event.steps == STEPS and event.seconds_left > 0 for event in progress)
    started, finished = next(e for e in stream if isinstance(e, events.Started)), stream[-1]
    assert started == events.Started("frog", STEPS, 4, 6, 300, "cpu", film.WIDTH * film.HEIGHT, 24)
    assert (finished.path, finished.steps) == (str(task.output), STEPS)
    assert list(finished.phases) == ["decoding", "seeding", "training", "finishing"]
    assert finished.phases["training"] >= finished.seconds > 0
    preview = next(event for event in stream if isinstance(event, events.Preview))
    assert preview.image.shape == (film.HEIGHT, film.WIDTH, 3) and preview.image.dtype == np.uint8
    assert len([event for event in stream if isinstance(event, events.Evaluated)]) == 10


def test_the_file_plays_the_image_that_training_saw_and_says_what_was_done(task: TrainingJob, filmed: Path) -> None:
    """The job's trainer and the written file draw the same images."""
    seen: list[Trainer] = []
    finished = list(run_training(task, trainer_type=stepping(seen.append)))[-1]
    scene, trainer = ScenePlayer.load(task.output), seen[-1]
    header = scene.header
    assert (header.method, header.steps, header.frame_count, header.scale) == ("frog", STEPS, 6, 1.0)
    assert header.test_cameras == ("cam00",) and header.test_frames == ()
    assert header.camera_shots == (tuple(range(6)),) * 4 and not header.is_moving
    assert header.capture_path == str(filmed.resolve()) and header.capture_format == "n3dv"
    assert header.recipe["hidden_width"] == 64
    assert header.metrics == {"split": "held-out", "psnr": pytest.approx(finished.psnr)}
    assert scene.count == finished.gaussians
    np.testing.assert_allclose(header.cameras[0].center, film.rig()[0].center, atol=1e-9)  # held out, so not refined
    for index in (0, 9, 23):
        shot = trainer.capture.shots[index]
        drawn = draw(scene.at_frame(shot.frame), scene.header.cameras[shot.camera], scene.header.background).rgb
        assert np.abs(drawn - trainer.render_image(index)).mean() < 1e-5


@pytest.mark.parametrize(
    "options", [{"holdout_frames": 3}, {"scale": 0.5}, {"method": "static"}, {"seconds": 0.001}], ids=str
)
def test_options_reach_the_file(task: TrainingJob, options: dict[str, Any]) -> None:
    finished = list(run_training(replace(task, **options)))[-1]
    header = read_scene(task.output).header
    assert header.test_frames == ((1, 4) if "holdout_frames" in options else ())
    assert header.cameras[0].width == (24 if "scale" in options else 48)
    assert header.method == options.get("method", "frog") and bool(header.model) == (header.method == "frog")
    assert isinstance(finished, events.Finished)
    assert (finished.steps == STEPS) == ("seconds" not in options)


def test_cancelling_keeps_a_scene_that_plays_and_resuming_ends_with_the_same_bits(
    task: TrainingJob, tmp_path: Path
) -> None:
    undisturbed = replace(task, output=tmp_path / "undisturbed.frog")
    list(run_training(undisturbed))
    stream = cancelled_at(task, 13)
    assert stream[-1] == events.Cancelled(13, str(task.output))
    assert names(stream)[-4:] == ["Evaluated", "Stage", "Saved", "Cancelled"]
    assert ScenePlayer.load(task.output).header.steps == 13
    assert checkpoint_path(task.output).is_file()
    resumed = list(run_training(replace(task, resume=True)))
    assert next(event for event in resumed if isinstance(event, events.Progress)).step == 14
    assert isinstance(resumed[-1], events.Finished) and resumed[-1].steps == STEPS
    arrays, expected = read_scene(task.output).arrays, read_scene(undisturbed.output).arrays
    assert arrays.keys() == expected.keys()
    for name, array in expected.items():
        assert arrays[name].tobytes() == array.tobytes(), name
    assert sorted(path.name for path in tmp_path.iterdir()) == [
        *("undisturbed.frog", "undisturbed.frog.checkpoint", "x.frog", "x.frog.checkpoint")
    ]


def test_cancelling_before_the_first_step_writes_nothing(task: TrainingJob) -> None:
    stream = list(run_training(task, lambda: True))
    assert stream == [events.Cancelled(0, None)]
    assert not list(task.output.parent.iterdir())


def test_cancelling_while_frames_are_decoded(
    task: TrainingJob, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    cancelled = iter([False] * 5 + [True] * 99)
    assert list(run_training(task, cancelled.__next__))[-1] == events.Cancelled(0, None)
    assert not task.output.exists()
    assert not os.listdir(tmp_path / "cache")


def test_decoding_and_seeding_report(task: TrainingJob, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    small = replace(task, seeds=None, recipe=replace(task.recipe, seed_gaussians=200, steps=3, densify_until=0.0))
    stream = list(run_training(small))
    stages = [event for event in stream if isinstance(event, events.Stage)]
    named = list(dict.fromkeys(stage.name for stage in stages))
    assert named == ["Decoding frames", "Finding seed points", "Measuring the quality", "Saving"]
    assert all(0 <= stage.done <= stage.total for stage in stages)
    assert isinstance(stream[-1], events.Finished) and 20 < stream[-1].gaussians <= 250


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"method": "nerf"}, "nerf"),
        ({"capture": Path("nowhere/at/all")}, "nowhere"),
        ({"resume": True}, "no file"),
        ({"scale": -1.0}, "scale"),
        ({"holdout_frames": 1}, "holdout_frames is 1"),
        ({"pixel_offsets": {"cam77": (1.0, 0.0)}}, "cam77"),
    ],
    ids=str,
)
def test_what_the_user_can_mend_is_one_sentence(task: TrainingJob, changes: dict[str, Any], word: str) -> None:
    refused(word, lambda: list(run_training(replace(task, **changes))))
    assert not task.output.exists()


@pytest.mark.parametrize(("scene_scale", "told"), [(0.03, ["The scene is 0.03 units away"]), (0.32, [])])
def test_a_scene_before_the_near_plane_is_named(
    task: TrainingJob, capture: Capture, scene_scale: float, told: list[str]
) -> None:
    """The filmed one, by poses in other units."""
    seeds = film.seeds()
    factor = scene_scale / scale_of(capture, seeds.points)
    cameras = []
    for camera in capture.cameras:
        poses = camera.world_to_camera.copy()
        poses[:3, 3] *= factor
        cameras.append(replace(camera, world_to_camera=poses))
    seeds = replace(seeds, points=np.float32(factor) * seeds.points)
    task = replace(task, opened=capture.with_cameras(cameras), seeds=seeds)
    stream = itertools.takewhile(lambda event: not isinstance(event, events.Started), run_training(task))
    assert [message[:28] for message in warnings_of(stream)] == told


def test_an_output_that_cannot_be_written_is_said_before_training(task: TrainingJob, tmp_path: Path) -> None:
    refused("folder", next, run_training(replace(task, output=tmp_path)))
    (tmp_path / "file").write_text("")
    refused("folder could not be made", next, run_training(replace(task, output=tmp_path / "file" / "x.frog")))


@pytest.mark.parametrize("method", ["ed3dgs"])  # whose recipe adapted twice would be another
def test_a_resume_keeps_method_and_recipe_whatever_is_asked(task: TrainingJob, lively: Callable, method: str) -> None:
    changes = {"method": method, "seed": 5, "holdout_frames": 3, "steps": STEPS + 6}
    began = replace(task, **changes, recipe=lively(STEPS, capacity="auto", sh_growth=(0.2, 0.4)))
    cancelled_at(began, STEPS // 2)
    stream = list(run_training(TrainingJob(task.capture, task.output, resume=True, seeds=task.seeds, device="cpu")))
    (said,) = warnings_of(stream)
    assert said == f"Resuming with the original settings: method {method}, recipe draft, capacity auto."
    kept = read_scene(task.output)
    assert kept.header.steps == STEPS + 6 and kept.header.method == method and kept.header.test_frames == (1, 4)
    whole = replace(began, output=task.output.with_name("whole.frog"))
    list(run_training(whole))
    assert kept.arrays["means"].tobytes() == read_scene(whole.output).arrays["means"].tobytes()
    assert not warnings_of(run_training(replace(began, resume=True))), "nothing else was asked for"


def test_a_scene_stopped_early_plays_as_it_was_trained(task: TrainingJob, capture: Capture, store: FrameStore) -> None:
    began = replace(task, recipe=replace(task.recipe, opacity_ramp=(0.0, 1.0), fine_rows_until=1.0))
    cancelled_at(began, STEPS // 2)
    scene = ScenePlayer.load(task.output)
    assert 0 < scene.header.model["opacity_share"] < 1
    played = evaluate_images(scene, TrueImages(capture, store), split="held-out")["psnr"]
    assert played == pytest.approx(scene.header.metrics["psnr"], abs=1e-3)
