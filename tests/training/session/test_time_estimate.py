"""How long a training will take: a model, corrected by what trainings took."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.training.recipe import recipe
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session import time_estimate as module
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training
from frog_blender.engine.training.session.time_estimate import (
    Sensitivity,
    Workload,
    about,
    estimate,
    likely_device,
    pixels_of,
    remember,
    remembered,
    usual_scale,
)

WORK = Workload(recipe("standard"), 10_000, 384 * 288)


@pytest.fixture(autouse=True)
def no_memories(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "memories"))


def test_more_work_takes_longer() -> None:
    assert replace(WORK, steps=20_000).seconds == pytest.approx(2 * WORK.seconds)
    assert replace(WORK, pixels=4 * WORK.pixels).seconds > WORK.seconds
    assert replace(WORK, recipe=recipe("standard", max_gaussians=80_000, seed_gaussians=50_000)).seconds > WORK.seconds
    assert replace(WORK, recipe=recipe("standard", hidden_width=128)).seconds > WORK.seconds
    assert replace(WORK, recipe=recipe("standard", region_share=0.0)).seconds > WORK.seconds
    draft, paper = recipe("draft"), recipe("paper")
    assert Workload(draft, draft.steps, WORK.pixels).seconds < WORK.seconds / 2
    assert Workload(paper, paper.steps, WORK.pixels).seconds > 20 * WORK.seconds


@pytest.mark.parametrize(
    ("name", "steps", "pixels", "seconds"), [("standard", 10_000, 384 * 288, 380), ("draft", 4_000, 384 * 288, 122)]
)
def test_the_model_says_what_was_measured(name: str, steps: int, pixels: int, seconds: float) -> None:
    """On two quiet cores with AVX2: docs/experiments/rasterizer.md, "Measured"."""
    assert Workload(recipe(name), steps, pixels).seconds == pytest.approx(seconds, rel=0.15)


def test_the_share_done_follows_the_cost_of_steps() -> None:
    shares = [WORK.share_done(i / 20) for i in range(21)]
    assert shares[0] == 0 and shares[-1] == pytest.approx(1) and shares == sorted(shares)
    even = recipe("standard", densify_growth=0.0, half_size_until=0.0)
    assert Workload(even, 10_000, 1e5).share_done(0.3) == pytest.approx(0.3, abs=1e-3)
    growing = recipe("standard", half_size_until=0.0)
    assert Workload(growing, 10_000, 1e5).share_done(0.3) < 0.29, "later steps have more Gaussians"
    halved = recipe("standard", densify_growth=0.0, region_share=0.0)
    assert Workload(halved, 10_000, 1e6).share_done(0.4) < 0.3, "early steps draw a quarter of the pixels"


def test_a_workload_of_a_capture(capture: Capture) -> None:
    work = Workload.of(capture, recipe("draft"), scale=0.5)
    assert work == Workload(recipe("draft"), recipe("draft").steps_for(6), 24 * 18)
    assert Workload.of(capture, recipe("draft"), 77).steps == 77
    assert pixels_of(capture.cameras) == 48 * 36 and usual_scale(capture.cameras) == 1.0
    assert usual_scale([camera.resized(3200, 2400) for camera in capture.cameras]) == 0.5


def test_a_first_guess_says_that_it_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module.os, "cpu_count", lambda: 2)
    monkeypatch.setattr(module.native, "instruction_set", lambda: "avx2")
    guess = estimate(WORK)
    assert guess.seconds == pytest.approx(WORK.seconds) and guess.trainings == 0 and str(guess).startswith("Roughly")
    monkeypatch.setattr(module.os, "cpu_count", lambda: 16)
    quicker = estimate(WORK).seconds
    assert quicker is not None and WORK.seconds / 8 < quicker < WORK.seconds / 2
    monkeypatch.setattr(module.native, "instruction_set", lambda: "avx512")
    assert estimate(WORK).seconds == pytest.approx(quicker / 2)
    nothing = estimate(WORK, "cuda")
    assert nothing.seconds is None and "not known" in str(nothing)


def test_estimates_learn_from_every_training() -> None:
    remember(Sensitivity("cpu", "standard", 100.0, 300.0))
    once = estimate(WORK)
    assert once.seconds == pytest.approx(3 * WORK.seconds) and str(once).startswith("About") and once.trainings == 1
    remember(Sensitivity("cpu", "standard", 100.0, 100.0))
    twice = estimate(WORK).seconds
    assert twice is not None and WORK.seconds < twice < math.sqrt(3) * WORK.seconds, "the later one counts more"
    remember(Sensitivity("cpu", "draft", 100.0, 900.0))
    other = estimate(WORK).seconds
    draft = estimate(replace(WORK, recipe=recipe("draft")))
    assert other is not None and draft.seconds is not None
    assert other / WORK.seconds < 3 < draft.seconds / replace(WORK, recipe=recipe("draft")).seconds
    assert estimate(WORK, "cuda").seconds is None, "a processor says nothing of a GPU"
    remember(Sensitivity("cuda", "standard", 100.0, 5.0))
    assert estimate(WORK, "cuda").seconds == pytest.approx(WORK.seconds / 20)
    for _ in range(100):
        remember(Sensitivity("cpu", "standard", 100.0, 200.0))
    assert len(remembered()) == module._KEPT and estimate(WORK).seconds == pytest.approx(2 * WORK.seconds)


@pytest.mark.parametrize("content", ["", "{}", "[1, null]", "\xff", '[{"device": "cpu"}]', "[[]]"])
def test_damaged_memories_are_left_out(content: str) -> None:
    good = Sensitivity("cpu", "draft", 1.0, 2.0)
    remember(good)
    (path,) = Path(module.default_cache_folder()).glob("*.json")
    kept = json.loads(path.read_text())
    path.write_bytes(content.encode("latin-1"))
    assert remembered() == []
    bad = [{**kept[0], "seconds": value} for value in (0, -1, "x", None, float("inf"), float("nan"))]
    path.write_text(json.dumps([*bad, {**kept[0], "model": -1}, *kept]))
    assert remembered() == [good]


def test_a_disk_that_takes_nothing_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "file"))
    remember(Sensitivity("cpu", "draft", 1.0, 2.0))
    assert remembered() == [] and estimate(WORK).trainings == 0


def test_a_finished_training_is_remembered(
    filmed: Path, tmp_path: Path, lively: Callable, seeds_at_no_cost: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "memories"))  # again: the seeds' fixture named that of all tests
    job = TrainingJob(filmed, tmp_path / "x.frog", recipe=lively(20), device="cpu")
    assert isinstance(list(module.remembering(run_training(job), job))[-1], events.Finished)
    assert remembered() == [], "a short trial would spoil every later estimate"
    monkeypatch.setattr(module, "_SHORT", 0.0)
    end = list(module.remembering(run_training(job), job))[-1]
    assert isinstance(end, events.Finished)
    (one,) = remembered()
    assert (one.device, one.recipe, one.seconds) == ("cpu", "draft", end.seconds)
    assert one.modelled == Workload(job.recipe, 20, 48 * 36).seconds
    for other in (replace(job, steps=30, resume=True), replace(job, seconds=0.05), replace(job, method="static")):
        assert isinstance(list(module.remembering(run_training(other), other))[-1], events.Finished)
    assert list(module.remembering(run_training(job, lambda: True), job))[-1] == events.Cancelled(0, None)
    assert remembered() == [one], "of a part, or of something else, nothing is learned"


def test_lengths_of_time_are_no_more_precise_than_they_are() -> None:
    said = [about(seconds) for seconds in (2, 48, 94, 250, 1130, 1500, 5000, 9000, 7200, 360_000)]
    assert said == [
        "10 seconds",
        "50 seconds",
        "90 seconds",
        "4 minutes",
        "19 minutes",
        "25 minutes",
        "85 minutes",
        "2.5 hours",
        "2 hours",
        "100 hours",
    ]


def test_the_device_that_automatic_will_be(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    assert likely_device("cuda") == "cuda" and likely_device("cpu") == "cpu"
    for there in (True, False):
        monkeypatch.setattr(torch.cuda, "is_available", lambda there=there: there)
        assert likely_device("auto") == ("cuda" if there else "cpu")


def test_asking_needs_no_torch() -> None:
    code = "import sys; sys.modules['torch'] = None\n"
    code += "from frog_blender.engine.training import recipe\n"
    code += "from frog_blender.engine.training.session import cancel_token, time_estimate as estimate\n"
    code += "work = estimate.Workload(recipe.recipe('draft'), 3000, 1e5)\n"
    code += "print(estimate.estimate(work, estimate.likely_device('cpu')))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(__file__).parents[3])
    assert "Roughly" in run.stdout, run.stderr
