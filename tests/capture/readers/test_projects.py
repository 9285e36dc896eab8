"""Projects as caliscope, anipose, sleap-anipose, freemocap, Pose2Sim, Qualisys and cards lay them out."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from support.builders import refused
from support.filmed_scene import FRAMES, image, rig
from support.layouts.files import write_films, write_image
from support.layouts.lists import opencv_entry, write_opencv
from support.layouts.rigs import qualisys, toml_cameras

from frog_blender.engine.capture.readers import detect, open_capture
from frog_blender.engine.capture.synchronization.films import find_films

from .reading import assert_same_images, refuses

VIEWS = ("back", "mid", "side", "top")
_CALISCOPE, _POSE2SIM = ("camera_array.toml", "{i}"), ("calibration/Calib_scene.toml", "int_cam{one:02d}_img")
_ANIPOSE = ("calibration/calibration.toml", "{letter}")
_EXTRINSIC = "calibration/extrinsic"
_VOLUME, _PIPELINE = f"{_EXTRINSIC}/capture_volume/camera_array.toml", "calibration-videos/calibration.toml"
LAYOUTS = {
    "caliscope": (*_CALISCOPE, "recordings/walk/cam_{i}", "."),
    "caliscope's recording": (*_CALISCOPE, "recordings/walk/cam_{i}", "recordings/walk"),
    "caliscope's ports": ("config.toml", "{i}", "recordings/walk/port_{i}", "."),
    "caliscope's volume": (_VOLUME, "{i}", "recordings/a/cam_{i}", "recordings/a"),
    "caliscope's board": (*_CALISCOPE, f"{_EXTRINSIC}/cam_{{i}}", _EXTRINSIC),
    "anipose": (*_ANIPOSE, "videos-raw/2026-08-02-vid01-cam{letter}", "."),
    "anipose's default names": (*_ANIPOSE, "videos-raw/fly_{letter}", "videos-raw"),
    "anipose's pipeline": (_PIPELINE, "cam{i}88", "behavior-videos/cam{i}88_2026-08-02", "."),
    "anipose's numbers": (_ANIPOSE[0], "{one}", "videos-raw/vid1-cam{one}", "."),
    "sleap-anipose": ("calibration.toml", "{view}", "{view}/minimal_{view}", "."),
    "freemocap": ("rec_camera_calibration.toml", "Camera_{i:03d}", "synchronized_videos/Camera_{i:03d}", "."),
    "Pose2Sim": (*_POSE2SIM, "videos/cam{one:02d}", "."),
    "Pose2Sim's trial": (*_POSE2SIM, "Trial_1/videos/cam{one:02d}", "Trial_1"),
    "Pose2Sim's one trial": (*_POSE2SIM, "Trial_1/videos/cam{one:02d}", "."),
    "Qualisys": ("calibration/Calib.qca.txt", "cam{one:02d}", "videos/cam{one:02d}", "."),
    "Qualisys' serials": ("Calib.qca.txt", "2{one}07", "walk_Miqus_{one}_2{one}07", "."),
    "takes": ("calibration.toml", "{one}", "{one}-2", "."),
    "takes before": ("calibration.toml", "{one}", "videos/2-{one}", "."),
    "zeros": ("cameras_opencv.json", "cam{eight}", "cam{eight:02d}", "."),
    "zeros in parts": ("calibration.toml", "cam{eight:02d}", "vid_cam{eight}", "."),
    "clocks": ("Calib.qca.txt", "{one}", "cam_{one}_12000{back}", "."),
    "cards": ("cameras_opencv.json", "{letter}", "{letter}/C0001", "."),
    "Sony's cards": ("cameras_opencv.json", "{letter}", "{letter}/PRIVATE/M4ROOT/CLIP/C0001", "."),
}


def named(pattern: str) -> list[str]:
    views = enumerate(VIEWS)
    return [pattern.format(i=i, one=i + 1, eight=i + 8, back=4 - i, letter="ABCD"[i], view=view) for i, view in views]


def lay_out(folder: Path, calibration: str, names: Sequence[str], films: Sequence[str]) -> None:
    """Films of the rig, and its calibration in which the cameras have these names."""
    cameras = [replace(camera, name=name) for camera, name in zip(rig(), names, strict=True)]
    for camera, film in zip(rig(), films, strict=True):
        (folder / film).parent.mkdir(parents=True, exist_ok=True)
        write_films(folder, [camera], f"{film}.avi")
    file = folder / calibration
    file.parent.mkdir(parents=True, exist_ok=True)
    if file.suffix == ".json":
        write_opencv(folder, map(opencv_entry, cameras))
    else:
        tables = toml_cameras(cameras, 'cameras."{name}"', "")
        file.write_text(qualisys(cameras) if file.suffix == ".txt" else tables)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_camera_shows_what_it_filmed(layout: str, tmp_path: Path) -> None:
    calibration, names, films, opened = LAYOUTS[layout]
    lay_out(tmp_path / "project", calibration, named(names), named(films))
    capture = open_capture(tmp_path / "project" / opened)
    assert (len(capture.cameras), capture.frame_count, capture.warnings) == (4, FRAMES, ())
    assert_same_images(capture, tmp_path / "cache", image)


def test_a_calibration_above_is_found_whatever_is_said_of_names(tmp_path: Path) -> None:
    calibration, names, films, opened = LAYOUTS["caliscope's recording"]
    lay_out(tmp_path, calibration, named(names), named(films))
    refused(r"camera_array\.toml: --layout moments does not fit", open_capture, tmp_path / opened, layout="moments")


SEVERAL = {
    "caliscope": ("camera_array.toml", "{i}", "recordings/{{}}/cam_{i}", "recordings/{}"),
    "anipose": ("calibration/calibration.toml", "{letter}", "videos-raw/{{}}-cam{letter}", "videos-raw/{}"),
    "Pose2Sim": ("calibration/Calib_scene.toml", "int_cam{one:02d}_img", "{{}}/videos/cam{one:02d}", "{}"),
    "folders": ("calibration.toml", "cam{one}", "cam{one}/{{}}", "{}"),
    "frog calibrate": ("cameras_opencv.json", "cam{one}", "cam{one}_{{}}", "{}"),
}


@pytest.mark.parametrize("layout", SEVERAL)
def test_of_several_recordings_one_is_chosen_by_its_path(layout: str, tmp_path: Path) -> None:
    calibration, names, films, path = SEVERAL[layout]
    for take in ("walk1", "walk2"):
        lay_out(tmp_path, calibration, named(names), [film.format(take) for film in named(films)])
    refuses(tmp_path, rf"found 2 recordings \(walk1 and walk2\), expected .* one of them, as .*{path.format('walk1')}")
    capture = open_capture(tmp_path / path.format("walk2"))
    filmed = {tmp_path / f"{film.format('walk2')}.avi" for film in named(films)}
    assert {shot.path for shot in capture.shots} == filmed and detect(capture.path) == capture.format
    refuses(tmp_path / path.format("walk3"), "there is no such folder")


SHIFTED = {"c{i}": "videos/port_{one}", "{i}": "vid_cam{one}", "cam{i}": "cam{one}", "cam{i:02d}": "cam{one:02d}"}


@pytest.mark.parametrize("names", SHIFTED)
def test_numbers_that_may_be_counted_from_elsewhere_are_asked_for(tmp_path: Path, names: str) -> None:
    films = named(SHIFTED[names])
    lay_out(tmp_path, "Calib.qca.txt" if names == "cam{i}" else "calibration.toml", named(names), films)
    refuses(tmp_path, "may be counted from different numbers, .*: rename it, or take [a-z_-]*0?4 away")
    (tmp_path / f"{films[3]}.avi").unlink()
    capture = open_capture(tmp_path)
    assert len(capture.cameras) == 3 and "1 of 4 cameras are left out" in capture.warnings[0]


@pytest.mark.parametrize("films", [("1-2", "2-3", "3-4", "4-1"), ("1-1", "1-2", "2-1", "2-2")])
def test_names_of_which_either_number_may_be_the_cameras_join_nothing(tmp_path: Path, films: Sequence[str]) -> None:
    lay_out(tmp_path, "calibration.toml", named("{one}"), films)
    refuses(tmp_path, "expected footage of the cameras' names")


def test_of_calibrations_that_differ_the_films_own_is_taken_or_the_user_asked(tmp_path: Path) -> None:
    names = [camera.name for camera in rig()]
    lay_out(tmp_path, "b.toml", names, names)
    others = [replace(camera, name=name) for camera, name in zip(rig(), VIEWS, strict=True)]
    (tmp_path / "a.toml").write_text(toml_cameras(others, "{name}", ""))
    assert [camera.name for camera in open_capture(tmp_path).cameras] == names
    (tmp_path / "calibration").mkdir()
    (tmp_path / "calibration" / "c.toml").write_text(toml_cameras(rig(), "{name}", ""))
    refuses(tmp_path, r"found 2 calibrations that differ \(b.toml, c.toml\), expected one: move")


def test_a_calibration_above_is_not_that_of_other_films(tmp_path: Path) -> None:
    lay_out(tmp_path, "calibration.toml", named("{view}"), named("{view}"))
    write_films(tmp_path / "other", rig())
    refuses(tmp_path / "other", "4 videos without calibration")
    (tmp_path / "damaged.toml").write_text("[")
    assert len(open_capture(tmp_path).cameras) == 4


def test_the_films_of_cards_are_calibrated(tmp_path: Path) -> None:
    cards = [tmp_path / name / "DCIM" / "100" / "GX01.avi" for name in "ABCD"]
    for card, camera in zip(cards, rig(), strict=True):
        card.parent.mkdir(parents=True)
        write_films(card.parent, [camera], card.name)
    assert [(film.name, film.path) for film in find_films(tmp_path)] == list(zip("ABCD", cards, strict=True))
    refuses(tmp_path, "4 videos without calibration, expected .*frog calibrate")
    write_image(tmp_path / "B" / "still_1.jpg", image(rig()[0], 0))
    assert find_films(tmp_path)[1].path == cards[1]
    write_films(cards[0].parent, rig()[:1], "GX02.avi")
    refused(r"2 recordings \(GX01 and GX02\)", find_films, tmp_path)
    assert [film.path for film in find_films(tmp_path / "GX01")] == cards
    refuses(tmp_path / "GX01", r"4 videos without calibration, expected .*frog calibrate .*/GX01`")
