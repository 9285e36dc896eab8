"""How long a training will take: a rough count of the work, corrected by what trainings took and by what passes."""

from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import TypeGuard

import pytest
from support.training_steps import MakeJob

from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training
from frog_blender.engine.training.session.time_estimate import (
    COMPRESSING,
    DECODING,
    MEASURING,
    SAVING,
    SEEDING,
    TRAINING,
    Workload,
    estimate,
    history,
    likely_device,
    remembering,
)
from frog_blender.engine.whole_progress import about

WORK = Workload(recipe("standard"), 10_000, 384 * 288, 500)


@pytest.fixture(autouse=True)
def memories(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The cache folder, without any memory."""
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "memories"))
    return tmp_path / "memories"


def finish(factor: float, device: str = "cpu", work: Workload = WORK, before: tuple[float, float] = (1.0, 0.0)) -> None:
    """A training that took so many times the reference's time, and so many seconds before."""
    phases = {"decoding": 1.0, "training": factor * work.seconds}
    stream = (
        events.Started("frog", work.steps, 4, 6, 300, device, round(work.pixels), work.images),
        events.Finished("x.frog", work.steps, 5.0, None, 300, {}, phases),
    )
    assert list(remembering(iter(stream), TrainingJob(Path("x"), Path("x.frog"), recipe=work.recipe))) == list(stream)


def test_more_work_takes_longer() -> None:
    assert replace(WORK, pixels=4 * WORK.pixels).seconds > WORK.seconds
    for changes in ({"max_gaussians": 80_000}, {"hidden_width": 128}, {"region_share": 0.0}, {"capacity": "auto"}):
        assert replace(WORK, recipe=recipe("standard", **changes)).seconds > WORK.seconds, changes
    draft, paper = recipe("draft"), recipe("paper-exact")
    assert replace(WORK, recipe=draft, steps=draft.steps).seconds < WORK.seconds / 2
    assert replace(WORK, recipe=paper, steps=paper.steps).seconds > 20 * WORK.seconds


def test_estimates_are_guesses_first_and_learn_from_every_training(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("os.cpu_count", lambda: 2)
    assert history("cpu") == (0, 1.0) and estimate(WORK).startswith("Roughly")
    assert "not known" in estimate(WORK, "cuda")
    finish(3.0)
    assert history("cpu") == (1, pytest.approx(3.0)) and estimate(WORK).startswith("About")
    finish(1.0)
    assert history("cpu") == (2, pytest.approx(2.0)), "a moving average"
    assert "not known" in estimate(WORK, "cuda"), "a processor says nothing of a GPU"
    finish(0.05, "cuda")
    assert history("cuda")[1] == pytest.approx(0.05) and history("cpu")[1] == pytest.approx(2.0)
    finish(9.0, work=replace(WORK, steps=1))
    assert history("cpu")[0] == 2, "a short trial would spoil every later estimate"
    assert about(600.0) in estimate(replace(WORK, images=0), limit=600.0)


def test_a_run_is_one_bar_from_its_frames_to_its_file(make_job: MakeJob) -> None:
    job = make_job(20, {"overwrite": True, "event_seconds": 0.0})
    said = [event for event in run_training(job) if isinstance(event, events.Stage | events.Progress)]
    fractions = [event.fraction for event in said]
    assert fractions == sorted(fractions) and 0 < fractions[-1] < 1
    stages = list(dict.fromkeys(event.name for event in said if isinstance(event, events.Stage)))
    assert stages[0] == DECODING and stages[-2:] == [MEASURING, SAVING]
    assert all(event.seconds_left > 0 for event in said)
    *_, started = (event for event in run_training(replace(job, steps=30, resume=True)) if is_start(event))
    assert started.step == 20
    first = next(event for event in run_training(replace(job, steps=40, resume=True)) if is_progress(event))
    assert first.fraction > 0.3, "the bar of a resumed training is part full"


def test_no_stage_comes_back(make_job: MakeJob) -> None:
    job = make_job(6, {"overwrite": True, "event_seconds": 0.0}, capacity="auto")
    stages = [
        event.name if isinstance(event, events.Stage) else TRAINING
        for event in run_training(job)
        if isinstance(event, events.Stage | events.Progress)
    ]
    assert [name for name, _ in groupby(stages)] == [DECODING, SEEDING, TRAINING, COMPRESSING, MEASURING, SAVING]


def is_progress(event: events.Event) -> TypeGuard[events.Progress]:
    return isinstance(event, events.Progress)


def is_start(event: events.Event) -> TypeGuard[events.Started]:
    return isinstance(event, events.Started)


@pytest.mark.parametrize(
    "content", ["", "{}", "[1, null]", "\xff", "3", '{"trainings": 1, "factor": -1}', '{"trainings": "x", "factor": 1}']
)
def test_damaged_memories_are_left_out(memories: Path, content: str) -> None:
    guess = history("cpu")
    finish(4.0)
    (path,) = memories.glob("*.json")
    path.write_bytes(content.encode("latin-1"))
    assert history("cpu") == guess


def test_a_part_of_a_training_teaches_nothing(make_job: MakeJob, memories: Path) -> None:
    job = make_job(20, {"overwrite": True})
    *_, end = remembering(run_training(job), job)
    assert isinstance(end, events.Finished) and end.phases["training"] > 0
    for other in (replace(job, steps=30, resume=True), replace(job, seconds=0.05)):
        *_, end = remembering(run_training(other), other)
        assert isinstance(end, events.Finished)
    assert not list(memories.glob("*.json"))


def test_the_device_that_automatic_will_be(monkeypatch: pytest.MonkeyPatch) -> None:
    import torch

    assert likely_device("cuda") == "cuda" and likely_device("cpu") == "cpu"
    for there in (True, False):
        monkeypatch.setattr(torch.cuda, "is_available", lambda there=there: there)
        assert likely_device("auto") == ("cuda" if there else "cpu")
