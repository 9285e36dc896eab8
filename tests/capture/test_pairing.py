"""Films of several cameras by the times of their images: what was dropped, starts late, runs fast or varies."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.films import INTERLACED, copied, encode, number_of, numbered, sliding
from support.layouts.lists import write_opencv

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.readers.footage import Footage
from frog_blender.engine.capture.readers.pairing import Clock, pair_videos
from frog_blender.engine.capture.video import VideoFacts
from frog_blender.engine.errors import FrogError
from frog_blender.engine.frames.store import FrameStore

from .readers.reading import refuses
from .test_calibrated_videos import opencv


def facts(times: np.ndarray, rate: float = 30.0) -> VideoFacts:
    return VideoFacts(64, 48, len(times), rate, np.asarray(times, np.float64))


def paired(*films: VideoFacts, clocks: list[Clock] | None = None) -> Any:
    videos = [Footage(f"cam{index}", (Path(f"cam{index}.mp4"),)) for index in range(len(films))]
    for video, film in zip(videos, films, strict=True):
        vars(video).update(facts=film, _chapters=[film])  # nothing is decoded
    return pair_videos(Path("c"), videos, clocks)


def times_of(pairing: Any, camera: int) -> np.ndarray:
    """Seconds after the capture's frame 0 of a camera's images."""
    shots = [shot for shot in pairing.shots if shot.camera == camera]
    return np.array([(shot.frame + shot.offset) / pairing.frames_per_second for shot in shots])


def start_of(pairing: Any) -> float:
    """Seconds after the capture's frame 0 at which film 0, of 30 images a second, starts."""
    first = next(shot for shot in pairing.shots if shot.camera == 0)
    return (first.frame + first.offset) / pairing.frames_per_second - first.index / 30


def indices_of(pairing: Any, camera: int) -> np.ndarray:
    return np.array([shot.index for shot in pairing.shots if shot.camera == camera])


@pytest.mark.parametrize("rounding", [None, 3, 2.5])
def test_films_in_step_keep_the_numbers_of_their_frames(rounding: float | None) -> None:
    """Stamps may be whole milliseconds (Matroska), or waver by a quarter of one (phones)."""
    times = np.arange(100) / 29.97
    if rounding == 3:
        times = times.round(3)
    elif rounding is not None:
        times = times + np.random.default_rng(0).uniform(-0.00025, 0.00025, 100)
    pairing = paired(facts(times, 29.97), facts(np.arange(90) / 29.97, 29.97))
    assert [(shot.camera, shot.frame, shot.index, shot.offset) for shot in pairing.shots] == [
        (camera, frame, frame, 0.0) for frame in range(90) for camera in range(2)
    ]
    assert (pairing.frame_count, pairing.frames_per_second) == (90, 29.97)
    assert len(pairing.warnings) == 1
    assert "different lengths (cam1.mp4 90 frames, cam0.mp4 100)" in pairing.warnings[0]


def test_a_slower_rate_keeps_its_times() -> None:
    """29.97 beside two of 30: after 16 s they are half a frame apart."""
    pairing = paired(facts(np.arange(600) / 30), facts(np.arange(600) / 29.97, 29.97), facts(np.arange(600) / 30))
    assert pairing.frames_per_second == 30
    np.testing.assert_allclose(np.diff(times_of(pairing, 1)), 1 / 29.97, atol=0.002)
    assert max(abs(shot.offset) for shot in pairing.shots) <= 0.5
    assert {shot.offset for shot in pairing.shots if shot.camera != 1} == {0.0}
    assert any("rates differ (29.97 to 30 a second)" in warning for warning in pairing.warnings)


def test_a_rate_that_varies_keeps_every_time() -> None:
    random = np.random.default_rng(3)
    times = np.sort(np.arange(120) / 30 + random.uniform(-0.008, 0.008, 120))
    pairing = paired(facts(np.arange(120) / 30), facts(times, 29.9))
    np.testing.assert_allclose(times_of(pairing, 1) - start_of(pairing), times[indices_of(pairing, 1)], atol=0.001)
    assert any("frame rate of cam1.mp4 varies" in warning for warning in pairing.warnings)


def test_a_film_that_starts_late_is_late() -> None:
    pairing = paired(facts(np.arange(60) / 30), facts(0.51 + np.arange(60) / 30))
    assert indices_of(pairing, 0)[0] in (15, 16)
    late = times_of(pairing, 1) - start_of(pairing) - indices_of(pairing, 1) / 30
    np.testing.assert_allclose(late, 0.51, atol=0.001)
    assert any("cam1.mp4 starts 0.510 s after cam0.mp4" in warning for warning in pairing.warnings)


