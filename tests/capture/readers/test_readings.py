"""Which camera and which time images have, by what says so; and, in one sentence, what is no capture."""

import json
import re
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from support.builders import refused
from support.filmed_scene import moving, rig, still
from support.layouts import rigs
from support.layouts.colmap import write_model
from support.layouts.files import write_films, write_frames, write_image
from support.layouts.lists import opencv_entry, write_opencv
from support.small_captures import llff_rows

from frog_blender.cli.main import main
from frog_blender.engine.capture.readers import detect, layout_of, open_capture
from frog_blender.engine.capture.readers.readings import Reading, View, chosen_layout, read_names
from frog_blender.engine.capture.video import read_image

from .reading import refuses

IMAGES = list(product(range(4), range(3)))  # cameras and times


def read(pattern: str, views: list[View] | None = None, layout: str = "auto") -> Reading:
    with chosen_layout(layout):
        return read_names(Path("x"), [pattern.format(c=c, t=t) for c, t in IMAGES], views or [], 4.0)


def is_right(reading: Reading) -> bool:
    """Whether the images of each camera are those that one took, and those of one time, of one."""
    pairs = list(zip(zip(reading.cameras, reading.times, strict=True), IMAGES, strict=True))
    cameras, times = ({(said[part], true[part]) for said, true in pairs} for part in (0, 1))
    return (len(cameras), len({*reading.cameras}), len(times), len({*reading.times})) == (4, 4, 3, 3)


BARE = ["{c:02}/{t:04}.png", "{t:04}/{c:02}.png", "{t}/images/{c}.png", "{c}_{t}.png", "{t:04}-{c:04}.png"]
"""Of which the numbers alone do not tell which are cameras."""


@pytest.mark.parametrize(
    ("pattern", "layout", "first"),
    [
        ("cam{c}/{t:04}.png", "a folder a camera", "cam0"),
        ("cam{c}/images/{t}.png", "a folder a camera", "cam0"),
        ("images/cam{c}/cam{c}_{t}.png", "a folder a camera", "cam0"),
        ("frame{t:04}/cam{c}.png", "a folder a moment", "cam0"),
        ("frame{t:06}/images/cam{c:02}.png", "a folder a moment", "cam00"),
        ("frame{t}/frame{t}_cam{c}.png", "a folder a moment", "cam0"),
        ("colmap_{t}/images/cam{c}.png", "a folder a moment", "cam0"),
        ("{t}/view_{c}.png", "a folder a moment", "view_0"),
        ("cam{c}_frame{t}.png", "camera_time", "cam0"),
        ("all/cam{c}_{t:03}.png", "camera_time", "cam0"),
        ("frame{t:04}_cam{c}.png", "time_camera", "cam0"),
        ("f{t}c{c}.png", "time_camera", "c0"),
    ],
)
def test_words_tell_cameras_from_times(pattern: str, layout: str, first: str) -> None:
    reading = read(pattern)
    assert (reading.layout, reading.cameras[0]) == (layout, first)
    assert is_right(reading) and reading.times[:3] == (0, 1, 2)


def standing(camera: int, time: int) -> np.ndarray:
    return rig()[camera].moved(np.full(3, 1e-4 * time), np.full(3, 1e-4 * time)).world_to_camera  # as COLMAP is off


def on_a_rig(camera: int, time: int) -> np.ndarray:
    return rig()[camera].world_to_camera @ moving()[time].world_to_camera


@pytest.mark.parametrize("pattern", BARE)
def test_poses_and_lenses_tell_them_and_nothing_else_is_asked(pattern: str) -> None:
    for pose in (standing, on_a_rig):
        assert is_right(read(pattern, [View(pose(c, t)) for c, t in IMAGES]))
    assert is_right(read(pattern, [View(kind=c % 2) for c, _ in IMAGES]))
    refused(r"4 cameras of 3 moments, if .*3 cameras of 4 moments, if|3 .*4 cameras of 3", read, pattern)
    says = "moments" if pattern.index("t") < pattern.index("c") else "cameras"
    assert is_right(read(pattern, layout=says))


