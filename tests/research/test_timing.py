"""Timing: frame times that no player has cached, waiting for the device, and every figure of the tables."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from unittest.mock import patch

import numpy as np
import pytest
from support import synthetic_capture
from support.builders import odd_camera, scene_file

from frog_blender.engine.capture.seeds import Seeds, SeedSettings
from frog_blender.engine.frames import seed_store
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.research import timing
from frog_blender.research.grid import Run, chart_grid
from frog_blender.research.results import read
from frog_blender.research.runs import RunEnvironment, perform


def test_no_time_occurs_twice() -> None:
    times = timing.spread_times(200)
    assert len({round(time, 6) for time in times}) == 200 and all(0 <= time < 1 for time in times)
    counts = [sum(i / 10 <= time < (i + 1) / 10 for time in times) for i in range(10)]
    assert min(counts) >= 18, "spread evenly"


def test_playback_is_timed_at_different_times() -> None:
    scene = ScenePlayer(scene_file())
    with patch.object(scene, "at", wraps=scene.at) as at:
        times = timing.time_playback(scene, odd_camera())
    assert len(at.call_args_list) == len({call.args for call in at.call_args_list}) == timing.NUM_TIMES + timing.WARM_UP
    assert times["gaussians"] == 40 and times["fps"] == pytest.approx(1e3 / times["frame_ms"])
    assert 0 < times["deformation_ms"] < times["frame_ms"] and times["rasterization_ms"] < times["frame_ms"]


class StubTrainer:
    """Takes ten milliseconds a step, and a hundred more where it changes the number of Gaussians."""

    seconds, step_count, count, smoothness = 0.0, 0, 10, SimpleNamespace(graph=None)

    @property
    def finished(self) -> bool:
        return self.step_count == timing.WARM_UP + 20

    def step(self) -> None:
        self.step_count += 1
        changes = self.step_count in (3, 9, 12)
        self.count += changes
        self.seconds += 0.11 if changes else 0.01

    def check(self) -> None:
        pass


def test_a_trainings_length_follows_from_its_steps() -> None:
    session: Any = SimpleNamespace(trainer=StubTrainer())
    times = timing.time_steps(session, 1000)
    assert times == {"steps": 20, "step_ms": pytest.approx(10), "seconds": pytest.approx(10.2)}


def test_the_timing_pass(filmed: Path, tmp_path: Path, quick_seeds: None, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of seeds with times, too; of a method that fails, and of a capture that is not there."""

    def timed_seeds(_capture: object, _store: object, settings: SeedSettings, _progress: object) -> Seeds:
        seeds = synthetic_capture.seeds(min(300, settings.count_limit))
        frames = np.arange(len(seeds.points), dtype=np.float32) % synthetic_capture.FRAMES
        return replace(seeds, frames=frames) if settings.num_moments else seeds

    monkeypatch.setattr(seed_store, "find_seeds", timed_seeds)
    monkeypatch.setattr(timing, "STEPS", 16)
    environment = RunEnvironment(tmp_path)
    common = Run(steps=12, overrides=(("moment_seeds", True),))
    captures = {"tiny": filmed, "gone": tmp_path / "gone"}
    runs = chart_grid(captures, common, seeds=(2, 1), rows=["frog", "ed3dgs", "static"], equal_time=True)
    runs = [run for run in runs if run.scene == "tiny" or run.method == "static"]
    assert [run.method for run in timing.timed_runs(runs)] == ["frog", "ed3dgs", "static", "static"]
    perform(runs[0], environment)
    damaged = environment.scene(runs[1])
    damaged.write_bytes(b"no scene")
    told: list[tuple[int, int]] = []
    records = timing.time_grid(runs, environment, lambda done, total: told.append((done, total)))
    assert [record["kind"] for record in records] == ["timing", "failed", "timing", "failed"], records
    assert [record["key"] for record in read(environment.results)] == [record["key"] for record in records]
    assert told == [(0, 4), (1, 4), (2, 4), (3, 4), (4, 4)]
    frog, static = records[0], records[2]
    assert (frog["scene_played"], static["scene_played"]) == ("finished", "short training")
    for record in (frog, static):
        assert record["training"]["steps"] == 16 - timing.WARM_UP
        assert record["training"]["seconds"] > 0 and record["playback"]["fps"] > 0
        assert record["device"] == "cpu"