def test_clocks_shift_and_stretch_films() -> None:
    """Film 1 started 0.35 s after the capture, and its clock runs 0.1 % slow."""
    clocks = [Clock(), Clock(0.35, 1.001)]
    pairing = paired(facts(np.arange(900) / 30), facts(np.arange(900) / 30), clocks=clocks)
    expected = 0.35 + 1.001 * indices_of(pairing, 1) / 30
    np.testing.assert_allclose(times_of(pairing, 1) - start_of(pairing), expected, atol=0.001)
    assert not any("as their files say" in warning for warning in pairing.warnings)


def test_no_image_lies_beside_the_time_that_the_capture_has() -> None:
    """What was filmed a part of a frame before the first or after the last one would be learned at another time."""
    clocks = [Clock(), Clock(-0.4 / 30), Clock(0.3 / 30), Clock(2.45 / 30)]
    pairing = paired(*[facts(np.arange(30) / 30)] * 4, clocks=clocks)
    last = (pairing.frame_count - 1) / 30
    for camera, clock in enumerate(clocks):
        found = times_of(pairing, camera)
        assert found.min() >= 0 and found.max() <= last
        every = start_of(pairing) + clock.offset + np.arange(30) / 30
        inside = every[(every > -1e-9) & (every < last + 1e-9)]
        np.testing.assert_allclose(found, inside, atol=1e-9, err_msg="and all the others are there")


def test_films_of_different_times_are_refused() -> None:
    with pytest.raises(FrogError, match=r"cam0.mp4 ends at 0.97 s and cam1.mp4 starts at 5.00 s"):
        paired(facts(np.arange(30) / 30), facts(np.arange(30) / 30), clocks=[Clock(), Clock(5)])


def test_a_time_that_half_of_the_films_show_is_used() -> None:
    """One film of four starts late, and one ends early: the others lose nothing."""
    clocks = [Clock(), Clock(), Clock(1.0), Clock(-0.5)]
    pairing = paired(*[facts(np.arange(60) / 30)] * 4, clocks=clocks)
    assert pairing.frame_count == 60
    seen = {camera: [shot.frame for shot in pairing.shots if shot.camera == camera] for camera in range(4)}
    assert seen == {0: [*range(60)], 1: [*range(60)], 2: [*range(30, 60)], 3: [*range(45)]}
    assert "the 60 frames that at least 2 of them show are used" in pairing.warnings[0]


def test_frames_at_one_time_do_no_harm() -> None:
    """As damaged headers have them."""
    pairing = paired(facts(np.zeros(5)), facts(np.array([0, 0, 1 / 30, 1 / 30, 1])))
    assert {(shot.camera, shot.frame) for shot in pairing.shots} == {(0, 0), (1, 0)}
    assert all(np.isfinite(shot.offset) for shot in pairing.shots)


# From files -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return encode(tmp_path_factory.mktemp("film") / "film.mp4", numbered(60), key_every=15)


def shows(capture: Capture, cache: Path, camera: int) -> dict[int, int]:
    """By frame the number of the image that a camera shows."""
    store = FrameStore.open(capture, cache_folder=cache)
    shots = enumerate(capture.shots)
    return {shot.frame: number_of(store.image(index)) for index, shot in shots if shot.camera == camera}


def plain(name: str, **changes: Any) -> dict[str, Any]:
    return opencv(name, dist=[], **changes)


def test_two_cameras_of_which_one_dropped_frames_show_the_same_times(film: Path, tmp_path: Path) -> None:
    there = [frame for frame in range(60) if frame not in (7, 8, 31)]
    (tmp_path / "a.mp4").write_bytes(film.read_bytes())
    encode(tmp_path / "b.mp4", [numbered(60)[frame] for frame in there], times=[frame / 30 for frame in there])
    capture = open_capture(write_opencv(tmp_path, [plain("a"), plain("b")]))
    assert shows(capture, tmp_path / "cache", 0) == {frame: frame for frame in range(60)}
    assert shows(capture, tmp_path / "cache", 1) == {frame: frame for frame in there}
    assert (capture.frame_count, {shot.offset for shot in capture.shots}) == (60, {0.0})
    assert "3 frames of b.mp4 are missing" in capture.warnings[0]


