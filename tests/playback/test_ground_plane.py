"""What a scene says of its surroundings: where its floor is, and what light falls on it."""

from functools import partial

import numpy as np
import pytest
from support.builders import blobs, pairwise, refused, rotation_of, still_scene

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.playback.environment import environment, equirectangular, filled, free_place
from frog_blender.engine.playback.ground_plane import camera_up, find_floor, placement, static_points
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.srgb import srgb_to_linear

TURNS = [np.eye(3), rotation_of((1, 0, 0), np.pi / 2), rotation_of((1, 2, -0.5), 2.1), rotation_of((0, 1, 0.2), np.pi)]


def room(noise=0.005, floor=1500, table=800, floaters=60, seed=3):
    """Points with the floor at z = 0: walls, a crowd of clutter, a large table at 0.75, floaters everywhere."""
    random = np.random.default_rng(seed)
    across = random.uniform(-2, 2, (floor, 2))
    parts = [np.c_[across, np.zeros(floor)]]
    parts.append(np.c_[random.uniform(-1, 1, (table, 2)), np.full(table, 0.75)])
    parts.append(np.c_[np.full(700, 2.0), random.uniform(-2, 2, 700), random.uniform(0, 2.5, 700)])
    parts.append(np.c_[random.uniform(-2, 2, 700), np.full(700, 2.0), random.uniform(0, 2.5, 700)])
    parts.append(random.normal([0.3, -0.2, 1.0], 0.25, (600, 3)))
    parts.append(random.uniform([-2, -2, -0.8], [2, 2, 2.5], (floaters, 3)))
    points = np.concatenate(parts)
    return points + random.normal(0, noise, points.shape)


def cameras(turn=None, *, pitch=-0.3, roll=0.0, around=2.0, count=9, seed=4):
    """Cameras at height 1.5 on an arc of ``around`` radians, pitched, level up to ``roll``; all turned by ``turn``."""
    turn = np.eye(3) if turn is None else turn
    random = np.random.default_rng(seed)
    rig = []
    for i, angle in enumerate(np.linspace(-around / 2, around / 2, count)):
        forward = np.array([np.sin(angle) * np.cos(pitch), np.cos(angle) * np.cos(pitch), np.sin(pitch)])
        right = np.array([np.cos(angle), -np.sin(angle), 0.0])
        rows = np.stack([right, np.cross(forward, right), forward])
        rows = rotation_of((0, 0, 1), random.normal(0, roll)) @ rows
        pose = np.eye(4)
        pose[:3, :3] = rows @ turn.T
        pose[:3, 3] = -pose[:3, :3] @ (turn @ (-4.0 * forward + [0, 0, 0.3]))
        rig.append(Camera(f"cam{i:02d}", 64, 48, np.diag([60.0, 60.0, 1.0]), pose))
    return rig


def degrees(a, b):
    return np.degrees(np.arccos(np.clip(a @ b, -1, 1)))


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("roll", [0.0, 0.05])
def test_level_cameras_say_where_up_is_whatever_their_pitch(turn, roll):
    up, certain = camera_up(cameras(turn, pitch=-0.6, roll=roll))
    assert certain and degrees(up, turn[:, 2]) < (1e-4 if not roll else 4.0)


def test_one_camera_that_fell_over_changes_little():
    rig = cameras(around=3.0, count=12)
    fallen = np.eye(4)
    fallen[:3, :3] = rotation_of((0, 0, 1), np.pi / 2)
    rig[5] = rig[5].with_pose(fallen @ rig[5].world_to_camera)
    assert degrees(camera_up(rig)[0], np.array([0, 0, 1.0])) < 1.0


def test_cameras_side_by_side_leave_their_pitch_open():
    up, certain = camera_up(cameras(around=0.05, pitch=-0.5))
    assert not certain and degrees(up, np.array([0, 0, 1.0])) == pytest.approx(np.degrees(0.5), abs=1.0)


def test_up_needs_cameras():
    refused("no cameras", camera_up, [])


