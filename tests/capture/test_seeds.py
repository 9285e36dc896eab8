from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import looking_at, refused

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.capture import Capture, Shot
from frog_blender.engine.capture.seeding import drawn
from frog_blender.engine.capture.seeding.drawn import NUM_FRAMES, fill_volume
from frog_blender.engine.capture.seeding.views import NUM_BACKGROUND_FRAMES, TrainingImages, cloud_of, spread
from frog_blender.engine.capture.seeds import Seeds, SeedSettings, find_seeds, merge_points

from .calibration.rigs import drawn as draw_card
from .synchronization.moving_scene import texture

WIDTH, HEIGHT = 160, 120
NEAR_Z, FAR_Z = 3.0, 6.0  # a card in front of a wall


@pytest.fixture(autouse=True)
def few_samples(monkeypatch: pytest.MonkeyPatch) -> None:
    """A tenth of the seed points is asked for here, and drawn from a tenth of the places."""
    for name in ("_SAMPLES", "_SPARSE_SAMPLES", "_CANDIDATES"):
        monkeypatch.setattr(drawn, name, getattr(drawn, name) // 10)


def make_scene(positions: list[tuple[float, float]], frames: int, *, moving: bool) -> tuple[Capture, list[np.ndarray]]:
    """Cameras at (x, y, 0) looking along z at a textured card and wall; ``moving``: one position a frame."""
    cameras, images = [], []
    for index, (x, y) in enumerate(positions):
        pose = np.eye(4)
        pose[:2, 3] = -x, -y
        intrinsics = np.array([[150.0, 0, 83], [0, 150, 57], [0, 0, 1]])
        cameras.append(Camera(f"cam{index:02d}", WIDTH, HEIGHT, intrinsics, pose))
        images.append(np.zeros((HEIGHT, WIDTH, 3), np.uint8))
        for seed, z, half in ((1, FAR_Z, 4.5), (2, NEAR_Z, 0.6)):
            corners = np.array([(-half, -half, z), (half, -half, z), (half, half, z), (-half, half, z)])
            images[-1] = draw_card(images[-1], cameras[-1], texture(seed, 200), corners)
    if moving:
        frames, shots = len(cameras), [Shot(index, index, Path(f"{index}.png"), 0) for index in range(len(cameras))]
    else:
        shots = [Shot(c, f, Path(f"{c}.mp4"), f) for f in range(frames) for c in range(len(cameras))]
    capture = Capture(Path("scene"), "test", tuple(cameras), (None,) * len(cameras), tuple(shots), frames)
    return capture, [images[shot.camera] for shot in capture.shots]


class Store:
    """Images in memory; asking for a held-out one is an error."""

    def __init__(self, capture: Capture, images: list[np.ndarray]) -> None:
        self.capture, self.images = capture, images

    def image(self, shot_index: int) -> np.ndarray:
        assert not self.capture.is_test(self.capture.shots[shot_index]), "a held-out image was read"
        return self.images[shot_index]


def check_on_planes(seeds: Seeds) -> None:
    on_card = (np.abs(seeds.points[:, 2] - NEAR_Z) < 0.15) & (np.abs(seeds.points[:, :2]) < 0.65).all(axis=1)
    on_wall = np.abs(seeds.points[:, 2] - FAR_Z) < 0.6
    assert (on_card | on_wall).mean() > 0.9
    assert on_card.mean() > 0.03
    assert on_wall.mean() > 0.3


RING = [(0.0, 0.0), (-0.4, 0.0), (0.4, 0.0), (0.0, -0.4), (0.0, 0.4), (0.4, 0.4)]


def test_seeds_of_many_cameras_lie_on_the_surfaces_in_their_colours() -> None:
    capture, images = make_scene(RING, 4, moving=False)
    capture = replace(capture, test_cameras=frozenset({"cam00"}), near_far=(1.5, 12.0), test_frames=frozenset({2}))
    store = Store(capture, images)
    steps: list[tuple[int, int]] = []
    seeds = find_seeds(capture, store, SeedSettings(3000), progress=lambda done, total: steps.append((done, total)))
    assert steps == sorted(steps) and steps[0][0] == 0 and steps[-1][0] == steps[-1][1]  # from the first match on
    assert "drawn" not in seeds.origin
    assert 1500 < len(seeds.points) <= 3000
    assert seeds.points.dtype == seeds.colors.dtype == np.float32
    assert (seeds.colors >= 0).all()
    assert (seeds.colors <= 1).all()
    check_on_planes(seeds)
    # The held-out camera judges here: points in front of nothing else must have its colours.
    card = np.abs(seeds.points[:, 2] - NEAR_Z) < 0.15
    pixels, _ = capture.cameras[0].project(seeds.points[card].astype(np.float64))
    columns, lines = np.floor(pixels).astype(int).T
    difference = np.abs(images[0][lines, columns] / 255 - seeds.colors[card]).max(axis=1)
    assert np.median(difference) < 0.08
    assert steps[-1][0] == steps[-1][1]


def test_what_one_of_three_cameras_sees_alone_gets_points_on_its_surface_too() -> None:
    capture, images = make_scene([(-1.3, 0.0), (0.0, 0.0), (1.3, 0.0)], 2, moving=False)
    capture = replace(capture, near_far=(1.5, 12.0))
    seeds = find_seeds(capture, Store(capture, images), SeedSettings(3000))
    points = seeds.points.astype(np.float64)
    seen, *elsewhere = (camera.sample(points, images[0])[1] for camera in capture.cameras)
    alone = seen & ~elsewhere[0] & ~elsewhere[1]
    assert alone.sum() > 100
    assert (np.abs(points[alone, 2] - FAR_Z) < 0.6).mean() > 0.8


def test_when_few_are_measured_the_rest_is_guessed_and_the_same_seed_gives_the_same_points() -> None:
    capture, images = make_scene(RING[:3], 1, moving=False)
    capture = replace(capture, near_far=(1.5, 12.0))
    whole, few, again = (
        find_seeds(capture, Store(capture, images), SeedSettings(1500, share=share)) for share in (1.0, 0.1, 0.1)
    )
    np.testing.assert_array_equal(few.points, again.points)
    np.testing.assert_array_equal(few.colors, again.colors)
    assert "drawn" not in whole.origin and "drawn" in few.origin
    assert len(few.points) == 1500, "they begin with as many"
    kept = (few.points[:, None] == whole.points[None]).all(2).any(1).sum()
    assert 0 < kept < 0.4 * len(whole.points)


def test_seeds_of_a_moving_camera_never_read_held_out_frames() -> None:
    positions = [(0.15 * step - 0.6, 0.1 * np.sin(step)) for step in range(9)]
    capture, images = make_scene(positions, 1, moving=True)
    capture = capture.with_holdout(4)
    assert capture.is_moving
    seeds = find_seeds(capture, Store(capture, images), SeedSettings(3000))
    assert "swept" in seeds.origin
    check_on_planes(seeds)


def test_a_moving_rig_that_trains_with_both_its_cameras_gets_seeds() -> None:
    """Every image has its own camera, and two share each frame; no camera is static and has a median image."""
    positions = [(0.12 * (step // 2) - 0.4 + 0.3 * (step % 2), 0.1 * np.sin(step)) for step in range(6)]
    capture, images = make_scene(positions, 1, moving=True)
    capture = replace(capture, shots=tuple(replace(shot, frame=shot.camera // 2) for shot in capture.shots))
    capture = replace(capture, frame_count=3)
    assert not capture.is_moving
    store = Store(capture, images)
    check_on_planes(find_seeds(capture, store, SeedSettings(1500)))
    assert len(fill_volume(TrainingImages(capture, store), (1.0, 8.0), 100, np.random.default_rng(0))) == 100


PASSING = (-1.2, -0.6, 0.0, 0.6, 1.2)


def wide_scene(
    moving_ball: bool, heights: tuple[float, ...] = PASSING, count: int = 4
) -> tuple[Capture, list[np.ndarray]]:
    """Cameras in a ring around a red ball of radius 0.5 at one height a frame in a grey room."""
    cameras = []
    for index in range(count):
        angle = index * 2 * np.pi / count
        eye, lens = (-4 * np.sin(angle), 0, -4 * np.cos(angle)), np.array([[120, 0, 80], [0, 120, 60], [0, 0, 1]])
        cameras.append(looking_at(f"cam{index}", eye, (WIDTH, HEIGHT), lens, up=(0, -1, 0)))
    shots = [Shot(c, f, Path("x"), f) for f in range(5) for c in range(count)]
    capture = Capture(Path("scene"), "test", tuple(cameras), (None,) * count, tuple(shots), 5)
    images = []
    for shot in capture.shots:
        image = np.full((HEIGHT, WIDTH, 3), 128, np.uint8)
        center = np.array([[0.0, heights[shot.frame] if moving_ball else 0.0, 0.0]])
        (pixel,), (depth,) = cameras[shot.camera].project(center)
        cv2.circle(image, (int(pixel[0]), int(pixel[1])), int(120 * 0.5 / depth), (230, 20, 20), -1)
        images.append(image)
    return capture, images


def test_cameras_too_far_apart_get_points_in_their_common_volume_and_more_where_something_moves() -> None:
    capture, images = wide_scene(moving_ball=True)
    seeds = find_seeds(capture, Store(capture, images), SeedSettings(2000))
    assert seeds.origin == "800 behind, 1200 drawn"
    projected = [camera.project(seeds.points.astype(np.float64)) for camera in capture.cameras]
    seen = [(d > 0) & (p >= 0).all(axis=1) & (p < [WIDTH, HEIGHT]).all(axis=1) for p, d in projected]
    assert (sum(in_view.astype(int) for in_view in seen)[800:] >= 2).all()
    for (pixels, depths), sees, part in zip(projected, seen, np.arange(800).reshape(4, 200), strict=True):
        assert sees[part].all(), "each camera's own background"
        assert depths[part].min() > 5, "behind the ball, which hovers four units away"
        grey = np.abs(seeds.colors[part] - 128 / 255).max(axis=1) < 0.01
        assert grey.mean() > 0.8
        assert np.ptp(pixels[part], axis=0).min() > 100, "all over the image"
    where_it_moves = (np.abs(seeds.points[:, [0, 2]]) < 0.75).all(axis=1)
    capture, images = wide_scene(moving_ball=False)
    still = find_seeds(capture, Store(capture, images), SeedSettings(2000))
    where_it_would = (np.abs(still.points[:, [0, 2]]) < 0.75).all(axis=1)
    assert where_it_moves.sum() > 2 * where_it_would.sum()
    assert where_it_moves.mean() > 0.2


def test_a_camera_with_few_images_costs_no_seeds() -> None:
    """It has none at the frames whose median is the static background."""
    capture, images = wide_scene(moving_ball=True)
    frames = list(range(24))
    (rare, *_) = sorted(set(spread(frames, NUM_FRAMES)) - set(spread(frames, NUM_BACKGROUND_FRAMES)))
    shots = [Shot(c, f, Path("x"), f) for f in frames for c in range(4) if c < 3 or f == rare]
    few = replace(capture, shots=tuple(shots), frame_count=len(frames))
    shown = [images[4 * (shot.frame % 5) + shot.camera] for shot in few.shots]
    assert len(find_seeds(few, Store(few, shown), SeedSettings(500)).points) == 500


def test_what_moves_has_points_at_times_of_its_own() -> None:
    """More of them where it is for one frame than where it stays for two."""
    heights = (1.2, 1.2, 0.0, 0.0, -1.2)
    capture, images = wide_scene(moving_ball=True, heights=heights, count=8)
    seeds = find_seeds(capture, Store(capture, images), SeedSettings(2000, num_moments=5))
    assert seeds.frames is not None and seeds.frames.shape == (len(seeds.points),) and len(seeds.points) <= 2000
    moving = np.isfinite(seeds.frames)
    assert 200 < moving.sum() <= 500 and f"{moving.sum()} moving" in seeds.origin
    there = seeds.frames[moving].astype(int)
    counts = np.bincount(there, minlength=5)
    assert counts[4] > 1.5 * counts[:4].max() and counts.min() > 0 and len(counts) == 5
    ball = np.stack([np.zeros(5), heights, np.zeros(5)], axis=1)
    assert np.median(np.linalg.norm(seeds.points[moving] - ball[there], axis=1)) < 0.7


@pytest.mark.parametrize(("moves", "cameras"), [(False, 8), (True, 4)])
def test_no_point_has_a_time_where_nothing_moves_or_few_cameras_tell_it(moves: bool, cameras: int) -> None:
    capture, images = wide_scene(moving_ball=moves, count=cameras)
    assert find_seeds(capture, Store(capture, images), SeedSettings(1000, num_moments=5)).frames is None


def test_a_capture_without_training_images_is_refused() -> None:
    capture, images = make_scene(RING[:2], 1, moving=False)
    capture = replace(capture, test_frames=frozenset({0}))
    refused("every image is held out", find_seeds, capture, Store(capture, images), SeedSettings())


def test_one_camera_that_never_moves_still_gets_points_or_a_sentence() -> None:
    capture, images = make_scene([(0, 0)], 3, moving=False)
    seeds = find_seeds(capture, Store(capture, images), SeedSettings(500))
    assert 0 < len(seeds.points) <= 500


@pytest.mark.parametrize("limit", [1, 2, 3, 10])
def test_a_few_points_can_be_asked_for(limit: int) -> None:
    """Voxels of any size tell sides and distances apart: they never held as few as these."""
    random = np.random.default_rng(0)
    points = np.concatenate([random.normal(size=(500, 3)) * scale for scale in (0.1, 1, 30, 1e4)])
    points[7] = np.nan
    centers = np.array([[0.0, 0, 0], [0.5, 0, 0]])
    merged = merge_points(cloud_of(points, points), centers, limit).points
    assert len(merged) == limit and np.isfinite(merged).all()
    assert len(np.unique(merged, axis=0)) == limit
