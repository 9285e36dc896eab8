"""Points known by name, such as joints, and nothing of the cameras."""

from __future__ import annotations

import numpy as np

from frog_blender.engine.capture.synchronization.tracks import NamedTracks, track_lags

from .moving_scene import ring

RATE = 30.0


def walker(times: np.ndarray) -> np.ndarray:
    """(T, 16, 3) metres: a body whose joints swing, which wanders about."""
    random = np.random.default_rng(5)
    home, phases = random.uniform(-0.6, 0.6, (16, 3)), random.uniform(0, 6.28, (16, 3))
    speeds = random.uniform(2, 5, (16, 3))
    swing = 0.25 * np.sin(speeds * times[:, None, None] + phases)
    wander = np.stack([0.5 * np.sin(1.3 * times), 0.1 * np.sin(4 * times), 0.5 * np.cos(0.9 * times)], axis=1)
    return home + swing + wander[:, None]


def seen(camera_index: int, start: float, count: int, noise: float) -> NamedTracks:
    camera = list(ring(4, 1280, 720, spread=80).values())[camera_index]
    times = np.arange(count) / RATE
    pixels, _ = camera.project(walker(times + start).reshape(-1, 3))
    pixels += np.random.default_rng(camera_index).normal(0, noise, pixels.shape)
    positions = pixels.reshape(count, 16, 2)
    positions[::7, 3] = np.nan  # hidden now and then
    return NamedTracks(times, positions)


def test_the_lags_are_found_to_a_third_of_a_frame() -> None:
    offsets = [0.0, 0.287]
    lags = track_lags([seen(i, 1.0 + offset, 60, 1.5) for i, offset in enumerate(offsets)], 1280)
    assert len(lags) == len(offsets) * (len(offsets) - 1) // 2
    for lag in lags:
        assert abs(lag.lag - (offsets[lag.second] - offsets[lag.first])) < 0.34 / RATE
        assert lag.source == "tracks" and lag.score > 0.8


def test_too_few_points_have_no_lag() -> None:
    full = seen(0, 1.0, 60, 1.0)
    hidden = NamedTracks(full.times, np.full_like(full.positions, np.nan))
    single = NamedTracks(full.times[:1], full.positions[:1])
    assert track_lags([full, hidden], 1280) == [] == track_lags([full, single], 1280)


def test_positions_between_frames_and_in_gaps() -> None:
    tracks = NamedTracks(np.array([0.0, 0.1, 0.5]), np.arange(3.0)[:, None, None] * np.ones((1, 1, 2)))
    at = tracks.at(np.array([-0.01, 0.05, 0.1, 0.3, 0.51]), gap=0.2)[:, 0, 0]
    np.testing.assert_allclose(at, [np.nan, 0.5, 1.0, np.nan, np.nan])