@pytest.mark.parametrize(("turn", "noise", "around"), pairwise(TURNS, [0.0, 0.01], [2.5, 0.05]))
def test_the_floor_is_found_below_a_table_in_any_position(turn, noise, around):
    shift = np.array([3.0, -1.0, 2.0])
    rig = cameras(turn, around=around, pitch=-0.35)
    points = room(noise) @ turn.T + shift
    up, certain = camera_up(rig)
    floor = find_floor(points, np.ones(len(points)), up, certain=certain)
    assert floor.found and floor.share > 0.2
    assert degrees(floor.up, turn[:, 2]) < 0.5
    assert floor.height == pytest.approx(shift @ turn[:, 2], abs=0.02)


def test_a_large_table_above_a_small_floor_is_a_table():
    points = room(floor=500, table=1500)
    assert find_floor(points, np.ones(len(points)), np.array([0, 0, 1.0])).height == pytest.approx(0.0, abs=0.02)


def test_a_cloud_has_no_floor_but_stands_on_its_lowest_part():
    points = np.random.default_rng(5).normal([0, 0, 1.0], 0.5, (4000, 3))
    up = np.array([0.0, 0.0, 1.0])
    floor = find_floor(points, np.ones(len(points)), up)
    assert not floor.found and np.array_equal(floor.up, up)
    assert np.mean(points[:, 2] < floor.height) == pytest.approx(0.02, abs=0.02)


def test_points_that_say_nothing_are_refused_or_survived():
    up = np.array([0.0, 0.0, 1.0])
    refused("no Gaussian at rest", find_floor, np.full((4, 3), np.nan), np.ones(4), up)
    assert not find_floor(np.ones((500, 3)), np.ones(500), up).found
    points = room()
    points[::50] = np.inf
    points[1::50] = 1e6
    assert find_floor(points, np.ones(len(points)), up).height == pytest.approx(0.0, abs=0.02)


