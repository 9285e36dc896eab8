"""Captures with fewer cameras, wrong poses, wrong clocks, another pace."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.errors import FrogError
from frog_blender.research.corruptions.cameras import faster, fewer_views, wrong_clocks, wrong_poses
from frog_blender.research.corruptions.catalogue import BASES, CONDITIONS, condition_named


@pytest.fixture
def capture(filmed: Path) -> Capture:
    return open_capture(filmed)


def test_the_views_that_stay_lie_far_apart(capture: Capture) -> None:
    """The central one of the four, which is cam02, and then the ends of the arc."""
    kept = fewer_views(capture, 2)
    assert {camera.name for camera in kept.cameras} >= {"cam00", "cam02"}
    assert len(kept.cameras) == 3
    assert [shot.path for shot in kept.test_shots] == [shot.path for shot in capture.test_shots]
    with pytest.raises(FrogError, match=r"9 views are asked for, found 3"):
        fewer_views(capture, 9)


def test_poses_are_wrong_by_as_much_as_asked_but_for_the_judges(capture: Capture) -> None:
    angles = []
    wrong = wrong_poses(capture, 0.5)
    for before, after in zip(capture.cameras, wrong.cameras, strict=True):
        turn = after.rotation @ before.rotation.T
        assert np.allclose(turn @ turn.T, np.eye(3), atol=1e-12)
        angle = np.degrees(np.arccos(np.clip((np.trace(turn) - 1) / 2, -1, 1)))
        if before.name in capture.test_cameras:
            assert np.array_equal(before.world_to_camera, after.world_to_camera)
        else:
            angles.append(angle)
            assert not np.allclose(before.center, after.center)
    assert 0.2 < np.mean(angles) < 2.0
    again = wrong_poses(capture, 0.5)
    assert np.array_equal(again.cameras[1].world_to_camera, wrong.cameras[1].world_to_camera)


def test_clocks_disagree_by_whole_frames(capture: Capture) -> None:
    wrong = wrong_clocks(capture, 2)
    late: dict[int, set[int]] = {}
    for shot in wrong.shots:
        late.setdefault(shot.camera, set()).add(shot.index - shot.frame)
    assert all(len(offsets) == 1 and abs(next(iter(offsets))) <= 2 for offsets in late.values())
    assert late[0] == {0}, "the held-out camera is in sync"
    assert set.union(*late.values()) != {0}
    counts = {camera: sum(shot.camera == camera for shot in wrong.shots) for camera in late}
    assert all(counts[camera] == capture.frame_count - abs(next(iter(late[camera]))) for camera in late)


def test_a_faster_film_has_every_second_frame(capture: Capture) -> None:
    fast = faster(capture, 2, 3)
    assert fast.frame_count == 3
    assert {(shot.frame, shot.index) for shot in fast.shots} == {(0, 0), (1, 2), (2, 4)}
    assert len(fast.shots) == 3 * len(capture.cameras)
    with pytest.raises(FrogError, match="frames 0 to 7"):
        faster(capture, 2, 4)


def test_every_condition_is_named_and_measured_against_one_of_its_base() -> None:
    assert {condition.base for condition in CONDITIONS.values()} == set(BASES)
    for name, condition in CONDITIONS.items():
        assert condition.name == name
        if condition.against:
            assert CONDITIONS[condition.against].base == condition.base
            assert not CONDITIONS[condition.against].against
    with pytest.raises(FrogError, match="no condition 'fog'"):
        condition_named("fog")


@pytest.mark.parametrize(
    "name", [name for name, item in CONDITIONS.items() if item.base == "clean" and name[:5] != "views"]
)
def test_a_condition_opens_the_capture_changed_as_it_says(filmed: Path, capture: Capture, name: str) -> None:
    opened = condition_named(name).opened(filmed)
    assert opened.frame_count == capture.frame_count
    changed = (
        opened.alteration is not None
        or [c.world_to_camera.tolist() for c in opened.cameras] != [c.world_to_camera.tolist() for c in capture.cameras]
        or opened.shots != capture.shots
        or bool(condition_named(name).settings)
    )
    assert changed == (name != "clean")
