"""Which camera and which time images have: by their names alone, by poses, by lenses, by what the user says."""

from __future__ import annotations

import re
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from support.filmed_scene import moving, rig

from frog_blender.engine.capture.readers.readings import Reading, View, chosen_layout, read_names
from frog_blender.engine.errors import FrogError

IMAGES = list(product(range(4), range(3)))  # cameras and times


def read(pattern: str, views: list[View] | None = None, layout: str = "auto") -> Reading:
    with chosen_layout(layout):
        return read_names(Path("x"), [pattern.format(c=c, t=t) for c, t in IMAGES], views or [], 4.0)


def is_right(reading: Reading) -> bool:
    """Whether the images of each camera are those that were taken by one, and those of one time, at one."""
    cameras, times = (len({*zip(of, truth, strict=True)}) for of, truth in zip_truth(reading))
    return (cameras, len({*reading.cameras}), times, len({*reading.times})) == (4, 4, 3, 3)


def zip_truth(reading: Reading) -> list[tuple[tuple[object, ...], list[int]]]:
    return [(reading.cameras, [c for c, _ in IMAGES]), (reading.times, [t for _, t in IMAGES])]


BARE = [
    "{c:02}/{t:04}.png",
    "{t:04}/{c:02}.png",
    "{c}/{t}.png",
    "{t}/images/{c}.png",
    "{c}_{t}.png",
    "{t:04}-{c:04}.png",
]
"""Of which the numbers alone do not tell which are cameras."""


@pytest.mark.parametrize(
    ("pattern", "layout", "first"),
    [
        ("cam{c}/{t:04}.png", "a folder a camera", "cam0"),
        ("cam{c}/images/{t}.png", "a folder a camera", "cam0"),
        ("images/cam{c}/cam{c}_{t}.png", "a folder a camera", "cam0"),
        ("frame{t:04}/cam{c}.png", "a folder a moment", "cam0"),
        ("frame{t:06}/images/cam{c:02}.png", "a folder a moment", "cam00"),
        ("frame{t}/frame{t}_cam{c}.png", "a folder a moment", "cam0"),
        ("colmap_{t}/images/cam{c}.png", "a folder a moment", "cam0"),
        ("{t}/view_{c}.png", "a folder a moment", "view_0"),
        ("cam{c}_frame{t}.png", "camera_time", "cam0"),
        ("all/cam{c}_{t:03}.png", "camera_time", "cam0"),
        ("frame{t:04}_cam{c}.png", "time_camera", "cam0"),
        ("f{t}c{c}.png", "time_camera", "c0"),
    ],
)
def test_words_tell_cameras_from_times(pattern: str, layout: str, first: str) -> None:
    reading = read(pattern)
    assert (reading.layout, reading.cameras[0]) == (layout, first)
    assert is_right(reading) and reading.times[:3] == (0, 1, 2)


def standing(camera: int, time: int) -> np.ndarray:
    return rig()[camera].moved(np.full(3, 1e-4 * time), np.full(3, 1e-4 * time)).world_to_camera  # as COLMAP is off


def on_a_rig(camera: int, time: int) -> np.ndarray:
    return rig()[camera].world_to_camera @ moving()[time].world_to_camera


@pytest.mark.parametrize("pattern", BARE)
def test_poses_and_lenses_tell_them_and_nothing_else_is_asked(pattern: str) -> None:
    for pose, layout in ((standing, None), (on_a_rig, "a moving rig")):
        reading = read(pattern, [View(pose(c, t)) for c, t in IMAGES])
        assert is_right(reading) and layout in (None, reading.layout)
    assert is_right(read(pattern, [View(kind=c % 2) for c, _ in IMAGES]))
    with pytest.raises(FrogError, match=r"4 cameras of 3 moments, if .*3 cameras of 4 moments, if|3 .*4 cameras of 3"):
        read(pattern)
    says = "moments" if pattern.index("t") < pattern.index("c") else "cameras"
    assert is_right(read(pattern, layout=says))


@pytest.mark.parametrize(
    ("names", "choice", "is_told"),
    [
        (["cam2.png", "cam10.png"], "one-moment", False),
        (["left.png", "right.png"], "one-moment", True),
        (["frame_2.png", "frame_10.png"], "moving", False),
        (["IMG_2.jpg", "IMG_10.jpg"], "moving", True),
        (["cam0/2.png", "cam0/10.png"], "moving", False),
    ],
)
def test_images_of_one_camera_or_of_one_moment(names: list[str], choice: str, is_told: bool) -> None:
    reading = read_names(Path("x"), names)
    assert (reading.choice, bool(reading.doubt)) == (choice, is_told)
    assert choice == "one-moment" or reading.times[0] < reading.times[1]
    assert all(re.search(f"--layout {each}", reading.doubt) for each in ("moving", "one-moment") if is_told)