@pytest.mark.parametrize("around", [1.0, 2 * np.pi])
def test_placed_it_stands_upright_at_the_origin_and_is_seen_from_the_front(around):
    turn, shift = TURNS[2], np.array([3.0, -1.0, 2.0])
    rig, points = cameras(turn, around=around), room() @ turn.T + shift
    floor = find_floor(points, np.ones(len(points)), camera_up(rig)[0])
    matrix = placement(floor, points, rig)
    np.testing.assert_allclose(matrix[:3, :3] @ matrix[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(matrix) == pytest.approx(1.0)
    placed = points @ matrix[:3, :3].T + matrix[:3, 3]
    assert np.mean(np.abs(placed[:, 2]) < 0.03) > 0.3
    np.testing.assert_allclose(np.median(placed[:, :2], axis=0), 0, atol=1e-2)
    direction = matrix[:3, :3] @ rig[len(rig) // 2].forward if around == 1.0 else matrix[:3, :3] @ rig[0].forward
    assert direction[1] > 0.9 and abs(direction[0]) < 0.01


def test_only_opaque_static_gaussians_vote():
    means = np.random.default_rng(6).normal(0, 1, (50, 3))
    file = still_scene(blobs(means, (0.3, 0.2, 0.01), opacities=np.r_[np.full(20, 0.01), np.full(30, 0.99)]), cameras())
    points, weights = static_points(ScenePlayer(file))
    np.testing.assert_allclose(points, means[20:], atol=1e-6)
    np.testing.assert_allclose(weights, 0.06 * 0.99, rtol=1e-4)

    class Moving(ScenePlayer):
        """Its last ten Gaussians move."""

        def at(self, time, part=None):
            gaussians = super().at(0.0)
            gaussians.means = gaussians.means + np.float32(time) * (np.arange(50) >= 40)[:, None].astype(np.float32)
            return gaussians

    assert len(static_points(Moving(file))[0]) == 20


balls = partial(blobs, scales=0.3, opacities=0.99)
"""Round and nearly opaque Gaussians."""


def shell(rows=12, columns=24, radius=3.0):
    """Directions of Gaussians all around."""
    rays = equirectangular(columns, rows).reshape(-1, 3)
    return rays * radius


def pixel_of(image, direction):
    height, width = image.shape[:2]
    cosines = equirectangular(width, height) @ (np.array(direction) / np.linalg.norm(direction))
    return image[np.unravel_index(cosines.argmax(), cosines.shape)]


def test_light_comes_from_where_it_was_filmed_and_is_linear():
    ends = {(3, 0, 0): (0.9, 0.1, 0.1), (0, 3, 0): (0.1, 0.8, 0.2), (0, 0, 3): (0.2, 0.3, 0.7)}
    ends |= {(-3, 0, 0): (0.6, 0.6, 0.1), (0, -3, 0): (0.7, 0.2, 0.6), (0, 0, -3): (0.5, 0.5, 0.5)}
    image = environment(balls(list(ends), scales=0.8, colors=list(ends.values())), np.eye(4), 64)
    assert image.shape == (32, 64, 3) and image.dtype == np.float32
    for direction, color in ends.items():
        np.testing.assert_allclose(pixel_of(image, direction), srgb_to_linear(np.array(color)), atol=0.03)


def test_the_camera_decides_what_is_ahead():
    turn = np.eye(4)
    turn[:3, :3] = [[0, -1, 0], [0, 0, -1], [1, 0, 0]]  # looks along +x, z is up
    turn[:3, 3] = -turn[:3, :3] @ [5.0, 6.0, 7.0]
    image = environment(balls([[8, 6, 7], [5, 3, 7]], colors=[[1, 0, 0], [0, 1, 0]]), turn, 64)
    assert pixel_of(image, (0, 0, 1))[0] > 0.9
    assert pixel_of(image, (1, 0, 0))[1] > 0.9, "-y is at the right"


def test_holes_have_the_colour_around_them():
    everywhere = shell()
    warm = np.tile([0.8, 0.5, 0.3], (len(everywhere), 1))
    hole = everywhere @ [0, 0, 1] > 2.0
    image = environment(balls(everywhere[~hole], colors=warm[~hole]), np.eye(4), 64)
    np.testing.assert_allclose(image, np.broadcast_to(srgb_to_linear(np.array(warm[0])), image.shape), atol=0.02)


def test_a_hole_is_filled_from_its_own_side_across_the_seam():
    colors = np.zeros((32, 64, 3))
    colors[:, :16] = colors[:, 48:] = (1, 0, 0)  # behind
    colors[:, 16:48] = (0, 0, 1)
    weights = np.ones((32, 64))
    weights[12:20, :4] = weights[12:20, 60:] = 0  # on both sides of the seam
    colors[weights == 0] = np.nan_to_num(np.inf)
    kept = weights == 1
    result = filled(np.where(kept[..., None], colors, 0), weights)
    np.testing.assert_allclose(result[kept], colors[kept], atol=1e-6)
    np.testing.assert_allclose(result[~kept], np.tile([1, 0, 0], ((~kept).sum(), 1)), atol=0.1)


def test_nothing_to_see_is_said():
    refused("No Gaussian is seen", environment, blobs([[0, 0, 3]], opacities=0.0), np.eye(4), 16)
    with pytest.raises(ValueError, match="power of two"):
        environment(balls([[0, 0, 3]]), np.eye(4), 100)


def test_light_is_not_taken_inside_of_something():
    subject = np.random.default_rng(1).normal(0, 0.1, (300, 3))
    scene = balls(np.concatenate([subject, shell()]), scales=0.05)
    place = free_place(scene, np.zeros(3), 3.0)
    assert 0.3 < np.linalg.norm(place) < 2.0
    assert np.linalg.norm(scene.means - place, axis=1).min() > 0.3
    empty = balls(shell())
    np.testing.assert_array_equal(free_place(empty, np.zeros(3), 3.0), np.zeros(3))
