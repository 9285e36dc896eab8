"""What calibration looks at in films."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import refused

from frog_blender.engine.capture.calibration.views import common_times, images_at, standing_of, view_film
from frog_blender.engine.capture.synchronization.films import Film, find_films, kinds_of
from frog_blender.engine.capture.video import VideoFacts
from frog_blender.engine.io.child_process import Stopped

from .walls import camera, film, image, rig, run_in


def with_ball(base: np.ndarray, frame: int) -> np.ndarray:
    return cv2.circle(base.copy(), (40 + 12 * frame, 120), 14, 255, -1)


def test_the_median_is_the_background(tmp_path: Path) -> None:
    base = image(rig()[0])
    film(tmp_path / "a.mp4", [with_ball(base, frame) for frame in range(20)])
    (found,) = find_films(tmp_path)
    view = view_film(found, [0.5, 1.0, 2.5], lambda: None)
    assert np.abs(view.background.astype(int) - base).mean() < 4
    assert view.changing[120, 60:240].all() and view.changing[:80].mean() < 0.1
    assert view.moments.tolist() == [0, 1] and len(view.images) == 2  # the last time is after the last frame


def test_images_are_those_nearest_to_the_times_until_it_is_cancelled(tmp_path: Path) -> None:
    film(tmp_path / "steps.mp4", [np.full((48, 64), 40 * index, np.uint8) for index in range(5)])
    (steps,) = find_films(tmp_path)
    found = list(images_at(steps, [-0.2, 0.0, 0.12, 0.14, 0.31, 0.6], lambda: None))
    assert [None if image is None else round(float(image.mean()) / 40) for image in found] == [None, 0, 1, 1, 3, None]

    def cancel() -> None:
        raise Stopped

    with pytest.raises(Stopped):
        list(images_at(steps, [0.0], cancel))


def test_a_standing_camera_stands_and_a_moving_one_moves(tmp_path: Path) -> None:
    film(tmp_path / "stands.mp4", [with_ball(image(rig()[0]), frame) for frame in range(12)])
    moves = [image(camera("moving", (-1.0 + 0.12 * frame, 0, -3.2))) for frame in range(12)]
    film(tmp_path / "walks.mp4", moves)
    assert standing_of(run_in(tmp_path / "work"), find_films(tmp_path)) == [True, False]
    given = find_films(tmp_path)
    assert [standing_of(run_in(tmp_path), given, known) for known in ("standing", "moving")] == [
        [True, True],
        [False, False],
    ]


def test_a_board_that_is_waved_moves_no_camera(tmp_path: Path) -> None:
    """Before a cloth without a corner, before one with a weak pattern, and where the camera shakes."""
    cloth = np.random.default_rng(1).integers(0, 9, (30, 40)).astype(np.uint8)
    weak = cv2.resize(cloth, (320, 240), interpolation=cv2.INTER_NEAREST)
    board = 255 * (np.indices((72, 96)) // 12).sum(0).astype(np.uint8) % 2 * 255
    for name, before in {"black": np.zeros_like(weak), "weak": weak, "shakes": weak}.items():
        images = []
        for frame in range(12):
            shown = np.roll(before, frame % 2, axis=1) if name == "shakes" else before.copy()
            shown[20 + 9 * frame :][:72, 30 + 14 * frame :][:, :96] = board
            images.append(shown)
        film(tmp_path / f"{name}.avi", images)
    assert all(standing_of(run_in(tmp_path / "work"), find_films(tmp_path)))


def test_common_times_are_frames_of_the_first_film() -> None:
    facts = VideoFacts(320, 240, 30, 10.0, np.arange(30) / 10.0)
    films = [Film("a", Path("a"), facts), Film("b", Path("b"), facts, 0.53)]
    times = common_times(films, 3)
    assert all(films[0].frame_at(time) == pytest.approx(round(films[0].frame_at(time))) for time in times)
    assert all(0.53 <= time <= 2.9 for time in times)
    refused("no time in common", common_times, [films[0], Film("b", Path("b"), facts, 9.0)], 3)


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
    assert np.array_equal(views[0].images[0], views[1].images[0])
    cv2.imwrite(str(tmp_path / "a" / "f_6.png"), np.zeros((48, 80), np.uint8))
    refused(r"f_6\.png: found an image of 80 x 48 pixels, expected 320 x 240", view_film, films[0], [], lambda: None)
    refused("no video, expected one video of each camera", find_films, tmp_path / "a")


def test_films_of_one_size_are_of_one_kind() -> None:
    sizes = [(1080, 1920), (1088, 1920), (640, 480), (1080, 1920)]
    films = [Film("a", Path("a"), VideoFacts(*size, 30, 10.0, np.arange(30) / 10.0)) for size in sizes]
    assert kinds_of(films) == [1, 2, 0, 1]
