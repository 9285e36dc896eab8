import numpy as np
import pytest

from frog_blender.engine.capture.calibration.drawings import frame_from_above, rig_from_above

ROW = np.array([[-0.5, 0.0], [0.0, 0.0], [0.5, 0.0]])
WALL = np.stack([np.linspace(-1.0, 1.0, 101), np.full(101, 3.0)], axis=1)  # six halves of the row's extent away


def within(points: np.ndarray, frame: tuple[np.ndarray, float]) -> np.ndarray:
    middle, reach = frame
    return np.abs(points - middle).max(axis=1) <= reach + 1e-9


def test_cameras_in_a_row_are_shown_with_what_they_film() -> None:
    frame = frame_from_above(ROW, WALL)
    assert within(ROW, frame).all() and within(WALL, frame).mean() > 0.9


def test_a_far_background_leaves_the_cameras_apart() -> None:
    far = np.array([[0.0, 1000.0], [300.0, 2000.0]])
    with_far, without = frame_from_above(ROW, np.concatenate([WALL, far])), frame_from_above(ROW, WALL)
    assert with_far[1] == pytest.approx(without[1]) and not within(far, with_far).any()


def test_the_drawing_has_the_wall_and_every_camera() -> None:
    points = np.column_stack([WALL, np.ones(len(WALL))])
    drawn = rig_from_above(["a", "b<", "c"], ROW, np.array([(0.0, 1.0)] * 3), points)
    assert drawn.count("fill='#999'") > 90 and drawn.count("r='4'") == 3 and ">b&lt;<" in drawn
