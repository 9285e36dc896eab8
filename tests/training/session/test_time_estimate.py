"""How long a training will take: a model of the work, corrected by what trainings took and by what passes."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from support import synthetic_capture as film

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.training.recipe import recipe
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.job import TrainingJob, usual_scale
from frog_blender.engine.training.session.run import run_training
from frog_blender.engine.training.session.time_estimate import (
    PHASES,
    TimeLeft,
    Workload,
    about,
    estimate,
    history,
    likely_device,
    remember,
    remembering,
)

WORK = Workload(recipe("standard"), 10_000, 384 * 288, 500)


@pytest.fixture(autouse=True)
def memories(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The cache folder, without any memory."""
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "memories"))
    return tmp_path / "memories"


def training(work: Workload) -> float:
    return work.seconds["training"]


def slower(work: Workload, factor: float) -> dict[str, float]:
    """Seconds of each phase that takes so many times as long as on the reference computer."""
    return {phase: factor * seconds for phase, seconds in work.seconds.items()}


def test_more_work_takes_longer() -> None:
    assert training(replace(WORK, pixels=4 * WORK.pixels)) > training(WORK)
    for changes in (
        {"max_gaussians": 80_000, "seed_gaussians": 50_000},
        {"hidden_width": 128},
        {"region_share": 0.0},
        {"capacity": "auto"},
    ):
        assert training(replace(WORK, recipe=recipe("standard", **changes))) > training(WORK), changes
    draft, paper = recipe("draft"), recipe("paper")
    assert training(replace(WORK, recipe=draft, steps=draft.steps)) < training(WORK) / 2
    assert training(replace(WORK, recipe=paper, steps=paper.steps)) > 20 * training(WORK)
    more = replace(WORK, images=2 * WORK.images)
    assert more.seconds["decoding"] == 2 * WORK.seconds["decoding"] and training(more) == training(WORK)


@pytest.mark.parametrize(
    ("name", "steps", "pixels", "seconds"), [("standard", 10_000, 384 * 288, 380), ("draft", 4_000, 384 * 288, 122)]
)
def test_the_model_says_what_was_measured(name: str, steps: int, pixels: int, seconds: float) -> None:
    """Steps alone, on two quiet cores with AVX2."""
    assert training(Workload(recipe(name), steps, pixels)) == pytest.approx(seconds, rel=0.15)


def test_the_cost_of_steps_follows_their_schedule() -> None:
    def share(work: Workload, progress: float) -> float:
        return work.training_until(progress) / training(work)

    shares = [share(WORK, i / 20) for i in range(21)]
    assert shares[0] < 0.003 and shares[-1] == 1 and shares == sorted(shares)
    growing = replace(WORK, recipe=recipe("standard", half_size_until=0.0))
    assert share(growing, 0.3) < 0.29, "later steps have more Gaussians"
    halved = replace(WORK, recipe=recipe("standard", densify_growth=0.0, region_share=0.0), pixels=1e6)
    assert share(halved, 0.4) < 0.3, "early steps render a quarter of the pixels"
    assert share(replace(halved, even=True), 0.4) == pytest.approx(0.4), "a limit of time passes evenly"


def test_a_workload_of_a_capture(capture: Capture) -> None:
    work = Workload.of(capture, recipe("draft"), scale=0.5)
    assert work == Workload(recipe("draft"), recipe("draft").steps_for(6), 24 * 18, 24)
    assert Workload.of(capture, recipe("draft"), 77).steps == 77
    assert usual_scale(capture.cameras) == 1.0
    assert usual_scale([camera.resized(3200, 2400) for camera in capture.cameras]) == 0.5


def test_a_first_guess_counts_every_phase_and_says_that_it_is_one(monkeypatch: pytest.MonkeyPatch) -> None:
    guesses = {}
    monkeypatch.setattr("frog_blender.engine.native.binding.instruction_set", lambda: "avx2")
    for cores in (2, 16):
        monkeypatch.setattr("os.cpu_count", lambda cores=cores: cores)
        guesses[cores] = estimate(WORK)
        prepared = estimate(WORK, prepared=True).seconds
        share = (WORK.seconds["training"] + WORK.seconds["finishing"]) / sum(WORK.seconds.values())
        assert prepared == pytest.approx(share * guesses[cores].seconds)
    guess, quicker = guesses[2], guesses[16].seconds
    assert guess.seconds == pytest.approx(sum(WORK.seconds.values()))
    assert guess.trainings == 0 and str(guess).startswith("Roughly")
    assert quicker is not None and guess.seconds is not None and guess.seconds / 8 < quicker < guess.seconds / 2
    monkeypatch.setattr("frog_blender.engine.native.binding.instruction_set", lambda: "avx512")
    assert estimate(WORK).seconds < 0.8 * quicker, "vectors of twice the length"
    nothing = estimate(WORK, "cuda")
    assert nothing.seconds is None and "not known" in str(nothing)


