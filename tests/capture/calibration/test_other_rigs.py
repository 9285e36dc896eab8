"""Rigs of many kinds, by points that they would see: found within half a per cent, or refused; what moves is told."""

import numpy as np
import pytest

from frog_blender.engine.capture.calibration.checks import moving_share
from frog_blender.engine.capture.calibration.limits import MOST_MOVING
from frog_blender.engine.capture.calibration.model import Lens, Model
from frog_blender.engine.capture.calibration.placing import BACKGROUND, Features, match_pairs, pairs_to_match
from frog_blender.engine.capture.calibration.structure import Images
from frog_blender.engine.capture.camera import Camera

from .rigs import looking, rig_errors
from .sightings import as_cameras, room, solved, wall
from .walls import FOCAL, HEIGHT, WIDTH, camera

pytest.importorskip("pycolmap")

SIZE = (640, 480)


def arc(count: int, step: float, focals: tuple[float, ...] = (640.0,)) -> list[Camera]:
    """Cameras about the room's middle, none of them set up exactly."""
    random = np.random.default_rng(count)
    cameras = []
    for index in range(count):
        angle = np.radians(step * (index - (count - 1) / 2))
        eye = [2.6 * np.sin(angle), -2.6 * np.cos(angle), 1.3 + 0.3 * (index % 3)]
        target = [0.0, 0.0, 0.9]
        eye, target = (np.add(point, random.normal(0, 0.15, 3)).tolist() for point in (eye, target))
        cameras.append(looking(f"cam{index}", SIZE, focals[index % len(focals)], eye, target))
    return cameras


def facing_wall(toe: float) -> list[Camera]:
    """Two rows of three before a wall: parallel with 0, each looking at the middle with 1."""
    places = [(0.7 * (index % 3 - 1), -1.8 + 0.1 * (index % 2), 1.2 + 0.6 * (index // 3)) for index in range(6)]
    return [
        looking(f"cam{index}", SIZE, 640.0, (x, y, z), ((1 - toe) * x, 2.0, 1.4 + (1 - toe) * (z - 1.4)))
        for index, (x, y, z) in enumerate(places)
    ]


RIGS = {
    "three": (arc(3, 15.0), 1500, 0.0),
    "far apart": (arc(5, 28.0), 1500, 0.0),
    "unequal focal lengths": (arc(5, 12.0, (450.0, 830.0, 580.0, 700.0, 510.0)), 1200, 0.0),
    "a barrel": (arc(5, 12.0, (500.0,)), 800, -0.2),
    "a cushion": (arc(5, 12.0, (500.0,)), 800, 0.08),
}


@pytest.mark.parametrize("name", RIGS)
def test_an_arc_and_its_lenses_are_found(name: str) -> None:
    cameras, count, k1 = RIGS[name]
    solution = solved(cameras, room(count, len(cameras)), k1=k1)
    assert solution.refusal is None
    centers, rotations, focals, _ = rig_errors(as_cameras(solution), cameras)
    assert centers < 0.5 and rotations < 0.2 and focals < 1.0
    lenses = solution.model.lenses
    assert len({lens.focal for lens in lenses}) == len({camera.intrinsics[0, 0] for camera in cameras})
    assert all(abs(lens.k1 - k1) < 0.02 for lens in lenses)
    assert k1 or all(lens.k1 == lens.k2 == 0 for lens in lenses)  # none is believed where there is none


@pytest.mark.parametrize("seed", [0, 2])
def test_few_points_do_not_lead_to_focal_lengths_of_their_own(seed: int) -> None:
    cameras = arc(6, 12.0)
    solution = solved(cameras, room(280, seed), seed)
    assert len({lens.focal for lens in solution.model.lenses}) == 1
    centers = rig_errors(as_cameras(solution), cameras)[0]
    assert centers < 0.5 or solution.refusal or solution.warnings
    assert centers < 3.0


def test_parallel_cameras_before_a_wall_are_refused() -> None:
    cameras = facing_wall(0.0)
    solution = solved(cameras, wall(1500, 6))
    sentence = solution.refusal
    assert sentence is not None and "focal length" in sentence and "Turn the cameras" in sentence


def test_cameras_that_look_at_one_place_of_a_wall_are_found() -> None:
    cameras = facing_wall(1.0)
    solution = solved(cameras, wall(1500, 7))
    centers = rig_errors(as_cameras(solution), cameras)[0]
    assert centers < 0.5 or solution.warnings or solution.refusal
    assert centers < 3.0


# --- something large that moves before a moving camera

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
    for index, view in enumerate(CAMERAS):
        where = placed(motion, index)
        points = np.concatenate([rests, subject @ where[:3, :3].T + where[:3, 3]])
        pixels = LENS.pixels(points @ view.rotation.T + view.world_to_camera[:3, 3])
        pixels += random.normal(0, 0.2, pixels.shape)
        false = random.random(len(pixels)) < 0.1
        pixels[false] = random.uniform(0, [WIDTH, HEIGHT], (int(false.sum()), 2))
        seen = ((pixels >= 0) & (pixels < [WIDTH, HEIGHT])).all(axis=1)
        moments = np.full(int(seen.sum()), BACKGROUND, np.int64)
        features.append(Features(pixels[seen], descriptors[seen], moments))
        before.append((view.world_to_camera @ where)[:3])
    lenses = (LENS,) * len(CAMERAS)
    in_the_room = np.stack([view.world_to_camera[:3] for view in CAMERAS])
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
