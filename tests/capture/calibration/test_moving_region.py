"""Something large that moves before a moving camera."""

from __future__ import annotations

import numpy as np
import pytest

from frog_blender.engine.capture.calibration.checks import moving_share
from frog_blender.engine.capture.calibration.limits import MOST_MOVING
from frog_blender.engine.capture.calibration.model import Lens, Model
from frog_blender.engine.capture.calibration.placing import BACKGROUND, Features, match_pairs, pairs_to_match
from frog_blender.engine.capture.calibration.structure import Images

from .walls import FOCAL, HEIGHT, WIDTH, camera

pytest.importorskip("pycolmap")

CAMERAS = [camera(f"{i:03d}", (-1.5 + 0.3 * i, 0.2 * np.sin(i), -3.0 - 0.1 * np.cos(i))) for i in range(5)]
LENS = Lens(WIDTH, HEIGHT, FOCAL)


def placed(motion: float, image: int) -> np.ndarray:
    """(4, 4) where the subject stands at an image: it goes along and turns, by ``motion``."""
    angle = 0.25 * motion * image
    pose = np.eye(4)
    pose[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
    pose[:3, 3] = [-0.5 + 0.2 * motion * image, 0.1 * motion * np.sin(2 * image), 0.0]
    return pose


def filmed(of_subject: int, motion: float) -> tuple[list[Features], Model, Model]:
    """What cameras see of 200 points at rest and so many of a subject; their poses in the room, and before the subject.

    Every tenth match is false.
    """
    random = np.random.default_rng(of_subject)
    rests = random.uniform([-2.5, -1.5, 1.0], [2.5, 1.5, 4.0], (200, 3))
    subject = random.uniform([-0.6, -0.9, -0.5], [0.6, 0.9, 0.5], (of_subject, 3))
    descriptors = random.integers(0, 255, (200 + of_subject, 128), np.uint8)
    features, before = [], []
    for number, each in enumerate(CAMERAS):
        where = placed(motion, number)
        points = np.concatenate([rests, subject @ where[:3, :3].T + where[:3, 3]])
        pixels = LENS.pixels(points @ each.rotation.T + each.world_to_camera[:3, 3])
        pixels += random.normal(0, 0.2, pixels.shape)
        false = random.random(len(pixels)) < 0.1
        pixels[false] = random.uniform(0, [WIDTH, HEIGHT], (int(false.sum()), 2))
        seen = ((pixels >= 0) & (pixels < [WIDTH, HEIGHT])).all(axis=1)
        moments = np.full(int(seen.sum()), BACKGROUND, np.int64)
        features.append(Features(pixels[seen], descriptors[seen], moments))
        before.append((each.world_to_camera @ where)[:3])
    lenses = (LENS,) * len(CAMERAS)
    in_the_room = np.stack([each.world_to_camera[:3] for each in CAMERAS])
    return features, Model(in_the_room, lenses), Model(np.stack(before), lenses)


def share(features: list[Features], model: Model) -> float:
    count = len(CAMERAS)
    matches, _ = match_pairs(features, [LENS] * count, pairs_to_match([count]), lambda *_: None)
    images = Images((LENS,) * count, (0,) * count, tuple(found.pixels for found in features), 0)
    return moving_share(images, model, matches)


@pytest.mark.parametrize(("subject", "motion"), [(130, 0.0), (10, 1.0)], ids=["at rest", "small"])
def test_nothing_is_said_of_a_subject_at_rest_or_a_small_one(subject: int, motion: float) -> None:
    features, model, _ = filmed(subject, motion)
    assert share(features, model) <= MOST_MOVING


def test_a_large_subject_is_told_of() -> None:
    features, model, before = filmed(170, 1.0)
    assert 0.25 < share(features, model) < 0.6
    assert 0.25 < share(features, before) < 0.6  # poses before the subject: the room contradicts them
    poses = model.poses.copy()
    poses[1:] = np.nan
    assert share(features, Model(poses, model.lenses)) == 0.0  # images without a pose are left out