def test_estimates_learn_from_every_training() -> None:
    whole = sum(WORK.seconds.values())
    remember(WORK, "cpu", slower(WORK, 3))
    once = estimate(WORK)
    assert once.seconds == pytest.approx(3 * whole) and str(once).startswith("About") and once.trainings == 1
    remember(WORK, "cpu", slower(WORK, 1))
    assert estimate(WORK).seconds == pytest.approx(2 * whole), "a moving average"
    assert estimate(WORK, "cuda").seconds is None, "a processor says nothing of a GPU"
    remember(WORK, "cuda", slower(WORK, 0.05))
    assert [history("cuda")[1][phase] for phase in ("training", "finishing")] == pytest.approx([0.05, 0.05])
    assert estimate(WORK).seconds == pytest.approx(2 * whole)


def test_what_lay_on_disk_already_teaches_nothing() -> None:
    remember(WORK, "cpu", slower(WORK, 2) | {"decoding": 0.01, "seeding": 0.0})
    factors = history("cpu")[1]
    assert factors["training"] == factors["finishing"] == pytest.approx(2)
    assert factors["decoding"] == factors["seeding"] > 0.1


def test_a_short_trial_teaches_only_what_comes_before_it() -> None:
    short = replace(WORK, steps=1)
    remember(short, "cpu", slower(short, 5))
    trainings, factors = history("cpu")
    assert trainings == 0 and factors["decoding"] == factors["seeding"] == pytest.approx(5)
    assert factors["training"] == factors["finishing"] != 5


def test_what_is_left_follows_what_passes() -> None:
    """Of a computer that is twice as slow as was expected."""
    remember(WORK, "cpu", slower(WORK, 1))
    left = TimeLeft(WORK, "cpu", 0.0, 100.0)
    for step in range(1, 101):
        until = 2 * WORK.training_until(step / 100)
        found = left.at(step / 100, 100.0 + until)
        truth = 2 * (WORK.seconds["training"] + WORK.seconds["finishing"]) - until
        if step >= 30:
            assert found == pytest.approx(truth, rel=0.1)
    assert found == pytest.approx(2 * WORK.seconds["finishing"], rel=0.01)


def test_a_rollback_is_no_time_gained() -> None:
    left = TimeLeft(WORK, "cpu", 0.5, 0.0)
    before = left.at(0.6, 10.0)
    assert left.at(0.5, 11.0) > before


@pytest.mark.parametrize(
    "content", ["", "{}", "[1, null]", "\xff", '{"model": 1, "cpu": {}}', '{"model": 2, "cpu": 3}']
)
def test_damaged_memories_are_left_out(memories: Path, content: str) -> None:
    guess = history("cpu")
    remember(WORK, "cpu", slower(WORK, 4))
    (path,) = memories.glob("*.json")
    kept = json.loads(path.read_text())
    path.write_bytes(content.encode("latin-1"))
    assert history("cpu") == guess
    for bad in (0, -1, "x", None, float("inf"), float("nan")):
        path.write_text(json.dumps({**kept, "cpu": {**kept["cpu"], "training": bad}}))
        assert history("cpu")[1] == {**dict.fromkeys(PHASES, pytest.approx(4)), "training": guess[1]["training"]}


def test_a_disk_that_takes_nothing_changes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "file"))
    remember(WORK, "cpu", slower(WORK, 4))
    assert estimate(WORK).trainings == 0


def test_a_finished_training_is_remembered(filmed: Path, tmp_path: Path, lively: Callable, memories: Path) -> None:
    job = TrainingJob(filmed, tmp_path / "x.frog", recipe=lively(20), seeds=film.seeds(), device="cpu")

    def finished(job: TrainingJob) -> events.Finished:
        *_, end = remembering(run_training(job), job)
        assert isinstance(end, events.Finished)
        return end

    end = finished(job)
    trainings, factors = history("cpu")
    assert trainings == 0, "a short trial would spoil every later estimate"
    work = Workload(job.recipe, 20, film.WIDTH * film.HEIGHT, 24)
    assert factors["decoding"] == pytest.approx(end.phases["decoding"] / work.seconds["decoding"])
    (path,) = memories.glob("*.json")
    before = path.read_bytes()
    for other in (replace(job, steps=30, resume=True), replace(job, seconds=0.05), replace(job, method="static")):
        finished(other)
    assert list(remembering(run_training(job, lambda: True), job))[-1] == events.Cancelled(0, None)
    assert path.read_bytes() == before, "of a part, or of something else, nothing is learned"


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
    code += "from frog_blender.engine.training.session import time_estimate\n"
    code += "work = time_estimate.Workload(recipe.recipe('draft'), 3000, 1e5)\n"
    code += "print(time_estimate.estimate(work, time_estimate.likely_device('cpu')))"
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, cwd=Path(__file__).parents[3])
    assert "Roughly" in run.stdout, run.stderr