@pytest.mark.parametrize(
    ("names", "choice", "is_told"),
    [
        (["cam2.png", "cam10.png"], "one-moment", False),
        (["left.png", "right.png"], "one-moment", True),
        (["frame_2.png", "frame_10.png"], "moving", False),
        (["IMG_2.jpg", "IMG_10.jpg"], "moving", True),
        (["cam0/2.png", "cam0/10.png"], "moving", False),
    ],
)
def test_images_of_one_camera_or_of_one_moment(names: list[str], choice: str, is_told: bool) -> None:
    reading = read_names(Path("x"), names)
    assert (reading.choice, bool(reading.doubt)) == (choice, is_told)
    assert choice == "one-moment" or reading.times[0] < reading.times[1]
    assert all(re.search(f"--layout {each}", reading.doubt) for each in ("moving", "one-moment") if is_told)


# From files -------------------------------------------------------------------------------------------------------


RIG = [camera.resized(16, 12) for camera in rig()]
FLAT = ["cam{c}_frame{t}.png", "frame{t:04}_cam{c}.png", "{c}_{t}.png", "{t:04}_{c:02}.png"]
NESTED = ["cam{c}/{t:03}.png", "frame{t:04}/cam{c}.png", "{t}/images/{c}.png", "{c:02}/images/{t}.png"]


def write(folder: Path, pattern: str) -> None:
    """Images that show which camera and time they are of."""
    for c, t in IMAGES:
        file = pattern.format(c=c, t=t, letter="abcd"[c], seconds=t / 4, word=("shy", "glad", "sad")[t])
        write_image(folder / file, np.full((12, 16, 3), (20 + 40 * c, 30 + 60 * t, 0), np.uint8))


def is_placed(folder: Path, layout: str = "auto") -> bool:
    """Whether every image has its pose and its time."""
    capture = open_capture(folder, layout=layout)
    placed = [(len(capture.cameras), capture.frame_count, len(capture.shots)) == (4, 3, 12)]
    for shot in capture.shots:
        red, green, _ = read_image(shot.path)[0, 0]
        pose, true = capture.cameras[shot.camera].world_to_camera, RIG[round((red - 20) / 40)].world_to_camera
        placed.append(np.allclose(pose, true, atol=1e-3) and shot.frame == round((green - 30) / 60))
    return all(placed)


def test_names_that_mislead_are_asked_for(tmp_path: Path) -> None:
    refused = {"cam{c}/{seconds}.png": "times 0.0 and 0.25", "{word}/cam{c}.png": "3 recordings .glad, sad and shy."}
    refused |= {"{seconds}_cam{c}.png": "times 0.0 and 0.25", "{letter}_{word}.png": "expected footage of the cameras'"}
    named = [opencv_entry(replace(camera, name=f"cam{c}")) for c, camera in enumerate(RIG)]
    for take, (pattern, said) in enumerate(refused.items()):
        write(write_opencv(tmp_path / f"take{take}", named), pattern)
        refuses(tmp_path / f"take{take}", said)
    for pattern in ("cam{c}/{t}.png", "board/cam{c}_{t}.png"):
        write(write_opencv(tmp_path / "beside", named), pattern)
    assert is_placed(tmp_path / "beside") and "left out: board" in open_capture(tmp_path / "beside").warnings[0]


@pytest.mark.parametrize("pattern", FLAT + NESTED)
def test_readers_place_images_of_any_names(tmp_path: Path, pattern: str) -> None:
    write(tmp_path / "colmap" / "images", pattern)
    names = [pattern.format(c=c, t=t) for c, t in IMAGES]
    poses = [RIG[c].moved(np.full(3, 1e-4 * t), np.full(3, 1e-4 * t)) for c, t in IMAGES]  # as COLMAP is off
    write_model(tmp_path / "colmap" / "sparse" / "0", names, poses)
    of_camera = re.findall(r"[a-z]*\{c.*?\}", pattern)[0]
    named = [opencv_entry(replace(camera, name=of_camera.format(c=c))) for c, camera in enumerate(RIG)]
    np.save(write_opencv(tmp_path / "opencv", named).parent / "rows.npy", llff_rows(RIG))
    for reader in ("opencv", "n3dv"):
        write(tmp_path / reader / ("images" if pattern in FLAT else "."), pattern)
    (tmp_path / "rows.npy").rename(tmp_path / "n3dv" / "poses_bounds.npy")
    assert [is_placed(tmp_path / reader) for reader in ("colmap", "opencv", "n3dv")] == [True, True, True]


