"""How a take is cut, and that a plan is what was asked for."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import pytest

from frog_blender.engine.errors import FrogError
from frog_blender.engine.training.recipe import recipe
from frog_blender.engine.training.segments.plan import OVERLAP, SegmentPlan, cuts_of
from frog_blender.engine.training.segments.stages import Stages
from frog_blender.engine.training.session.job import TrainingJob


@pytest.mark.parametrize(("frames", "length", "count"), [(1800, 300, 6), (1000, 300, 3), (20, 10, 2), (301, 20, 15)])
def test_segments_cover_every_frame_once(frames: int, length: int, count: int) -> None:
    cuts = cuts_of(frames, length)
    assert len(cuts) == count
    assert [frame for cut in cuts for frame in range(cut.first, cut.first + cut.frames)] == list(range(frames))
    assert max(cut.frames for cut in cuts) - min(cut.frames for cut in cuts) <= 1
    for cut in cuts:
        end, trained_end = cut.first + cut.frames, cut.trained_first + cut.trained_frames
        assert cut.first - cut.trained_first == min(OVERLAP, cut.first)
        assert trained_end - end == min(OVERLAP, frames - end)


@pytest.mark.parametrize(("frames", "length"), [(100, 4), (100, 90), (20, 300)])
def test_what_cannot_be_cut_is_refused(frames: int, length: int) -> None:
    with pytest.raises(FrogError, match="--segments"):
        cuts_of(frames, length)


@pytest.mark.parametrize(
    "changes",
    [{"method": "curves"}, {"recipe": recipe("draft", capacity="fixed")}, {"seconds": 3.0}, {"max_bytes": 10**6}],
)
def test_what_cannot_be_shared_is_refused(stages: Callable[..., Stages], changes: dict[str, object]) -> None:
    with pytest.raises(FrogError, match="--segments"):
        stages(**changes)


def test_a_plan_is_read_as_it_was_written(stages: Callable[..., Stages]) -> None:
    plan = stages(seed=7, steps=33, holdout_frames=5, masks="off").plan
    read = SegmentPlan.open(plan.folder, device="cpu", save_seconds=9.0)
    assert (read.length, read.folder, read.job.output) == (plan.length, plan.folder, plan.job.output)
    assert read.job.stored_settings() == plan.job.stored_settings() and read.job.save_seconds == 9.0


def test_other_settings_do_not_go_on_with_it(stages: Callable[..., Stages]) -> None:
    first = stages(seed=1).plan
    kept = first.folder / "base.frog"
    kept.write_bytes(b"trained")
    assert stages(seed=1).plan.folder == first.folder and kept.exists()
    with pytest.raises(FrogError, match="other settings"):
        stages(seed=2)
    assert stages(seed=2, overwrite=True) and not kept.exists()


def test_a_scene_that_is_replaced_is_trained_anew(stages: Callable[..., Stages]) -> None:
    plan = stages().plan
    kept = plan.folder / "base.frog"
    for has_scene in (False, True):
        kept.write_bytes(b"trained")
        if has_scene:
            plan.job.output.write_bytes(b"joined")
        stages(overwrite=True)
        assert kept.exists() != has_scene


@pytest.mark.parametrize("damage", ["{", "[]", '{"version": 2}', '{"version": 1}', "length", "recipe", "seed"])
def test_a_damaged_plan_is_refused(stages: Callable[..., Stages], damage: str) -> None:
    path = stages().plan.folder / "plan.json"
    content = json.loads(path.read_text())
    if damage == "length":
        content["length"] = -1
    elif damage == "recipe":
        content["settings"]["recipe"]["steps"] = "many"
    elif damage == "seed":
        content["settings"]["seed"] = None
    path.write_text(json.dumps(content) if damage.isalpha() else damage)
    with pytest.raises(FrogError, match="plan"):
        SegmentPlan.open(path.parent)


def test_moving_cameras_are_refused(tmp_path: Path) -> None:
    from support import synthetic_capture as film

    from frog_blender.engine.capture.readers import open_capture

    capture = open_capture(film.write_capture(tmp_path / "film", range(6)))
    one_each = [shot for shot in capture.shots if shot.camera == shot.frame % 4][:4]
    moving = capture._with_shots(one_each)
    assert moving.has_moving_cameras
    job = TrainingJob(capture.path, tmp_path / "x.frog", recipe=recipe("draft", capacity="auto"), opened=moving)
    with pytest.raises(FrogError, match="moving cameras"):
        _ = Stages(SegmentPlan.begin(job, 10)).cuts
