"""Points known by name, such as joints, and nothing of the cameras."""

from __future__ import annotations

import numpy as np

from frog_blender.engine.capture.synchronization.starts import NamedTracks, track_lags

from ..calibration.rigs import WIDE, around, pixels_of, skeleton

RATE = 30.0


def seen(camera_index: int, start: float, count: int, noise: float) -> NamedTracks:
    (camera,) = around([40.0 * camera_index], WIDE, 1000.0)
    times = np.arange(count) / RATE
    positions = np.stack([pixels_of(camera, skeleton(start + time)) for time in times.tolist()])
    positions += np.random.default_rng(camera_index).normal(0, noise, positions.shape)
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
