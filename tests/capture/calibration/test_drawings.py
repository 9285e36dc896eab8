import numpy as np

from frog_blender.engine.capture.calibration.report import from_above

from .rigs import WIDE, looking

ROW = [looking(f"cam{index}", WIDE, 1000.0, (0.5 * index - 0.5, 0.0, 1.0), (0.0, 3.0, 1.0)) for index in range(3)]
WALL = np.column_stack([np.linspace(-1.0, 1.0, 101), np.full(101, 3.0), np.ones(101)])  # six halves of the row away


def test_cameras_in_a_row_are_shown_with_what_they_film() -> None:
    dots, eyes = from_above(ROW, WALL, 500)
    assert len(dots) > 90 and (np.abs(dots - 250) <= 250).all() and (np.abs(eyes - 250) <= 250).all()
    assert eyes[0, 0, 0] < eyes[1, 0, 0] < eyes[2, 0, 0] and (eyes[:, 1, 1] < eyes[:, 0, 1]).all()  # they look up


def test_a_far_background_leaves_the_cameras_apart() -> None:
    far = np.array([[0.0, 1000.0, 1.0], [300.0, 2000.0, 1.0]])
    dots, eyes = from_above(ROW, WALL, 500)
    with_far = from_above(ROW, np.concatenate([WALL, far]), 500)
    assert np.allclose(with_far[1], eyes) and len(with_far[0]) == len(dots)
