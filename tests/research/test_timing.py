"""Timing: frame times that no player has cached, waiting for the device, and every figure of the tables."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import synthetic_capture, turning_object
from support.builders import odd_camera, scene_file

from frog_blender.engine.capture.seeds import Seeds
from frog_blender.engine.frames import seed_store
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.frame_delta import FrameDelta
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import SceneFile
from frog_blender.engine.training.session.output_paths import checkpoint_path
from frog_blender.research import timing
from frog_blender.research.grid import CommonSettings, SeedCounts, chart_grid
from frog_blender.research.results import read
from frog_blender.research.runs import RunEnvironment, perform
from frog_blender.research.timing import StepTimes, seconds_each, spread_times, time_playback
from frog_blender.research.timing_pass import time_grid, timed_runs


def test_no_time_occurs_twice() -> None:
    times = spread_times(200)
    assert len({round(time, 6) for time in times}) == 200 and all(0 <= time < 1 for time in times)
    counts = [sum(i / 10 <= time < (i + 1) / 10 for time in times) for i in range(10)]
    assert min(counts) >= 18, "spread evenly"


def test_the_clock_is_read_when_the_device_is_done() -> None:
    now, queued = [0.0], [0.0]

    def work(time: float) -> None:
        queued[0] += time  # returns at once, as a kernel's launch does

    def synchronize() -> None:
        now[0] += queued[0]
        queued[0] = 0.0

    assert seconds_each(work, [1.0, 2.0, 3.0], synchronize, lambda: now[0]) == [1.0, 2.0, 3.0]


class WatchedPlayer(ScenePlayer):
    """Keeps the times that it was asked for."""

    def __init__(self, scene: SceneFile) -> None:
        super().__init__(scene)
        self.asked: list[float] = []

    def at(self, time: float, part: FrameDelta | None = None) -> GaussianArrays:
        self.asked.append(time)
        return super().at(time, part)


def test_playback_is_timed_at_different_times() -> None:
    scene = WatchedPlayer(scene_file())
    found = time_playback(scene, odd_camera(), count=4)
    asked = scene.asked
    assert len(asked) == len(set(asked)) == 4 + timing.WARM_UP
    assert found["gaussians"] == 40 and found["size"] == [45, 27]
    assert 0 < found["deformation_ms"] < found["frame_ms"] and found["rasterization_ms"] < found["frame_ms"]
    assert found["fps"] == pytest.approx(1e3 / found["frame_ms"])


def test_a_trainings_length_follows_from_its_steps() -> None:
    times = StepTimes(plain=[0.01] * 90 + [0.02] * 10, reindexing=[0.111] * 5)
    found = times.summary()
    assert (found["steps"], found["rounds"]) == (105, 5)
    assert found["step_ms"] == pytest.approx(11) and found["step_median_ms"] == pytest.approx(10)
    assert found["round_ms"] == pytest.approx(100)
    assert times.training_seconds(1000) == pytest.approx(11.5)


def test_the_timing_pass(filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    environment = RunEnvironment(tmp_path)
    methods = ["frog", "ed3dgs", "static"]
    runs = chart_grid({"tiny": filmed}, CommonSettings(steps=12), SeedCounts(main=2), methods=methods, equal_time=True)
    assert [run.method for run in timed_runs(runs)] == ["frog", "ed3dgs", "static"]
    perform(runs[0], environment)
    told: list[tuple[int, int]] = []
    records = time_grid(runs, environment, 16, lambda done, total: told.append((done, total)))
    assert [record["kind"] for record in records] == ["timing"] * 3, records
    assert [record["key"] for record in read(environment.results)] == [record["key"] for record in records]
    assert [record["scene_played"] for record in records] == ["finished", "short training", "short training"]
    assert told == [(0, 3), (1, 3), (2, 3), (3, 3)]
    for record in records:
        assert record["training"]["steps"] == 16 - timing.WARM_UP
        assert record["training"]["seconds"] > 0 and record["playback"]["fps"] > 0
        path = record["training_path"]
        assert path["device"] == "cpu" and 0 < path["forward_ms"] < path["forward_backward_ms"]
    assert records[0]["training_path"]["gaussians"] == records[0]["playback"]["gaussians"]


def test_a_scene_whose_seeds_have_times_is_timed(
    filmed: Path, tmp_path: Path, quick_seeds: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    def timed_seeds(*_: object, count_limit: int, num_moments: int, **__: object) -> Seeds:
        found = synthetic_capture.seeds(min(300, count_limit))
        frames = np.arange(len(found.points), dtype=np.float32) % synthetic_capture.FRAMES
        return replace(found, frames=frames) if num_moments else found

    monkeypatch.setattr(seed_store, "find_seeds", timed_seeds)
    environment = RunEnvironment(tmp_path)
    common = CommonSettings(steps=12, overrides={"moment_seeds": True})
    runs = chart_grid({"tiny": filmed}, common, SeedCounts(main=1), methods=["frog", "static"])
    perform(runs[0], environment)
    records = time_grid(runs, environment, 16)
    assert [record["kind"] for record in records] == ["timing"] * 2, records
    assert records[0]["scene_played"] == "finished"


def test_a_scene_with_masks_is_timed(tmp_path: Path, own_cache: Path) -> None:
    """It holds fewer Gaussians than its recipe says, and its checkpoint too."""
    folder, environment = turning_object.write_capture(tmp_path / "object"), RunEnvironment(tmp_path)
    common = CommonSettings(steps=12, overrides={"seed_gaussians": 500, "max_gaussians": 100_000})
    runs = chart_grid({"object": folder}, common, SeedCounts(main=1), methods=["frog"])
    perform(runs[0], environment)
    records = time_grid(runs, environment, 16)
    assert [record.get("scene_played") for record in records] == ["finished"], records


def test_a_method_that_fails_does_not_stop_the_others(filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    runs = chart_grid({"tiny": filmed}, CommonSettings(steps=2), SeedCounts(main=1), methods=["frog", "static"])
    environment = RunEnvironment(tmp_path)
    damaged = environment.scene(runs[0])
    damaged.parent.mkdir()
    damaged.write_bytes(b"no scene")
    checkpoint_path(damaged).write_bytes(b"no checkpoint")
    records = time_grid(runs, environment, 8)
    assert [record["kind"] for record in records] == ["failed", "timing"]


def test_a_capture_that_fails_does_not_stop_the_others(filmed: Path, tmp_path: Path, quick_seeds: None) -> None:
    captures = {"tiny": filmed, "gone": tmp_path / "gone"}
    runs = chart_grid(captures, CommonSettings(steps=2), SeedCounts(main=1), methods=["static"])
    records = time_grid(runs, RunEnvironment(tmp_path), 8)
    assert sorted(record["kind"] for record in records) == ["failed", "timing"]
