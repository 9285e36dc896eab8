"""Frames of posed images: from stated times, and from the numbers in their names."""

from pathlib import Path

import numpy as np
import pytest
from support.films import photograph
from support.layouts.lists import posed, write_listed

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.readers.footage import Footage
from frog_blender.engine.capture.readers.frame_times import counted_apart, frame_times, times_by_name
from frog_blender.engine.capture.readers.pairing import pair_footage

from .readers.reading import refuses


def frames_of(times: list[float], lists: list[int] | None = None) -> tuple[list[int], list[float]]:
    found = frame_times(times, lists or [0] * len(times), Path("c"))
    assert not found.warnings
    return found.frames.tolist(), found.offsets.tolist()


@pytest.mark.parametrize("unit", [1.0, 1 / 23, 1e9 / 30, 0.033367])
def test_equal_steps_are_frames_and_gaps_stay(unit: float) -> None:
    there = [0, 1, 2, 7, 8, 23, 3]
    times = [round(1.7 * unit + unit * frame, 6) for frame in there]
    assert frames_of(times) == (there, [0.0] * 7)


def test_times_in_no_equal_steps_keep_their_fractions() -> None:
    """Held-out images between those to train on, as D-NeRF has them."""
    train, test = [frame / 20 for frame in range(21)], [0.12, 0.51, 0.77]
    frames, offsets = frames_of(train + test, [0] * 21 + [1] * 3)
    assert frames == [*range(21), 2, 10, 15]
    np.testing.assert_allclose(offsets[:21], 0, atol=1e-9)
    np.testing.assert_allclose(offsets[21:], [0.4, 0.2, 0.4], atol=1e-9)


@pytest.mark.parametrize("test", [[-0.3], [9.4], [-0.4, 4.2, 9.2], [-2.3, 11.45]])
def test_images_before_and_after_those_to_train_on_keep_their_times(test: list[float]) -> None:
    times = np.array([*range(10), *test])
    found = frame_times(times.tolist(), [0] * 10 + [1] * len(test), Path("c"))
    late = found.frames + found.offsets
    assert late.min() >= 0 and late.max() <= found.count - 1, "a capture has no time before and after its frames"
    np.testing.assert_allclose(late - late[0], times, atol=1e-9)
    assert not found.offsets[:10].any()
    assert found.count <= np.ceil(np.ptp(times)) + 2


def test_times_far_apart_are_no_film() -> None:
    found = frame_times([0.0, 1e-3, 1e9, 5e9], [0] * 4, Path("c"))
    assert found.warnings and found.frames.tolist() == [0, 1, 2, 3] and not found.offsets.any()


@pytest.mark.parametrize(
    ("names", "times"),
    [
        (["f_0010.png", "f_0002.png", "f_0001.png"], [10, 2, 1]),
        (["take2/1.png", "take2/3.png"], [1, 3]),
        (["b.png", "a10.png", "a9.png"], [2, 1, 0]),
        (["x1y.png", "x01y.png"], [1, 0]),
    ],
)
def test_one_moving_camera_follows_its_names(names: list[str], times: list[int]) -> None:
    assert times_by_name(Path("c"), names, range(len(names)))[0] == times


def test_counters_of_their_own_are_counted_from_the_first_and_said() -> None:
    counted, told = counted_apart(Path("c"), {"a": [412, 415], "b": [1733, 1734], "c": [1735], "d": [413]})
    assert counted == [[0, 3], [0, 1], [0], [1]] and "a (412 to 415) and c (1735 to 1735) share no numbers" in told
    numbers = {"a": (412, 413, 415), "b": (1733, 1734)}
    names = [f"{camera}/DSC_{number}" for camera, own in numbers.items() for number in own]
    assert times_by_name(Path("c"), names, "aaabb")[0] == [0, 1, 3, 0, 1]
    pairing = pair_footage(Path("c"), [Footage(name, (Path(),) * len(own), own) for name, own in numbers.items()])
    assert [shot.frame for shot in pairing.shots] == [0, 1, 3, 0, 1] and "share no numbers" in pairing.warnings[0]


# From files -------------------------------------------------------------------------------------------------------


NAMES = [f"images/frame_{number:05d}.png" for number in range(1, 25)]
SOLVED = [index for index in range(24) if not 8 <= index <= 15]


def opened(folder: Path, files: list[str], listed: list[dict[str, object]]) -> Capture:
    write_listed(folder, files, listed)
    return open_capture(folder)


