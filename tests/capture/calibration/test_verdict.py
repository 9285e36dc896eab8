"""What speaks against a camera, and what outweighs it."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from frog_blender.engine.capture.calibration.belief import is_contradicted
from frog_blender.engine.capture.calibration.evidence import CameraEvidence, PairEvidence
from frog_blender.engine.capture.calibration.solve import Solution
from frog_blender.engine.capture.calibration.tracks import Tracks
from frog_blender.engine.capture.calibration.verdict import warnings

NAMES = ("cam0", "cam1", "cam2", "cam3")


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
    evidence = CameraEvidence(400, share, shared_by_three, 0.2, 0.7, 0.002, closing)
    assert is_contradicted(evidence) is expected


def solution(closing: float, agreeing: int) -> Solution:
    """Of four cameras: how often the first's triangles close, and how many of its 100 matches with the last agree."""
    cameras = tuple(CameraEvidence(400, 0.9, 200, 0.2, 0.7, 0.002, closing if not i else 0.9) for i in range(4))
    pairs = tuple(
        PairEvidence(*pair, 150, 100, agreeing if pair == (0, 3) else 95) for pair in combinations(range(4), 2)
    )
    index = np.empty(0, np.int64)
    none = Tracks(index, index, index, np.empty((0, 2)), 0)
    return Solution(None, none, cameras, pairs, (), None, (), (0,) * 4, 0.001)


@pytest.mark.parametrize(
    ("closing", "agreeing", "expected"),
    [
        (0.2, 20, ["Most matches of cam0-cam3 contradict the solution: look at the result."]),
        (0.2, 67, []),  # a third of them are false and alike, and turn the pair's own rotation
        (0.7, 20, []),
    ],
)
def test_pairs_contradict_by_their_matches_and_their_triangles(
    closing: float, agreeing: int, expected: list[str]
) -> None:
    assert warnings(solution(closing, agreeing), NAMES) == expected
