"""The conditions of the stability suite: deterministic, and never of held-out images unless the whole scene changes."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.builders import refused

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.frames.store import FrameStore
from frog_blender.research import conditions

GREY = np.full((60, 80, 3), 128, np.uint8)
ALL = [
    conditions.Exposure(0.3),
    conditions.Light(0.25),
    conditions.Noise(8),
    conditions.Compression(30),
    conditions.Occlusion(0.4, 10),
]


@pytest.mark.parametrize("alteration", ALL, ids=lambda item: type(item).__name__)
def test_the_same_image_always_comes_out_the_same(alteration: conditions.Noise) -> None:
    before = GREY.copy()
    images = [alteration.apply(GREY, "cam01", 4) for _ in range(2)]
    assert np.array_equal(*images)
    assert (images[0].shape, images[0].dtype) == (GREY.shape, np.uint8)
    assert np.array_equal(GREY, before), "the decoded image is not written to"


def test_exposure_is_a_cameras_own_and_stays() -> None:
    levels = {
        name: {int(conditions.Exposure(0.3).apply(GREY, name, frame)[0, 0, 0]) for frame in range(5)}
        for name in ("a", "b", "c")
    }
    assert all(len(seen) == 1 for seen in levels.values())
    assert len(set.union(*levels.values())) == 3


def test_noise_is_as_strong_as_asked_and_new_in_every_image() -> None:
    first, second = (conditions.Noise(8).apply(GREY, "cam01", frame).astype(float) - 128 for frame in (0, 1))
    assert first.std() == pytest.approx(8, rel=0.05)
    assert abs(np.corrcoef(first.ravel(), second.ravel())[0, 1]) < 0.05


def test_someone_stands_before_a_camera_in_the_share_of_its_images() -> None:
    hidden = [not np.array_equal(conditions.Occlusion(0.3, 50).apply(GREY, "cam", frame), GREY) for frame in range(50)]
    assert sum(hidden) == pytest.approx(15, abs=1)
    frame = hidden.index(True)
    share = (conditions.Occlusion(0.3, 50).apply(GREY, "cam", frame) != GREY).any(axis=2).mean()
    assert share < 0.2


def test_brightening_takes_the_dark_back() -> None:
    dark = conditions.Light(0.25).apply(GREY, "cam", 0)
    assert int(dark[0, 0, 0]) < 70
    assert conditions.brightened_values(dark / 255, 4.0)[0, 0, 0] == pytest.approx(128 / 255, abs=0.01)


@pytest.mark.parametrize(("alteration", "tests_too"), [(conditions.Noise(20), False), (conditions.Light(0.25), True)])
def test_images_that_judge_change_only_with_the_whole_scene(
    filmed: Path, cache_folder: Path, alteration: conditions.Noise, tests_too: bool
) -> None:
    clean = open_capture(filmed)
    capture = replace(clean, alteration=alteration)
    before, after = (FrameStore.open(item, cache_folder=cache_folder) for item in (clean, capture))
    assert before.folder != after.folder
    changed = [not np.array_equal(before.image(i), after.image(i)) for i in range(len(before))]
    assert changed == [tests_too or not capture.is_test(shot) for shot in capture.shots]


def test_the_views_that_stay_lie_far_apart(capture: Capture) -> None:
    """The central one of the four, which is cam02, and then the ends of the arc."""
    kept = conditions.fewer_views(capture, 2)
    assert {camera.name for camera in kept.cameras} >= {"cam00", "cam02"}
    assert len(kept.cameras) == 3
    assert [shot.path for shot in filter(kept.is_test, kept.shots)] == [
        shot.path for shot in filter(capture.is_test, capture.shots)
    ]
    refused(r"9 views are asked for, found 3", conditions.fewer_views, capture, 9)


def test_poses_are_wrong_by_as_much_as_asked_but_for_the_judges(capture: Capture) -> None:
    angles = []
    wrong = conditions.wrong_poses(capture, 0.5)
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
    again = conditions.wrong_poses(capture, 0.5)
    assert np.array_equal(again.cameras[1].world_to_camera, wrong.cameras[1].world_to_camera)


def test_clocks_disagree_by_whole_frames(capture: Capture) -> None:
    wrong = conditions.wrong_clocks(capture, 2)
    late: dict[int, set[int]] = {}
    for shot in wrong.shots:
        late.setdefault(shot.camera, set()).add(shot.index - shot.frame)
    assert all(len(offsets) == 1 and abs(next(iter(offsets))) <= 2 for offsets in late.values())
    assert late[0] == {0}, "the held-out camera is in sync"
    assert set.union(*late.values()) != {0}
    counts = {camera: sum(shot.camera == camera for shot in wrong.shots) for camera in late}
    assert all(counts[camera] == capture.frame_count - abs(next(iter(late[camera]))) for camera in late)


def test_a_faster_film_has_every_second_frame(capture: Capture) -> None:
    fast = conditions.faster(capture, 2, 3)
    assert fast.frame_count == 3
    assert {(shot.frame, shot.index) for shot in fast.shots} == {(0, 0), (1, 2), (2, 4)}
    assert len(fast.shots) == 3 * len(capture.cameras)
    refused("frames 0 to 7", conditions.faster, capture, 2, 4)


def test_every_condition_is_named_and_measured_against_one_of_its_base() -> None:
    assert {condition.base for condition in conditions.CONDITIONS.values()} == set(conditions.BASES)
    for name, condition in conditions.CONDITIONS.items():
        assert condition.name == name
        if condition.against:
            assert conditions.CONDITIONS[condition.against].base == condition.base
            assert not conditions.CONDITIONS[condition.against].against


def test_a_condition_opens_the_capture_changed_as_it_says(filmed: Path, capture: Capture) -> None:
    for name, condition in conditions.CONDITIONS.items():
        if condition.base != "clean" or name.startswith("views"):
            continue
        opened = condition.opened(filmed)
        assert opened.frame_count == capture.frame_count
        poses, clean = ([camera.world_to_camera.tolist() for camera in c.cameras] for c in (opened, capture))
        changed = opened.alteration is not None or poses != clean or opened.shots != capture.shots
        assert (changed or bool(condition.settings)) == (name != "clean"), name
