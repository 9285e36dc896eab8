"""Points that cameras share, by cameras and pixels that are known."""

from __future__ import annotations

import numpy as np
import pytest

from frog_blender.engine.capture.calibration.model import Lens, Model
from frog_blender.engine.capture.calibration.tracks import Tracks, cost, join, located, residuals, triangulate

from .walls import FOCAL, HEIGHT, WIDTH, rig

LENSES = (Lens(WIDTH, HEIGHT, FOCAL),) * 5
POSES = np.stack([camera.world_to_camera[:3] for camera in rig()])


def seen(count: int = 40, lens: Lens = LENSES[0]) -> tuple[Tracks, np.ndarray]:
    """Every point in every camera."""
    points = np.random.default_rng(3).uniform([-1, -1, 0.5], [1, 1, 3], (count, 3))
    pixels = np.stack([lens.pixels(points @ pose[:, :3].T + pose[:, 3]) for pose in POSES], axis=1)
    index, camera = np.repeat(np.arange(count), 5), np.tile(np.arange(5), count)
    return Tracks(index, camera, index, pixels.reshape(-1, 2), count), points


@pytest.mark.parametrize("lens", [LENSES[0], Lens(WIDTH, HEIGHT, FOCAL, -0.2, 0.05)])
def test_points_are_where_their_rays_meet(lens: Lens) -> None:
    tracks, points = seen(lens=lens)
    found = triangulate(tracks, Model(POSES, (lens,) * 5))
    assert np.allclose(found, points, atol=1e-6)
    assert residuals(tracks, found, Model(POSES, (lens,) * 5)).max() < 1e-4


def test_a_false_observation_does_not_move_its_point() -> None:
    tracks, points = seen()
    tracks.pixels[7] += 30
    found, distances = located(tracks, Model(POSES, LENSES))
    assert np.allclose(found, points, atol=1e-6)
    assert np.flatnonzero(distances > 1).tolist() == [7]


def test_a_point_behind_a_camera_does_not_agree() -> None:
    tracks, points = seen()
    behind = points.copy()
    behind[0] = [0, 0, -20]
    assert np.isinf(residuals(tracks, behind, Model(POSES, LENSES))[:5]).all()


def test_a_camera_without_a_pose_has_no_residual_and_costs_all() -> None:
    tracks, _ = seen()
    poses = POSES.copy()
    poses[2] = np.nan
    _, distances = located(tracks, Model(poses, LENSES))
    assert np.isinf(distances[tracks.cameras == 2]).all() and distances[tracks.cameras != 2].max() < 1e-4
    assert cost(distances, np.ones_like(distances)) == pytest.approx(0.2)


def test_matches_are_joined_across_pairs() -> None:
    pixels = [np.arange(8.0).reshape(4, 2) + 10 * camera for camera in range(3)]
    pairs = {(0, 1): np.array([[0, 1], [2, 2]]), (1, 2): np.array([[1, 3]]), (0, 2): np.array([[3, 0]])}
    tracks = join(pairs, pixels)
    by_point = [
        sorted(zip(tracks.cameras[own].tolist(), tracks.features[own].tolist(), strict=True))
        for own in (tracks.points == point for point in range(tracks.count))
    ]
    assert sorted(by_point) == [[(0, 0), (1, 1), (2, 3)], [(0, 2), (1, 2)], [(0, 3), (2, 0)]]
    assert np.array_equal(
        tracks.pixels, np.stack([pixels[c][f] for c, f in zip(tracks.cameras, tracks.features, strict=True)])
    )


def test_a_track_sees_no_camera_twice() -> None:
    pixels = [np.zeros((2, 2)), np.zeros((2, 2)), np.zeros((1, 2))]
    tracks = join({(0, 1): np.array([[0, 0]]), (0, 2): np.array([[1, 0]]), (1, 2): np.array([[0, 0]])}, pixels)
    assert tracks.cameras.tolist() == [0, 1, 2] and tracks.count == 1


def test_nothing_matches() -> None:
    assert join({(0, 1): np.empty((0, 2), np.int64)}, [np.zeros((3, 2))] * 2).count == 0
