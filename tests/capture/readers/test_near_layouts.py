"""What is no capture: one sentence that fits, and that says what to do."""

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from support.filmed_scene import rig, still
from support.layouts import rigs
from support.layouts.colmap import write_model
from support.layouts.files import write_films, write_frames, write_image

from frog_blender.engine.capture.readers import detect, layout_of, open_capture
from frog_blender.engine.errors import FrogError

from .reading import refuses


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
    "Record3D": (text("metadata.json", "{}"), r"metadata and no folder rgbd or rgb"),
    "Polycam": (text("keyframes/mesh.obj"), r"keyframes without cameras or images"),
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
        with pytest.raises(FrogError, match=expected) as caught:
            call(tmp_path)
        sentence = str(caught.value)
        assert sentence.startswith(str(tmp_path)) and sentence.endswith(".") and len(sentence) < 350


def test_a_file_names_the_folder_to_choose(tmp_path: Path) -> None:
    write_films(tmp_path, rig()[:1])
    (tmp_path / "a.txt").write_text("x")
    said = {"cam00.avi": "found a video, expected the folder that it lies in", "a.txt": "found a file, expected"}
    for name, sentence in (said | {"missing": "no such folder, expected"}).items():
        with pytest.raises(FrogError, match=sentence):
            detect(tmp_path / name)


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