def test_a_calibration_may_name_films_and_their_clocks(film: Path, tmp_path: Path) -> None:
    (tmp_path / "films").mkdir()
    (tmp_path / "found").mkdir()
    for name in ("one", "two"):
        (tmp_path / "films" / f"{name}.mp4").write_bytes(film.read_bytes())
    cameras = [
        plain("a", video="../films/one.mp4"),
        plain("b", video=str(tmp_path / "films" / "two.mp4"), offset=0.2 + 1 / 120),
    ]
    capture = open_capture(write_opencv(tmp_path / "found", [*cameras]))
    assert [camera.name for camera in capture.cameras] == ["a", "b"]
    found = [shows(capture, tmp_path / "cache", camera) for camera in range(2)]
    assert {found[0][frame] - found[1][frame] for frame in found[0] if frame in found[1]} == {6}
    late = {camera: {shot.offset for shot in capture.shots if shot.camera == camera} for camera in range(2)}
    assert np.ptp([*late[0], *late[1]]) == pytest.approx(0.25, abs=1e-6)


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"video": "nowhere.mp4"}, r"nowhere.mp4: found no file, expected the video of camera a"),
        ({"video": "//server/film.mp4"}, "as the video of camera a"),
        ({"offset": "soon"}, "offset of camera a that is not made of numbers"),
        ({"rate": 1e5}, "rate of camera a = 100000"),
    ],
)
def test_clocks_and_films_that_make_no_sense_are_refused(
    film: Path, tmp_path: Path, changes: dict[str, Any], found: str
) -> None:
    (tmp_path / "a.mp4").write_bytes(film.read_bytes())
    refuses(write_opencv(tmp_path, [plain("a", **changes)]), found)


@pytest.mark.parametrize("turn", [90, 270])
def test_a_film_turned_after_its_calibration_turns_its_camera(film: Path, tmp_path: Path, turn: int) -> None:
    """Whatever lies at a world point lies at its pixel in the image that is shown."""
    copied(film, tmp_path / "a.mp4", turn=turn)
    lens = [-0.1, 0.01, 0.02, -0.03, 0.005]
    (tmp_path / "plain").mkdir()
    (tmp_path / "plain" / "a.mp4").write_bytes(film.read_bytes())
    straight = open_capture(write_opencv(tmp_path / "plain", [opencv("a", dist=lens)]))
    capture = open_capture(write_opencv(tmp_path, [opencv("a", dist=lens)]))
    camera, before = capture.cameras[0], straight.cameras[0]
    assert (camera.width, camera.height) == (48, 64)
    assert "before its rotation flag turned it by" in capture.warnings[0]
    pixels = np.array([[10.0, 20.0], [50.0, 5.0]])
    points = before.unproject(pixels, np.array([3.0, 4.0]))
    x, y = pixels.T
    expected = np.stack([y, 64 - x] if turn == 90 else [48 - y, x], axis=1)  # ffmpeg counts against the clock
    np.testing.assert_allclose(camera.project(points)[0], expected, atol=1e-9)
    shown = FrameStore.open(capture, cache_folder=tmp_path / "cache").image(3)
    unturned = FrameStore.open(straight, cache_folder=tmp_path / "cache").image(3)
    found = np.rot90(unturned, 1 if turn == 90 else -1)
    assert np.abs(shown.astype(int) - found)[3:-3, 3:-3].mean() < 2  # distortion is removed alike


@pytest.mark.parametrize(
    ("size", "sentence"),
    [
        ((48, 64), r"64 x 48 pixels, calibrated at 48 x 64, expected the same way up: .* turned by 90 degrees"),
        ((60, 48), "expected the calibrated image, that image resized, or a part of it"),
    ],
)
def test_a_film_larger_than_its_calibration_is_no_crop(
    film: Path, tmp_path: Path, size: tuple[int, int], sentence: str
) -> None:
    (tmp_path / "a.mp4").write_bytes(film.read_bytes())
    refuses(write_opencv(tmp_path, [plain("a", width=size[0], height=size[1])]), sentence)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "a.mp4 (of 1 such) is turned by 180 degrees, as the file says"),
        ({"transfer": "hlg"}, "a.mp4 is of high dynamic range (HLG) and is tone-mapped"),
        (INTERLACED, "a.mp4 is interlaced: of the two times that each image shows the first is taken"),
    ],
)
def test_what_is_unusual_about_a_film_is_said(tmp_path: Path, options: dict[str, Any], said: str) -> None:
    (tmp_path / "made").mkdir()
    made = encode(tmp_path / "made" / "film.mp4", [sliding(0, 64, 48)] * 3, **options)
    copied(made, tmp_path / "a.mp4", turn=0 if options else 180)
    assert said in open_capture(write_opencv(tmp_path, [plain("a")])).warnings[0]


def test_skew_is_removed_like_distortion(film: Path, tmp_path: Path) -> None:
    (tmp_path / "a.mp4").write_bytes(film.read_bytes())
    capture = open_capture(write_opencv(tmp_path, [plain("a", K=[[50, 2.5, 30], [0, 51, 25], [0, 0, 1]])]))
    assert capture.distortions[0].skew == pytest.approx(0.05)
    assert capture.cameras[0].intrinsics[0, 1] == 0
