"""What calibration looks at in films."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from frog_blender.engine.capture.calibration.films import (
    Film,
    common_times,
    find_films,
    is_standing,
    view_film,
    with_groups,
)
from frog_blender.engine.capture.video import VideoFacts
from frog_blender.engine.errors import FrogError

from .walls import camera, film, image, rig, view


def with_ball(base: np.ndarray, frame: int) -> np.ndarray:
    return cv2.circle(base.copy(), (40 + 12 * frame, 120), 14, 255, -1)


def test_the_plate_is_the_background(tmp_path: Path) -> None:
    base = image(rig()[0])
    film(tmp_path / "a.mp4", [with_ball(base, frame) for frame in range(20)])
    (found,) = find_films(tmp_path)
    view = view_film(found, [0.5, 1.0], lambda: None)
    assert np.abs(view.background.astype(int) - base).mean() < 4
    assert view.changing[120, 60:240].all() and view.changing[:80].mean() < 0.1
    assert [each is not None for each in view.images] == [True, True]
    assert view.nexts == (None, None)


def test_a_time_between_frames_has_a_neighbour(tmp_path: Path) -> None:
    film(tmp_path / "a.mp4", [with_ball(image(rig()[0]), frame) for frame in range(20)])
    view = view_film(find_films(tmp_path)[0], [0.52, 1.98], lambda: None)
    assert view.shares[0] == pytest.approx(0.2, abs=1e-6)
    assert view.nexts[0] is not None
    assert view.images[1] is None  # after the last frame


def test_a_standing_camera_stands_and_a_moving_one_moves(tmp_path: Path) -> None:
    film(tmp_path / "stands.mp4", [with_ball(image(rig()[0]), frame) for frame in range(12)])
    moves = [image(camera("moving", (-1.0 + 0.12 * frame, 0, -3.2))) for frame in range(12)]
    film(tmp_path / "walks.mp4", moves)
    assert {each.name: is_standing(each) for each in find_films(tmp_path)} == {"stands": True, "walks": False}


def test_common_times_are_frames_of_the_first_film() -> None:
    facts = VideoFacts(320, 240, 30, 10.0, np.arange(30) / 10.0)
    films = [Film("a", Path("a"), facts), Film("b", Path("b"), facts, 0.53)]
    times = common_times(films, 3)
    assert all(films[0].frame_at(time) == pytest.approx(round(films[0].frame_at(time))) for time in times)
    assert all(0.53 <= time <= 2.9 for time in times)


def test_films_without_a_common_time_are_refused() -> None:
    facts = VideoFacts(320, 240, 30, 10.0, np.arange(30) / 10.0)
    with pytest.raises(FrogError, match="no time in common"):
        common_times([Film("a", Path("a"), facts), Film("b", Path("b"), facts, 9.0)], 3)


def test_images_are_taken_at_their_numbers(tmp_path: Path) -> None:
    base = image(rig()[0])
    for name, numbers in {"b": (4, 5, 6, 9), "a": (5, 6, 7)}.items():
        (tmp_path / name).mkdir()
        for number in numbers:
            cv2.imwrite(str(tmp_path / name / f"f_{number}.png"), with_ball(base, number))
    films = find_films(tmp_path)
    assert [film.name for film in films] == ["a", "b"]
    assert films[1].stamps * 30 == pytest.approx([4, 5, 6, 9])
    assert films[0].frame_at(6 / 30) == pytest.approx(1) and films[1].frame_at(6 / 30) == pytest.approx(2)
    views = [view_film(film, [6 / 30], lambda: None) for film in films]
    one, other = views[0].images[0], views[1].images[0]
    assert one is not None and other is not None and np.array_equal(one, other)


def test_an_image_of_another_size_is_named(tmp_path: Path) -> None:
    (tmp_path / "a").mkdir()
    for number in range(4):
        cv2.imwrite(str(tmp_path / "a" / f"{number}.png"), np.zeros((48, 64 + 16 * (number == 2)), np.uint8))
    with pytest.raises(FrogError, match=r"2\.png: found an image of 80 x 48 pixels, expected 64 x 48"):
        view_film(find_films(tmp_path)[0], [], lambda: None)


def test_a_folder_without_videos_says_what_is_expected(tmp_path: Path) -> None:
    with pytest.raises(FrogError, match="no video, expected one video of each camera"):
        find_films(tmp_path)


def test_films_of_almost_one_size_are_of_one_kind_where_that_is_asked_for() -> None:
    sizes = [(1080, 1920), (1088, 1920), (640, 480), (1080, 1920)]
    views = [replace(view(each), size=size) for each, size in zip(rig(), sizes, strict=False)]
    assert [each.group for each in with_groups(views)] == [1, 2, 0, 1]
    assert [each.group for each in with_groups(views, 0.01)] == [1, 1, 0, 1]


def test_two_makes_of_one_size_are_two_kinds() -> None:
    views = [view(each) for each in rig()[:4]]
    kinds = ["Apple, iPhone 13", "Google, Pixel 7", "", "Apple, iPhone 13"]
    assert [each.group for each in with_groups(views, kinds=kinds)] == [1, 2, 0, 1]
