"""Finding the images that a scene's cameras took; and clips that a video program would show otherwise than training."""

import json
import unicodedata
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import plain_camera, scene_header
from support.films import copied, encode, number_of, numbered
from support.layouts.lists import opencv_entry, write_opencv
from support.layouts.rigs import easyvolcap
from support.small_captures import llff_row

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.video import decode
from frog_blender.engine.source_media.clips import Clip, camera_path, capture_folders, find_clips
from frog_blender.engine.source_media.undistorted_clips import Undistortion, clips_folder, undistortion

from .test_undistorted_clips import header_of


def header(names, *, layout="n3dv", shots=None, frames=8, path="", test=()):
    cameras = tuple(replace(plain_camera(), name=name) for name in names)
    shots = tuple(shots or [tuple(range(frames))] * len(names))
    said = {"camera_shots": shots, "test_cameras": tuple(test), "capture_path": path, "capture_format": layout}
    return scene_header(cameras, frames, **said)


def empty_files(folder, *names):
    for name in names:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(b"")
    return folder


@pytest.mark.parametrize(("named", "written"), [("NFC", "NFD"), ("NFD", "NFC")])
def test_accents_are_the_same_however_they_are_composed(tmp_path, named, written):
    name, file = unicodedata.normalize(named, "caméra"), f"{unicodedata.normalize(written, 'caméra')}.mp4"
    clips = find_clips(header([name]), empty_files(tmp_path, file))
    assert clips == {name: Clip(tmp_path / file, "VIDEO", count=8)}


@pytest.mark.parametrize("layout", ["n3dv", "calibrated_videos"])
def test_videos_by_their_names(tmp_path, layout):
    folder = empty_files(tmp_path, "cam00.mp4", "cam02.MOV", "notes.txt", ".cam01.mp4")
    clips = find_clips(header(["cam00", "cam01", "cam02"], layout=layout), folder)
    assert clips == {
        "cam00": Clip(folder / "cam00.mp4", "VIDEO", count=8),
        "cam02": Clip(folder / "cam02.MOV", "VIDEO", count=8),
    }


def test_chapters_of_a_film_are_no_clip(tmp_path):
    folder = empty_files(tmp_path, "GX010040.MP4", "GX020040.MP4", "GX010041.MP4", "cam.mp4")
    assert list(find_clips(header(["GX010040", "GX010041", "cam"]), folder)) == ["GX010041", "cam"]


def test_other_layouts_are_opened_to_find_their_files(tmp_path):
    cameras = [camera.name for camera in easyvolcap(tmp_path)]
    clips = find_clips(header(cameras, layout="easyvolcap", frames=5), tmp_path)
    image = tmp_path / "images" / "00" / "000000.png"
    assert list(clips) == cameras and clips["00"] == Clip(image, "SEQUENCE", 0, 1, 5)
    assert find_clips(header(cameras, layout="easyvolcap", frames=5), tmp_path / "images") == clips


def moving(names, frames=None, **changes):
    frames = range(len(names)) if frames is None else frames
    return header(names, shots=[(frame,) for frame in frames], frames=max(frames) + 1, **changes)


@pytest.mark.parametrize(
    ("numbers", "frames", "expected"),
    [
        (["000", "001", "002", "003"], None, (0, 1)),
        (["7", "8", "9", "10"], None, (7, 1)),  # no leading zeros, more digits on the way
        (["01", "03", "07"], (1, 3, 7), (0, 1)),  # images that are missing
        (["30", "20", "10"], None, (30, -10)),
        (["001", "002", "004"], None, None),
    ],
)
def test_numbered_images_of_a_moving_camera(tmp_path, numbers, frames, expected):
    names = [f"left1_{number}" for number in numbers]
    folder = empty_files(tmp_path, *(f"rgb/2x/{name}.png" for name in names), "rgb/1x/left1_001.png")
    scene = moving(names, frames, layout="hypernerf")
    assert scene.is_moving
    clips = find_clips(scene, folder)
    if expected is None:
        assert not clips
    else:
        clip = Clip(folder / f"rgb/2x/{names[0]}.png", "SEQUENCE", *expected, count=scene.frame_count)
        assert clips == {names[0]: clip}


def test_listed_images(tmp_path):
    names = [f"images/f{i}" for i in range(3)]
    empty_files(tmp_path, *(f"{name}.png" for name in names))
    frames = [{"file_path": name, "transform_matrix": [[i]]} for i, name in enumerate(names)]
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    scene = moving([Path(name).name for name in names], layout="transforms")
    assert find_clips(scene, tmp_path) == {"f0": Clip(tmp_path / "images/f0.png", "SEQUENCE", 0, 1, 3)}
    (tmp_path / "transforms.json").write_text("{")
    assert not find_clips(scene, tmp_path)


