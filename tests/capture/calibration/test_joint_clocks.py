"""Cameras and clocks of films that began at different times, from a person's joints."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from frog_blender.engine.arrays import Float64s
from frog_blender.engine.capture.calibration.calibration import CalibrationRefused
from frog_blender.engine.capture.calibration.joint_clocks import FilmJoints, calibrate_unsynchronised
from frog_blender.engine.capture.calibration.joint_lags import guesses
from frog_blender.engine.capture.calibration.joint_sides import (
    agreed_sides,
    other_side,
    readings_of_sides,
    steady_sides,
)
from frog_blender.engine.capture.calibration.joints import Joints
from frog_blender.engine.capture.camera import Camera, rotation_about
from frog_blender.engine.capture.synchronization.epipolar import fundamental
from frog_blender.engine.capture.synchronization.lags import NamedTracks

from .rigs import TALL, around, facts_of, looking, pixels_of, rig_errors, skeleton, striding

FRAME = 1 / 30
SPREAD = [0.0, 49.0, 174.0, 230.0, 100.0, 300.0]


def filmed(
    camera: Camera,
    offset: float,
    seed: int,
    *,
    images: int = 40,
    noise: float = 5.0,
    swapped: tuple[int, int] = (0, 0),
    pace: float = 1.0,
    person: Callable[[float], Float64s] = skeleton,
) -> FilmJoints:
    """What the network makes of a walk in a film that began at ``offset``.

    Joints are ``noise`` pixels off, one in twenty is anywhere, and in a run of images left is right.
    """
    rng = np.random.default_rng(seed)
    times = FRAME * np.arange(images)
    pixels = np.stack([pixels_of(camera, person(3.0 + pace * (offset + time))) for time in times])
    pixels += rng.normal(0, noise, pixels.shape)
    wild = rng.random(pixels.shape[:2]) < 0.05
    pixels[wild] += rng.normal(0, 150.0, (int(wild.sum()), 2))
    pixels[slice(*swapped)] = pixels[slice(*swapped)][:, other_side(16)]
    visibility = np.where(np.isfinite(pixels[:, :, 0]), rng.uniform(0.45, 1.0, pixels.shape[:2]), 0.0)
    return FilmJoints(times, Joints(pixels, visibility), FRAME)


def nobody(images: int = 40) -> FilmJoints:
    return FilmJoints(
        FRAME * np.arange(images), Joints(np.full((images, 16, 2), np.nan), np.zeros((images, 16))), FRAME
    )


def frames_off(found: Float64s, truth: Sequence[float]) -> float:
    """Frames by which the worst offset is wrong, all shifted by what suits them best."""
    errors = (found - np.asarray(truth)) / FRAME
    return float(np.ptp(errors) / 2)


@pytest.mark.parametrize(
    ("count", "images", "offsets", "swapped"),
    [
        (3, 40, [0.35, 0.0, 0.217], (0, 0)),
        pytest.param(4, 40, [0.0, 0.317, 0.1, 0.4], (12, 33), marks=pytest.mark.slow),
        pytest.param(4, 64, [0.0, 0.317, 0.1, 0.4], (12, 33), marks=pytest.mark.slow),
    ],
)
def test_films_that_began_at_different_times(
    count: int, images: int, offsets: list[float], swapped: tuple[int, int]
) -> None:
    cameras = around(SPREAD[:count], TALL, 1680.0, distance=4.0)
    films = [
        filmed(camera, offsets[i], i, images=images, swapped=swapped if i == 1 else (0, 0))
        for i, camera in enumerate(cameras)
    ]

    found = calibrate_unsynchronised(facts_of(cameras), [0] * count, films)

    centers, rotation, _, _ = rig_errors(found.calibration, cameras)
    assert frames_off(found.offsets, offsets) < 0.3
    assert found.offsets.min() == 0.0
    assert centers < 2.0
    assert rotation < 2.0
    assert (found.sigmas < 0.5 * FRAME).all()


def test_films_in_step_stay_exactly_in_step() -> None:
    cameras = around(SPREAD[:3], TALL, 1680.0, distance=4.0)
    films = [filmed(camera, 0.0, i) for i, camera in enumerate(cameras)]

    found = calibrate_unsynchronised(facts_of(cameras), [0] * 3, films)

    assert (found.offsets == 0.0).all()
    assert rig_errors(found.calibration, cameras)[0] < 1.0


@pytest.mark.parametrize("case", ["still", "a line", "nobody"])
def test_nothing_is_made_up_where_the_films_say_too_little(case: str) -> None:
    cameras = around(SPREAD[:3], TALL, 1680.0, distance=4.0)
    if case == "a line":
        cameras = [looking(f"cam{i:02d}", TALL, 1680.0, [1.3 * (i - 1), -4.0, 1.4], [0, 0, 0.9]) for i in range(3)]
    offsets = [0.3, 0.0, 0.15]
    films = [filmed(camera, offsets[i], i, pace=0.0 if case == "still" else 1.0) for i, camera in enumerate(cameras)]
    if case == "nobody":
        films[1] = nobody()

    try:
        found = calibrate_unsynchronised(facts_of(cameras), [0] * 3, films)
    except CalibrationRefused as error:
        assert "film one person who walks about alone" in str(error)
        assert case != "nobody" or "cam01" in str(error)
    else:
        assert case == "a line"
        assert frames_off(found.offsets, offsets) < 0.5
        assert rig_errors(found.calibration, cameras)[0] < 3.0


def on_a_circle(time: float) -> Float64s:
    """(16, 3) joints of a person who runs in a circle about the room, every stride like the one before."""
    body = striding(0.3 * np.sin(2 * np.pi * 2.5 * time)) + np.array([0.0, -0.6, 0.0])
    return np.asarray(body @ rotation_about(np.array([0.0, 0.0, time])).T)


@pytest.mark.slow
def test_a_person_who_repeats_themselves_leaves_the_clocks_in_doubt() -> None:
    cameras = around(SPREAD[:3], TALL, 1680.0, distance=4.0)
    offsets = [0.0, 0.2, 0.1]
    films = [filmed(camera, offsets[i], i, person=on_a_circle) for i, camera in enumerate(cameras)]

    try:
        found = calibrate_unsynchronised(facts_of(cameras), [0] * 3, films)
    except CalibrationRefused as error:
        assert "two rigs equally well" in str(error)
    else:
        assert any("ms from there" in warning for warning in found.calibration.warnings)


def test_guesses_close_around_all_films_where_pairs_alone_are_wrong() -> None:
    cameras = around(SPREAD[:4], TALL, 1680.0, distance=4.0)
    offsets = np.array([0.0, 0.3, 0.1, 0.4])
    films = [filmed(camera, offsets[i], i, noise=8.0) for i, camera in enumerate(cameras)]
    tracks = [[NamedTracks(film.times, film.joints.visible)] for film in films]

    best, *others = guesses(tracks, [False] * 4, FRAME, TALL[1], 1)

    assert np.abs(best.offsets - offsets).max() < 1.5 * FRAME
    assert not best.sides.any()
    (stride,) = others  # one film where it fits next best
    moved = stride.offsets - best.offsets
    assert (np.abs(moved - np.median(moved)) > 0.3 - FRAME).sum() == 1
    assert stride.score < best.score
    assert (
        guesses(
            [[NamedTracks(film.times, film.joints.visible)] for film in (nobody(), nobody())], [True] * 2, FRAME, 100, 2
        )
        == []
    )


# --- left for right


def test_a_run_of_images_with_left_for_right_is_found() -> None:
    (camera,) = around([30.0], TALL, 1680.0, distance=4.0)
    film = filmed(camera, 0.0, 1, noise=2.0, swapped=(20, 33))
    visible = film.joints.visible
    visible[25] = np.nan

    swapped = steady_sides(visible)

    expected = (np.arange(40) >= 20) & (np.arange(40) < 33)
    expected[25] = False
    assert (swapped == expected).sum() >= 38
    assert not steady_sides(np.full((40, 16, 2), np.nan)).any()
    straight = film.joints.with_sides(expected)
    assert np.array_equal(straight.pixels[21, 0], film.joints.pixels[21, 1], equal_nan=True)
    assert np.array_equal(straight.pixels[5], film.joints.pixels[5], equal_nan=True)


def test_changes_of_sides_that_a_film_leaves_open_are_read_in_two_ways() -> None:
    camera = around(SPREAD[:2], TALL, 1680.0, distance=4.0)[1]
    swapped = (12, 33)
    expected = (np.arange(64) >= swapped[0]) & (np.arange(64) < swapped[1])
    side_view = filmed(camera, 0.317, 1, images=64, swapped=swapped).joints.visible
    short = filmed(camera, 0.317, 1, images=12, noise=2.0).joints.visible

    trusting, distrusting = readings_of_sides(side_view)

    # Both names of the joints lie in almost one place in image 33: trust in the network buys a jump there.
    wrong = trusting ^ expected
    assert 3 < wrong.sum() < 61
    wrong = distrusting ^ expected
    assert wrong.all() or not wrong.any()
    (only,) = readings_of_sides(short)
    assert not only.any()
    (nothing,) = readings_of_sides(np.full((40, 16, 2), np.nan))
    assert not nothing.any()


@pytest.mark.parametrize("count", [3, 8])
def test_cameras_agree_who_has_left_for_right(count: int) -> None:
    cameras = around(np.linspace(0, 300, count).tolist(), TALL, 1680.0, distance=4.0)
    films = [
        filmed(camera, 0.0, i, noise=3.0, images=20, swapped=(4, 15) if i == 1 else (0, 0))
        for i, camera in enumerate(cameras)
    ]
    matrices = {(i, j): fundamental(cameras[i], cameras[j]) for i in range(count) for j in range(i + 1, count)}

    swapped = agreed_sides(np.stack([film.joints.visible for film in films]), matrices, 30.0)

    assert swapped.shape == (count, 20)
    assert swapped[1, 4:15].mean() > 0.9
    assert swapped[1, :4].sum() + swapped[1, 15:].sum() == 0
    assert np.delete(swapped, 1, 0).sum() <= 1