@pytest.mark.parametrize(
    ("pattern", "models"),
    [
        ("frame{t:06}/images/cam{c:02}.png", ["sparse/0"]),
        ("{t:06}/images/{c:02}.png", ["sparse/0"]),
        ("frame{t:06}/images/cam{c:02}.png", ["frame000000/sparse/0"]),
        ("colmap_{t}/images/cam{c:02}.png", [f"colmap_{time}/sparse/0" for time in range(3)]),
        ("{t}/images/{c:02}.png", [f"{time}/sparse/0" for time in range(3)]),
    ],
)
def test_folders_of_moments_with_a_model(tmp_path: Path, pattern: str, models: list[str]) -> None:
    write(tmp_path, pattern)
    names = [Path(pattern.format(c=c, t=0)).name for c in range(4)]
    for model in models:
        write_model(tmp_path / model, names, RIG)
    assert is_placed(tmp_path) and not open_capture(tmp_path).warnings
    if len(models) > 1:  # models that do not agree are of captures of their own, if not named as those of moments
        write_model(tmp_path / models[-1], names, RIG[::-1])
        if pattern.startswith("colmap"):
            assert "the models of colmap_0 and colmap_2 differ" in open_capture(tmp_path).warnings[0]
        else:
            refuses(tmp_path, "3 captures one folder deeper")


def test_what_nothing_tells_is_asked_in_one_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    poses = [camera.moved(np.full(3, 0.2 * index), np.full(3, 0.3 * index)) for index, camera in enumerate(rig() * 3)]
    names = [f"{t}/{c}.png" for c, t in IMAGES]  # each camera was held by a hand of its own
    write_model(tmp_path / "sparse" / "0", names, [pose.resized(16, 12) for pose in poses])
    write(tmp_path / "images", "{t}/{c}.png")
    asked = (
        r"in 2 ways, say which: 3 cameras of 4 moments, if folders are cameras \(--layout cameras\); or 4 cameras of 3"
    )
    refuses(tmp_path, asked)
    assert open_capture(tmp_path, layout="moments").frame_count == 3
    assert main(["info", str(tmp_path), "--layout", "cameras"]) == 0
    assert re.search(r"frames +4\n", capsys.readouterr().out)
    refused(r"layout = 'other', expected one of auto, cameras", open_capture, tmp_path, layout="other")


def metashape(folder: Path) -> None:
    (folder / "cameras.xml").write_text('<?xml version="1.0"?>\n<document version="2.0.0">\n  <chunk label="1">\n')
    write_image(folder / "images" / "a.png", still("cam00", 0))


def zju(folder: Path) -> None:
    np.save(folder / "annots.npy", np.array([{"cams": 1}], dtype=object), allow_pickle=True)
    write_frames(folder, rig()[:2], "Camera_{name}/{frame:06d}.jpg")


def half_a_model(folder: Path) -> None:
    write_model(folder / "sparse" / "0", ["a.png"], rig()[:1])
    (folder / "sparse" / "0" / "images.bin").unlink()


def without_intrinsics(folder: Path) -> None:
    rigs.easyvolcap(folder)
    (folder / "intri.yml").unlink()


def two_captures(folder: Path) -> None:
    rigs.n3dv_nested(folder)
    (folder / "other").mkdir()
    rigs.caliscope(folder / "other")


def text(name: str, content: str = "x") -> Callable[[Path], None]:
    def write(folder: Path) -> None:
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text(content)

    return write


