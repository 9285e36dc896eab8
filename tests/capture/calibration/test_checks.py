"""What speaks against a camera, and what outweighs it."""

from __future__ import annotations

import pytest

from frog_blender.engine.capture.calibration.calibration import CameraSupport
from frog_blender.engine.capture.calibration.checks import is_contradicted


@pytest.mark.parametrize(
    ("closing", "shared_by_three", "share", "expected"),
    [
        (0.1, 30, 0.8, True),  # few points, and the triangles of its pairs do not close
        (0.1, 200, 0.3, True),  # most of its matches disagree with the solution as well
        (0.1, 200, 0.8, False),  # pairs of few matches turn by chance, and hundreds of points agree
        (0.9, 30, 0.8, False),
        (float("nan"), 30, 0.8, False),  # in no triangle: another sentence tells that
    ],
)
def test_triangles_alone_do_not_contradict_a_camera(
    closing: float, shared_by_three: int, share: float, expected: bool
) -> None:
    support = CameraSupport(400, share, shared_by_three, 0.2, 0.7, 0.002, closing)
    assert is_contradicted(support) is expected