def by_frame(capture: Capture) -> dict[int, str]:
    return {shot.frame: shot.path.name for shot in capture.shots}


@pytest.mark.parametrize("case", ["time", "unlisted", "missing"])
def test_what_was_not_solved_stays_a_gap(tmp_path: Path, case: str) -> None:
    files = [NAMES[index] for index in SOLVED] if case == "missing" else NAMES
    listed = range(24) if case == "missing" else SOLVED
    frames = [posed(NAMES[index], index, **({"time": index / 23} if case == "time" else {})) for index in listed]
    capture = opened(tmp_path, files, frames)
    assert capture.frame_count == 24 and capture.is_moving
    assert by_frame(capture) == {index: Path(NAMES[index]).name for index in SOLVED}
    assert capture.test_frames == {4, 12, 20}


def test_moving_cameras_in_folders_without_times_are_said(tmp_path: Path) -> None:
    files = ["a/1.png", "b/1.png", "a/2.png"]
    capture = opened(tmp_path, files, [posed(name, index) for index, name in enumerate(files)])
    assert [str(shot.path.relative_to(tmp_path)) for shot in capture.shots] == files
    assert 'no "time" says when images were taken; they are taken for 2 cameras of 2 moments' in capture.warnings[0]
    assert [shot.frame for shot in capture.shots] == [0, 0, 1]


# Lenses -----------------------------------------------------------------------------------------------------------


def test_the_rational_model_has_eight_coefficients(tmp_path: Path) -> None:
    lens = dict(zip(("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"), np.arange(1, 9) / 100, strict=True))
    write_listed(tmp_path, NAMES[:1], [posed(NAMES[0], 0)], camera_model="FULL_OPENCV", **lens)
    capture = open_capture(tmp_path)
    np.testing.assert_allclose(capture.distortions[0].coefficients, np.arange(1, 9) / 100)
    assert not capture.warnings
    write_listed(tmp_path, NAMES[:1], [posed(NAMES[0], 0)], k4=0.3)
    assert "taken for those of OpenCV's rational model" in open_capture(tmp_path).warnings[0]


@pytest.mark.parametrize("model", ["FOV", "THIN_PRISM_FISHEYE", "VR180_L", "nonsense"])
def test_lens_models_that_nobody_here_knows_are_refused(tmp_path: Path, model: str) -> None:
    write_listed(tmp_path, NAMES[:1], [posed(NAMES[0], 0)], camera_model=model, omega=0.9)
    refuses(tmp_path, f"found the camera model {model.upper()}, expected a perspective camera")


@pytest.mark.parametrize(
    ("lens", "unused"),
    [
        ({"camera_model": "OPENCV", "k1": 0.1, "s1": 0.02, "skew": 0}, "s1"),
        ({"camera_model": "OPENCV_FISHEYE", "k1": 0.1, "p1": 0.01, "sx1": 0.1}, "p1, sx1"),
    ],
)
def test_terms_of_a_lens_that_are_not_used_are_said(tmp_path: Path, lens: dict[str, object], unused: str) -> None:
    write_listed(tmp_path, NAMES[:1], [posed(NAMES[0], 0)], **lens)
    (warning,) = open_capture(tmp_path).warnings
    assert warning.endswith(f"the lens has {unused}, which are not used.")


def test_listed_masks_that_are_missing_are_said(tmp_path: Path) -> None:
    write_listed(tmp_path, NAMES[:2], [posed(NAMES[0], 0, mask_path="m.png"), posed(NAMES[1], 1)])
    assert "1 of 1 masks (mask_path) are missing" in open_capture(tmp_path).warnings[0]


def test_photographs_upside_down_are_said(tmp_path: Path) -> None:
    write_listed(tmp_path, [], [posed("a.png", 0)])
    photograph(tmp_path / "a.png", np.zeros((30, 40, 3), np.uint8), turned=3)
    assert "a.png (of 1 such) is turned by 180 degrees" in open_capture(tmp_path).warnings[0]


def test_photographs_that_were_calibrated_as_exif_turns_them_are_not_turned_again(tmp_path: Path) -> None:
    write_listed(tmp_path, [], [posed("a.png", 0)], w=30, h=40, k1=0.0)
    photograph(tmp_path / "a.png", np.zeros((30, 40, 3), np.uint8), turned=6)
    (camera,) = open_capture(tmp_path).cameras
    assert (camera.width, camera.height) == (30, 40)
    np.testing.assert_allclose(camera.rotation, np.eye(3), atol=1e-9)
