"""Cameras from a person's joints: with clocks that are known, heard, or found by the joints themselves."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from support.films import encode

from frog_blender.engine.arrays import Float64s
from frog_blender.engine.capture.calibration import joint_rig, joints
from frog_blender.engine.capture.calibration.joint_rig import calibrate_joints, calibrate_unsynchronized, moving_tracks
from frog_blender.engine.capture.calibration.joints import OTHER_SIDE, agreed_sides, steady_sides, with_sides
from frog_blender.engine.capture.calibration.model import Calibration
from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.epipolar import fundamental
from frog_blender.engine.capture.synchronization.films import CalibrationRefused, Film, Run, find_films
from frog_blender.engine.capture.synchronization.starts import NamedTracks, track_lags
from frog_blender.engine.capture.synchronization.synchronization import Synchronization, synchronize

from ..synchronization.moving_scene import MovingScene, ring
from ..synchronization.test_starts import RATE, speech
from .rigs import TALL, around, facts_of, pixels_of, rig_errors, skeleton
from .walls import run_in

FRAME = 1 / 30
SPREAD = [0.0, 49.0, 174.0, 230.0, 100.0, 300.0]


def filmed(
    camera: Camera,
    offset: float,
    seed: int,
    *,
    times: Float64s | None = None,
    noise: float = 5.0,
    swapped: tuple[int, int] = (0, 0),
    pace: float = 1.0,
) -> NamedTracks:
    """What the network makes of a walk in a film that began at ``offset``.

    Joints are ``noise`` pixels off, one in twenty is anywhere, and in a run of images left is right.
    """
    rng = np.random.default_rng(seed)
    times = FRAME * np.arange(40) if times is None else times
    pixels = np.stack([pixels_of(camera, skeleton(3.0 + pace * (offset + time))) for time in times])
    pixels += rng.normal(0, noise, pixels.shape)
    wild = rng.random(pixels.shape[:2]) < 0.05
    pixels[wild] += rng.normal(0, 150.0, (int(wild.sum()), 2))
    pixels[slice(*swapped)] = pixels[slice(*swapped), OTHER_SIDE]
    pixels[rng.random(pixels.shape[:2]) < 0.1] = np.nan
    return NamedTracks(times, pixels)


def spread(count: int) -> list[Camera]:
    """So many cameras far apart about a room."""
    return around(SPREAD[:count], TALL, 1680.0, distance=4.0)


@pytest.fixture
def run(tmp_path: Path) -> Run:
    return run_in(tmp_path / "work")


# --- known clocks


def walks(cameras: Sequence[Camera], **options: float) -> Float64s:
    times = np.linspace(0, 12, 40)
    return np.stack([filmed(camera, 0.0, i, times=times, **options).positions for i, camera in enumerate(cameras)])


def test_a_walk_places_cameras_that_share_no_features(run: Run) -> None:
    """In the child, which a fault of its libraries may end."""
    cameras = spread(4)
    pixels = walks(cameras, noise=8.0)
    pixels[1, 10:18] = pixels[1, 10:18][:, OTHER_SIDE]

    found = run.in_child(calibrate_joints, facts_of(cameras), pixels, None)

    centers, rotation, focal, _ = rig_errors(found, cameras)
    assert centers < 1.0 and rotation < 1.0 and focal < 3.0
    assert not found.is_metric


def test_what_joints_leave_open_is_refused() -> None:
    cameras = spread(4)
    pixels, times = walks(cameras), np.linspace(0, 12, 40)
    another = pixels.copy()
    another[2] = filmed(cameras[2], 37.0, 9, times=times, pace=-2.3).positions
    with pytest.raises(CalibrationRefused, match=r"cam02|join all cameras|two rigs"):
        calibrate_joints(facts_of(cameras), another)
    few = pixels.copy()
    few[1, 5:] = np.nan
    with pytest.raises(CalibrationRefused, match=r"Camera cam01 shares \d+ joints"):
        calibrate_joints(facts_of(cameras), few)


# --- clocks from joints


def start_of(tracks: Sequence[NamedTracks]) -> Float64s:
    """Offsets (C,) at which the tracks of all films fit together."""
    lags = {(lag.first, lag.second): lag.lag for lag in track_lags(tracks, TALL[1])}
    return np.array([0.0, *(lags[0, film] for film in range(1, len(tracks)))])


@pytest.mark.parametrize(
    ("offsets", "swapped"),
    [([0.35, 0.0, 0.217], (12, 20)), pytest.param([0.0, 0.317, 0.1, 0.4], (0, 0), marks=pytest.mark.slow)],
)
def test_films_that_began_at_different_times(offsets: list[float], swapped: tuple[int, int]) -> None:
    cameras = spread(len(offsets))
    films = [filmed(c, offsets[i], i, swapped=swapped if i == 1 else (0, 0)) for i, c in enumerate(cameras)]
    tracks = moving_tracks(facts_of(cameras), films)

    calibration, found = calibrate_unsynchronized(facts_of(cameras), tracks, start_of(tracks), FRAME)

    centers, rotation, _, _ = rig_errors(calibration, cameras)
    assert np.ptp(found - offsets) / 2 < 0.3 * FRAME and found.min() == 0.0  # shifted by what suits all best
    assert centers < 2.0 and rotation < 2.0


def test_films_in_step_stay_exactly_in_step(run: Run) -> None:
    cameras = spread(3)
    tracks = [filmed(camera, 0.0, i) for i, camera in enumerate(cameras)]
    wrong = np.array([0.0, 0.4, -0.3])  # that all are in step is tried as well

    calibration, found = run.in_child(calibrate_unsynchronized, facts_of(cameras), tracks, wrong, FRAME)

    assert (found == 0.0).all() and rig_errors(calibration, cameras)[0] < 1.0


def test_nothing_is_made_up_where_the_films_say_too_little() -> None:
    first, side = spread(2)
    facts = facts_of([first, side])
    walk, still = filmed(first, 0.0, 0), filmed(side, 0.0, 1, pace=0.0)
    nobody = NamedTracks(walk.times, np.full_like(walk.positions, np.nan))
    with pytest.raises(CalibrationRefused, match=r"joints move in the film of camera cam01.* walks about alone"):
        moving_tracks(facts, [walk, still])
    with pytest.raises(CalibrationRefused, match="cam01 shows no person"):
        moving_tracks(facts, [walk, nobody])
    # Seen from the side, nothing tells whether left and right changed: they fit a lag that is a stride off as well.
    turned = filmed(side, 0.317, 1, times=FRAME * np.arange(64), swapped=(12, 33))
    assert joints.leaves_sides_open(turned.positions) and not joints.leaves_sides_open(walk.positions)
    assert track_lags([walk, nobody], TALL[1]) == []
    with pytest.raises(CalibrationRefused):
        calibrate_unsynchronized(facts, [walk, nobody], np.array([0.0, 99.0]), FRAME)


def test_sound_times_films_before_any_joint_is_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    # What moves says that the second film began 0.15 s later; what is heard, that it began 0.45 s later.
    scene, sound, times = MovingScene(), speech(4), np.arange(40) / 20
    for (name, camera), moved, heard in zip(ring(2).items(), (0.0, 0.15), (0.0, 0.45), strict=True):
        samples = (32_767 * sound[round(heard * RATE) : round((heard + 2) * RATE), None]).astype(np.int16)
        images = [scene.image(camera, moved + time) for time in times]
        encode(tmp_path / f"{name}.mp4", images, rate=20, sound=samples, sound_rate=RATE)
    films, steps = find_films(tmp_path), []

    def find(run: Run, films: Sequence[Film], tracks: Mapping[str, NamedTracks]) -> Synchronization:
        steps.append("clocks by joints" if tracks else "clocks")
        return synchronize(films, run.work, tracks=tracks)

    def of_joints(_run: Run, _file: Path, films: Sequence[Film]) -> Calibration:
        steps.append("joints")
        assert films[1].offset - films[0].offset == pytest.approx(0.45, abs=0.02)
        return Calibration(())

    monkeypatch.setattr(joint_rig, "find_clocks", find)
    monkeypatch.setattr(joint_rig, "calibrate_joint_films", of_joints)
    _, clocks = joint_rig.calibrate_unsynchronized_films(run, tmp_path, films)

    assert steps == ["clocks", "joints"] and clocks.by_sound
    assert clocks.clocks["cam01"][0] - clocks.clocks["cam00"][0] == pytest.approx(0.45, abs=0.02)


# --- left for right


def test_a_run_of_images_with_left_for_right_is_found() -> None:
    (camera,) = around([30.0], TALL, 1680.0, distance=4.0)
    seen = filmed(camera, 0.0, 1, noise=2.0, swapped=(20, 33)).positions
    seen[25] = np.nan

    swapped = steady_sides(seen)

    expected = (np.arange(40) >= 20) & (np.arange(40) < 33)
    expected[25] = False
    assert (swapped == expected).sum() >= 38
    assert not steady_sides(np.full((40, 16, 2), np.nan)).any()
    straight = with_sides(seen, expected)
    assert np.array_equal(straight[[21, 5], 0], seen[[21, 5], [1, 0]], equal_nan=True)


@pytest.mark.parametrize("count", [3, 8])
def test_cameras_agree_who_has_left_for_right(count: int) -> None:
    cameras = around(np.linspace(0, 300, count).tolist(), TALL, 1680.0, distance=4.0)
    pixels = np.stack([filmed(camera, 0.0, i, noise=3.0).positions[:20] for i, camera in enumerate(cameras)])
    pixels[1, 4:15] = pixels[1, 4:15][:, OTHER_SIDE]
    matrices = {(i, j): fundamental(cameras[i], cameras[j]) for i in range(count) for j in range(i + 1, count)}

    swapped = agreed_sides(pixels, matrices, 30.0)

    assert swapped.shape == (count, 20)
    assert swapped[1, 4:15].mean() > 0.9
    assert swapped[1, :4].sum() + swapped[1, 15:].sum() == 0
    assert np.delete(swapped, 1, 0).sum() <= 1