NEAR: dict[str, tuple[Callable[[Path], object], str]] = {
    "nothing": (lambda folder: None, "an empty folder"),
    "something": (text("a.txt"), "1 .txt file"),
    "raw videos": (lambda folder: write_films(folder, rig()), r"4 videos without calibration, .*`frog calibrate"),
    "frames": (lambda folder: write_frames(folder, rig()), r"4 folders of images without calibration, .*calibrate"),
    "images": (lambda folder: write_frames(folder, rig(), "images/{name}_{frame}.png"), r"20 images without calibr"),
    "Metashape": (metashape, r"cameras of Metashape \(cameras.xml\), .*Export Cameras > COLMAP"),
    "RealityCapture": (text("cameras.csv", "#name,x,y,alt\n"), r"cameras of RealityCapture .*Registration > COLMAP"),
    "ZJU-MoCap": (zju, r"annots.npy \(ZJU-MoCap\), which can run programs, .*intri.yml"),
    "half a model": (half_a_model, r"sparse/0/cameras.bin and no images.bin"),
    "extri.yml": (without_intrinsics, r"extri.yml and no intri.yml"),
    "transforms": (text("fox_transforms.json", "{}"), r"fox_transforms.json, expected the name transforms.json"),
    "Record3D": (text("metadata.json", "{}"), r"Record3D, expected a transforms\.json.*ns-process-data"),
    "Polycam": (text("keyframes/mesh.obj"), r"Polycam, expected a transforms\.json.*ns-process-data"),
    "archive": (text("scene.zip"), r"1 archive \(scene.zip\), expected a folder: unpack it"),
    "HEIC": (text("cam0/IMG_0001.HEIC"), r"found images in HEIC, expected PNG, .*magick mogrify"),
    "splats": (text("point_cloud.ply"), r"1 file of finished splats .*frog import"),
    "several": (two_captures, r"2 captures one folder deeper \(coffee_martini and other\), expected one of these"),
}


@pytest.mark.parametrize("name", NEAR)
def test_one_sentence_that_fits(name: str, tmp_path: Path) -> None:
    write, expected = NEAR[name]
    write(tmp_path)
    for call in (detect, open_capture):
        sentence = refused(expected, call, tmp_path)
        assert sentence.startswith(str(tmp_path)) and len(sentence) < 350


def test_a_file_names_the_folder_to_choose(tmp_path: Path) -> None:
    write_films(tmp_path, rig()[:1])
    (tmp_path / "a.txt").write_text("x")
    said = {"cam00.avi": "found a video, expected the folder that it lies in", "a.txt": "found a file, expected"}
    for name, sentence in (said | {"missing": "no such folder, expected"}).items():
        refused(sentence, detect, tmp_path / name)


def test_a_capture_one_folder_deeper_has_its_own_path(tmp_path: Path) -> None:
    rigs.n3dv_nested(tmp_path)
    (tmp_path / "README.txt").write_text("x")
    (tmp_path / "__MACOSX").mkdir()
    assert detect(tmp_path) == "n3dv"
    assert open_capture(tmp_path).path == tmp_path / "coffee_martini"


def test_raw_videos_are_not_passed_over_for_a_capture_below_them(tmp_path: Path) -> None:
    rigs.n3dv_nested(tmp_path)
    write_films(tmp_path, rig())
    assert layout_of(tmp_path) is None and layout_of(tmp_path / "coffee_martini") == "n3dv"
    refuses(tmp_path, "4 videos without calibration")


def test_a_damaged_calibration_is_named_and_not_taken_for_raw_videos(tmp_path: Path) -> None:
    rigs.caliscope(tmp_path)
    (tmp_path / "camera_array.toml").write_text("[cameras.0\nsize = [64, 48]\n")
    refuses(tmp_path, r"camera_array.toml: found text that is not TOML")


def test_json_that_is_a_list_is_no_capture_of_another_layout(tmp_path: Path) -> None:
    (tmp_path / "models.json").write_text(json.dumps({"cameras": []}))
    refuses(tmp_path, r"models.json: found no list of cameras")
