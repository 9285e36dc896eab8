"""What a folder of images without films is taken for, and films in several files."""

from collections.abc import Callable
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image
from support.builders import refused
from support.films import encode, sliding
from support.layouts.lists import opencv_entry, write_opencv

from frog_blender.cli.main import main
from frog_blender.engine.capture.calibration.sequences import find_stills
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.readers.readings import CAMERAS, MOMENTS, MOVING, ONE_MOMENT, chosen_layout
from frog_blender.engine.capture.synchronization.films import find_films
from frog_blender.engine.notices import Notice

from .rigs import rig_errors
from .walls import camera, image, rig

ASKED = "asked"
_MODEL, _DETAILS, _TAKEN = 0x0110, 0x8769, 0x9003


def photograph(path: Path, second: int | None, model: str = "", height: int = 6) -> None:
    exif = Image.Exif()
    if model:
        exif[_MODEL] = model
    if second is not None:
        exif.get_ifd(_DETAILS)[_TAKEN] = f"2026:11:28 06:{second // 60:02d}:{second % 60:02d}"
    path.parent.mkdir(exist_ok=True)
    Image.new("RGB", (8, height)).save(path, exif=exif)


@pytest.mark.parametrize(
    ("name", "second", "meant"),
    [
        ("cam_{}.png", None, ONE_MOMENT),
        ("images/view{}.jpg", None, ONE_MOMENT),
        ("frame_{}.png", None, MOVING),
        ("{:03d}.png", None, ASKED),
        ("image{:05d}.png", None, ASKED),
        ("IMG_{}.jpg", lambda index: 7 * index, MOVING),
        ("IMG_{}.jpg", lambda index: 100, ONE_MOMENT),
        ("IMG_{}.jpg", lambda index: 100 + index % 2, ONE_MOMENT),
        ("IMG_{}.jpg", lambda index: 100 + index // 6, ASKED),  # a burst, or clocks that differ
        ("IMG_{}.jpg", lambda index: 70 * (index % 5), ASKED),
        ("cam{}.jpg", lambda index: 7 * index, ASKED),  # names and times contradict each other
        ("frame{}.jpg", lambda index: 100, ASKED),
        ("cam{1}_{2}.jpg", None, CAMERAS),
        ("cam{1}_{2}.jpg", lambda index: 100, ASKED),
        ("frame{1}_cam{2}.png", None, MOMENTS),
        ("{1}_{2}.png", None, ASKED),
        ("cam_{1}_{4}.png", None, ASKED),  # rows and columns of cameras, perhaps
        ("cam{0}/DSC_{3}.JPG", None, ONE_MOMENT),
        ("{}/image.jpg", None, ASKED),
        ("{}/image.jpg", lambda index: 7 * index, MOVING),
    ],
)
def test_names_and_times_tell_whose_images_are_or_it_is_asked(
    tmp_path: Path, name: str, second: Callable[[int], int] | None, meant: str
) -> None:
    names = [name.format(index, index // 4, index % 4 + 8, 977 * (index + 5) % 1000, index % 4) for index in range(12)]
    for index, each in enumerate(names):
        photograph(tmp_path / each, None if second is None else second(index))
    if meant == ASKED:
        refused(r"can be read in \d ways, say which: .* \(--layout ", find_stills, tmp_path)
    else:
        stills = find_stills(tmp_path)
        assert stills is not None and stills.reading.choice == meant and stills.times is None
        assert [path.relative_to(tmp_path).as_posix() for path in stills.images] == names
    for layout, count in (("moving", 0), ("one-moment", 12), ("standing", 12)):
        if layout != "standing" or "{1}" not in name:
            chosen = find_stills(tmp_path, layout)
            assert chosen is not None and len(chosen.footage) == count


def test_cameras_that_differ_took_one_moment(tmp_path: Path) -> None:
    for index in range(4):
        photograph(tmp_path / "models" / f"{index}.jpg", None, model=f"H{index % 2}")
        photograph(tmp_path / "sizes" / f"{index}.png", None, height=6 + index % 2)
    for folder in tmp_path.iterdir():
        stills = find_stills(folder)
        assert stills is not None and stills.reading.choice == ONE_MOMENT


def test_photographs_tell_the_order_and_the_times_that_names_do_not(tmp_path: Path) -> None:
    for index, name in enumerate(["stove", "door", "lamp", "bed", "wall", "sink", "oven", "chair"]):
        photograph(tmp_path / f"{name}.jpg", 3 * index**2)
    stills = find_stills(tmp_path, "moving")
    assert stills is not None and stills.times == tuple(3.0 * index**2 for index in range(8))
    assert [path.stem for path in stills.images[:3]] == ["stove", "door", "lamp"]


@pytest.mark.parametrize("name", ["{0}.png", "{0}/DSC_{2}.png", "images/{0}_{1}.png"])
def test_images_of_standing_cameras_become_a_rig(tmp_path: Path, name: str) -> None:
    pytest.importorskip("pycolmap")
    moments = [9, 10] if "{1}" in name else [0]
    files = {}
    for index, (view, moment) in enumerate(product(rig(), moments)):
        file = tmp_path / name.format(view.name, moment, 977 * index % 1000)
        file.parent.mkdir(exist_ok=True)
        cv2.imwrite(str(file), image(view))
        files[view.name, moment - moments[0]] = file
    assert main(["calibrate", str(tmp_path)]) == 0
    capture = open_capture(tmp_path)
    assert {(capture.cameras[shot.camera].name, shot.frame): shot.path for shot in capture.shots} == files
    assert capture.frame_count == len(moments) and not capture.test_cameras
    assert rig_errors(capture.cameras, rig())[0] < 1


@pytest.mark.parametrize(
    ("name", "cameras"),
    [
        ("cam{}/{:04d}.png", ["cam0", "cam1"]),
        ("cam{}/images/{}.png", ["cam0", "cam1"]),
        ("left{}/{}.png", ["left0", "left1"]),
        ("frame{1:04d}/cam{0}.png", ["cam0", "cam1"]),
        ("{1:03d}/images/cam_{0}.png", ["cam_0", "cam_1"]),
        ("pose{1}/view_{2}.png", ["view_a", "view_b"]),
        ("pose{1}/cam{0}.png", ["cam0", "cam1"]),
        ("{}/{:04d}.png", ASKED),
    ],
)
def test_folders_are_of_cameras_or_of_moments_or_it_is_asked(tmp_path: Path, name: str, cameras: list[str]) -> None:
    for index in range(6):
        file = tmp_path / name.format(index // 3, index % 3 + 8, "ab"[index // 3])
        file.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(file), np.full((6, 8), 10 * index, np.uint8))
    if cameras == ASKED:
        refused(r"can be read in 2 ways, .* \(--layout cameras\); or .*\(--layout moments\)", find_films, tmp_path)
        for layout, count in (("cameras", 2), ("moments", 3)):
            with chosen_layout(layout):
                assert len(find_films(tmp_path)) == count
    else:
        films = find_films(tmp_path)
        assert [film.name for film in films] == cameras
        assert [int(film.stamps[-1] * 30 + 0.5) for film in films] == [10, 10]
        assert [[int(seen.mean()) for seen in film.gray([0, 2], 64)] for film in films] == [[0, 20], [30, 50]]


def steps(first: int, count: int) -> list[np.ndarray]:
    return [np.full((48, 64, 3), 20 * (first + index), np.uint8) for index in range(count)]


@pytest.mark.parametrize(
    ("names", "tags"),
    [
        (("GX010040.MP4", "GX020040.MP4"), ({}, {})),
        (("GOPR0001.MP4", "GP010001.MP4"), ({}, {})),
        (("DJI_0009.MP4", "DJI_0010.MP4"), ("2026-11-28T06:00:00Z", "2026-11-28T06:00:01Z")),
    ],
)
def test_chapters_are_one_film(tmp_path: Path, names: tuple[str, str], tags: tuple[object, object]) -> None:
    for index, (name, tag) in enumerate(zip(names, tags, strict=True)):
        encode(tmp_path / name, steps(5 * index, 5), rate=10, tags={"creation_time": str(tag)} if tag else None)
    (film,) = find_films(tmp_path)
    assert film.stamps == pytest.approx(np.arange(10) / 10)
    assert [round(float(seen.mean()) / 20) for seen in film.gray([0, 4, 5, 9], 64)] == [0, 4, 5, 9]
    write_opencv(tmp_path, [opencv_entry(camera(film.name, (0, 0, -3)), width=64, height=48)])
    shots = open_capture(tmp_path).shots
    assert [(shot.frame, shot.path.name, shot.index) for shot in shots][4:6] == [(4, names[0], 4), (5, names[1], 0)]


def test_what_is_unusual_about_films_is_said_before_they_are_calibrated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    repeated = [sliding(index // 5) for index in range(45)]
    for name, images, rate in (("cam.mp4", repeated, 25), ("GX020040.MP4", [sliding(k) for k in range(20)], 30)):
        encode(tmp_path / name, images, rate=rate)
    photograph(tmp_path / "stills" / "IMG_1.jpg", None)
    with pytest.warns(Notice) as caught:
        assert main(["calibrate", str(tmp_path), "--moving"]) == 1
    told = [str(warning.message) for warning in caught if warning.category is Notice]
    for part in ("stills", "GX020040.MP4 begins with a later chapter", "rates differ (25 to 30", "picture 5 times"):
        assert [part in sentence for sentence in told].count(True) == 1
    assert "all moving" in capsys.readouterr().err


def test_films_of_other_times_are_no_chapters_and_a_missing_one_is_told(tmp_path: Path) -> None:
    for index, name in enumerate(["C0001.MP4", "C0002.MP4"]):
        encode(tmp_path / name, steps(0, 5), rate=10, tags={"creation_time": f"2026-11-28T06:0{index}:00Z"})
    assert [film.name for film in find_films(tmp_path)] == ["C0001", "C0002"]
    for chapter in (1, 3):
        encode(tmp_path / f"GX0{chapter}0040.MP4", steps(0, 5))
    refused(r"found GX010040\.MP4, GX030040\.MP4, expected every chapter between", find_films, tmp_path)