def test_listed_images_of_standing_cameras(tmp_path):
    """Each is a sequence of its own; where an image's number is missing, its first image stands for it."""
    names = ["a_10", "b_20", "a_11", "b_21", "a_12", "b_23"]
    empty_files(tmp_path, *(f"{name}.png" for name in names))
    frames = [{"file_path": name, "time": i // 2, "transform_matrix": [[name[0]]]} for i, name in enumerate(names)]
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    scene = header(["a", "b"], layout="transforms", shots=[(0, 1, 2), (0, 1, 2)], frames=3)
    assert find_clips(scene, tmp_path) == {
        "a": Clip(tmp_path / "a_10.png", "SEQUENCE", 10, 1, 3),
        "b": Clip(tmp_path / "b_20.png", "IMAGE"),
    }


def test_nothing_there_is_nothing_found(tmp_path):
    assert not find_clips(header(["cam00"]), tmp_path / "nowhere")
    for layout in ("n3dv", "calibrated_videos", "transforms", "hypernerf", "technicolor", "of tomorrow"):
        assert not find_clips(header(["cam00"], layout=layout), tmp_path)


def test_folders_as_stored_and_near_the_scene(tmp_path):
    scene = tmp_path / "out" / "x.frog"
    assert capture_folders(header(["a"], path="/films/room"), scene) == [
        Path("/films/room"),
        scene.parent / "room",
        scene.parent,
        tmp_path / "room",
    ]
    assert scene.parent / "room" in capture_folders(header(["a"], path="D:\\films\\room"), scene)
    assert capture_folders(header(["a"]), scene) == []


@pytest.mark.parametrize("path", [f"{begin}server/share/room" for begin in ("\\\\", "//", "\\\\?\\UNC\\")])
def test_a_file_does_not_make_a_computer_call_another(tmp_path, path):
    folders = capture_folders(header(["a"], path=path), tmp_path / "x.frog")
    assert folders and all(folder.is_relative_to(tmp_path.parent) for folder in folders)


def test_the_path_of_a_moving_camera_prefers_what_was_trained_on():
    scene = header(["a", "b", "c"], shots=[(0,), (1,), (1,)], frames=2, test=["b"])
    assert [(frame, camera.name) for frame, camera in camera_path(scene)] == [(0, "a"), (1, "c")]
    assert np.all([scene.is_moving, not header(["a", "b"]).is_moving])


@pytest.fixture
def film(tmp_path: Path) -> Path:
    return encode(tmp_path / "film.mp4", numbered(20), key_every=5)


def calibrated(folder: Path, **changes: dict[str, Any]) -> Path:
    cameras = [replace(plain_camera(64, 48, 50.0), name=name) for name in ("a", "b")]
    return write_opencv(folder, [opencv_entry(camera, **changes.get(camera.name, {})) for camera in cameras])


def n3dv(folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    np.save(folder / "poses_bounds.npy", [llff_row(48, 64, 50.0)] * 2)
    return folder


def with_films(folder: Path, film: Path, names: str = "ab") -> Path:
    for name in names:
        (folder / f"{name}.mp4").write_bytes(film.read_bytes())
    return folder


def needed(folder: Path) -> Undistortion | None:
    """What has to be written for the scene ``c.frog`` beside the capture."""
    return undistortion(header_of(open_capture(folder)), folder.with_suffix(".frog"), folder)


def written(folder: Path, name: str, frames: Iterable[int]) -> list[int]:
    """The numbers that images of a clip show."""
    films = needed(folder)
    if films is not None:
        list(films.steps)
    return [number_of(image) for image in decode(clips_folder(folder.with_suffix(".frog")) / f"{name}.mp4", frames)]


@pytest.mark.parametrize("layout", [calibrated, n3dv])
def test_clips_of_films_that_lack_frames_show_each_image_at_its_time(film: Path, tmp_path: Path, layout: Any) -> None:
    folder = with_films(layout(tmp_path / "c"), film, "a")
    there = [frame for frame in range(20) if frame not in (4, 5, 11)]
    encode(folder / "b.mp4", [numbered(20)[frame] for frame in there], times=[frame / 30 for frame in there])
    shown = [0, 1, 2, 3, 3, 3, 6, 7, 8, 9, 10, 10, *range(12, 20)]
    assert written(folder, "b", range(20)) == shown, "the image before stays in a gap"


@pytest.mark.parametrize("layout", [calibrated, n3dv])
def test_plain_films_are_shown_as_they_are(film: Path, tmp_path: Path, layout: Any) -> None:
    assert needed(with_films(layout(tmp_path / "c"), film)) is None


def test_a_late_clock_and_high_dynamic_range_need_clips(film: Path, tmp_path: Path) -> None:
    late = with_films(calibrated(tmp_path / "late", b={"offset": 0.1}), film)
    assert (written(late, "a", [5]), written(late, "b", [5])) == ([8], [5])
    bright = calibrated(tmp_path / "bright")
    for name in ("a", "b"):
        encode(bright / f"{name}.mp4", numbered(4), transfer="pq")
    assert needed(bright) is not None


def test_trimmed_films_need_no_clips(film: Path, tmp_path: Path) -> None:
    folder = calibrated(tmp_path / "c")
    for name in ("a", "b"):
        copied(film, folder / f"{name}.mp4", start=0.2)
    assert needed(folder) is None


def test_films_that_a_calibration_names_are_found(film: Path, tmp_path: Path) -> None:
    folder = with_films(calibrated(tmp_path / "c", a={"video": "../film.mp4"}), film, "b")
    clips = find_clips(header_of(open_capture(folder)), folder)
    assert {name: clip.path.resolve() for name, clip in clips.items()} == {"a": film, "b": folder / "b.mp4"}
