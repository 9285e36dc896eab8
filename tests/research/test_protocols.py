"""The papers' protocols on folders that look like the datasets, tiny."""

import os
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import refused
from support.layouts.lists import posed, write_listed
from support.layouts.moving_rigs import hypernerf
from support.small_captures import llff_row, write_video

from frog_blender.engine.errors import FrogError
from frog_blender.research.protocols import PROTOCOLS, averages, captures, left_out, published_table

N3DV = PROTOCOLS["n3dv"]
# Numbers with gaps, one of them before 13: camera 13 is the thirteenth by name.
MARTINI = tuple(f"cam{index:02d}" for index in range(21) if index not in (3, 15, 17))


def n3dv_scene(folder: Path, names: tuple[str, ...], source: Path) -> None:
    """Camera i stands at x = i; all show the same video."""
    folder.mkdir(parents=True)
    for name in names:
        os.link(source, folder / f"{name}.mp4")
    rows = [llff_row(2028, 2704, 1500.0, (index, 0, 0)) for index in range(len(names))]
    np.save(folder / "poses_bounds.npy", np.stack(rows))


@pytest.fixture(scope="module")
def n3dv(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The six scenes; flame_salmon_1 has 1200 frames, sear_steak's videos lack their last."""

    def dark(_: int) -> np.ndarray:
        return np.zeros((24, 32, 3), np.uint8)

    root = tmp_path_factory.mktemp("data")
    short, usual, long = (write_video(root / f"{n}.mp4", n, 32, 24, dark) for n in (299, 300, 1200))
    folder = root / "N3DV"
    n3dv_scene(folder / "coffee_martini", MARTINI, usual)
    for name in ("cook_spinach", "cut_roasted_beef", "flame_steak"):
        n3dv_scene(folder / name, ("cam00", "cam02"), usual)
    n3dv_scene(folder / "salmon" / "flame_salmon_1", ("cam00", "cam02"), long)
    n3dv_scene(folder / "sear_steak", ("cam00", "cam02"), short)
    return folder


def test_n3dv_is_nine_captures_at_the_papers_size(n3dv: Path) -> None:
    opened = captures(replace(N3DV, image_width=16), n3dv)
    salmon = [f"flame_salmon_frag{i}" for i in (1, 2, 3, 4)]
    names = ["coffee_martini", "cook_spinach", "cut_roasted_beef", *salmon, "flame_steak", "sear_steak"]
    assert [name for name, _ in opened] == names
    by_name = dict(opened)
    for name, capture in opened:
        assert capture.test_cameras == {"cam00"}
        assert (capture.cameras[0].width, capture.cameras[0].height) == (16, 12)
        assert capture.frame_count == (299 if name == "sear_steak" else 300)
    assert any("299 of its 300 frames" in warning for warning in by_name["sear_steak"].warnings)
    for segment, name in enumerate(salmon):
        shots = [shot for shot in by_name[name].shots if shot.camera == 1]
        assert [shot.index for shot in shots] == [*range(300 * segment, 300 * segment + 300)]
        assert [shot.frame for shot in shots] == [*range(300)]

    martini = by_name["coffee_martini"]  # without camera 13 and its pose
    assert sorted(MARTINI).index("cam13") == 12
    kept = [name for name in MARTINI if name != "cam13"]
    assert [camera.name for camera in martini.cameras] == kept
    centers = [camera.center[0] for camera in martini.cameras]
    np.testing.assert_allclose(centers, [index for index in range(len(MARTINI)) if index != 12])
    assert {shot.path.stem for shot in martini.shots} == set(kept)
    assert all(martini.cameras[shot.camera].name == shot.path.stem for shot in martini.shots)


def test_images_that_are_too_small_are_told_and_left_as_they_are(n3dv: Path) -> None:
    ((_, capture),) = captures("n3dv", n3dv, names=["cook_spinach"])
    assert capture.cameras[0].width == 32
    assert any("32 pixels wide, expected 1352" in warning for warning in capture.warnings)


def test_a_segment_that_is_not_there_is_refused(n3dv: Path, tmp_path: Path) -> None:
    n3dv_scene(tmp_path / "flame_salmon", ("cam00", "cam01"), n3dv.parent / "300.mp4")
    with pytest.raises(
        FrogError, match="found 300 frames, expected 600 of which flame_salmon_frag2 is frames 300 to 599"
    ):
        captures("n3dv", tmp_path, ["flame_salmon_frag2"])


def test_missing_scenes_are_named_with_what_was_looked_for(n3dv: Path, tmp_path: Path) -> None:
    """Where some are named or none is there; otherwise those that are there are enough."""
    (tmp_path / "sear_steak").mkdir()
    refused(r"coffee_martini, cook_spinach, .*, flame_salmon_1 or flame_salmon, flame", captures, "n3dv", tmp_path)
    n3dv_scene(tmp_path / "cook-spinach", ("cam00", "cam01"), n3dv.parent / "300.mp4")
    with pytest.raises(FrogError, match=r"n3dv layout for sear_steak \(not in .*sear_steak\), expected each") as raised:
        captures("n3dv", tmp_path, ["cook_spinach", "sear_steak"])
    assert str(tmp_path) in str(raised.value) and "spinach" not in str(raised.value)
    for names in (None, ["cook_spinach"]):
        assert [name for name, _ in captures("n3dv", tmp_path, names)] == ["cook_spinach"]
    refused("no such folder", captures, "n3dv", tmp_path / "nowhere")


def test_names_that_do_not_exist_are_refused(tmp_path: Path) -> None:
    refused("no protocol 'nerf'; there are n3dv, hypernerf, technicolor, dnerf", captures, "nerf", tmp_path)
    refused("n3dv has no flame_salmon_1; it has coffee_martini", captures, "n3dv", tmp_path, ["flame_salmon_1"])


def test_hypernerf_takes_its_four_rigs_under_the_names_they_are_published_by(tmp_path: Path) -> None:
    for name in ("vrig_chicken/vrig-chicken", "vrig/broom2", "vrig/vrig-peel-banana", "vrig-3dprinter"):
        hypernerf(tmp_path / name, frames=2)
    hypernerf(tmp_path / "interp" / "chickchicken", frames=2)  # another scene of the data set
    opened = captures("hypernerf", tmp_path)
    assert [name for name, _ in opened] == ["3dprinter", "peel-banana", "broom", "chicken"]
    for _, capture in opened:
        assert capture.test_cameras == {"000001_right", "000002_left"}
        assert capture.frame_count == 2
        assert "chickchicken" not in str(capture.path)


def technicolor_scene(folder: Path, scene: str, frames: range) -> None:
    """Cameras 0, 5 and 10 of sixteen."""
    folder.mkdir(parents=True)
    row = "1800 1000 500 1 0 1 0 0 0 0 0 0"
    (folder / "cameras_parameters.txt").write_text("\n".join(["header", *[row] * 16]))
    image = cv2.imencode(".png", np.zeros((17, 32, 3), np.uint8))[1].tobytes()
    for camera in (0, 5, 10):
        for frame in frames:
            (folder / f"{scene}_undist_{frame:05d}_{camera:02d}.png").write_bytes(image)


def test_technicolor_takes_fifty_frames_by_their_numbers(tmp_path: Path) -> None:
    for scene in ("Birthday", "Fabien", "Painter", "Train"):
        technicolor_scene(tmp_path / scene.lower(), scene, range(45, 205))
    technicolor_scene(tmp_path / "Theatre", "Theater", range(51, 101))
    opened = dict(captures("technicolor", tmp_path))
    firsts = {"Birthday": 151, "Fabien": 51, "Painter": 100, "Theater": 51, "Train": 151}
    assert list(opened) == list(firsts)
    for name, capture in opened.items():
        numbers = [int(shot.path.stem.split("_")[2]) for shot in capture.shots if shot.camera == 0]
        assert numbers == [*range(firsts[name], firsts[name] + 50)]
        assert capture.frame_count == 50
        assert capture.test_cameras == {"cam10"}


def dnerf_scene(folder: Path) -> None:
    """Two training images, and one of each other split, each from a side of its own."""
    for split, times in (("train", (0.0, 1.0)), ("val", (0.5,)), ("test", (0.25,))):
        names = [f"{split}/r_{index}" for index in range(len(times))]
        frames = [
            posed(f"./{name}", index + time, time=time)
            for index, (name, time) in enumerate(zip(names, times, strict=True))
        ]
        write_listed(folder, [f"{name}.png" for name in names], frames, f"transforms_{split}.json")


def test_lego_is_judged_on_its_validation_split_alone_and_the_others_on_their_test_split(tmp_path: Path) -> None:
    dnerf_scene(tmp_path / "lego")
    dnerf_scene(tmp_path / "trex")
    (name, capture), (other, with_tests) = captures("dnerf", tmp_path)
    assert (name, other) == ("lego", "trex")
    assert with_tests.test_cameras == {"test/r_0.png"}
    assert {camera.name for camera in with_tests.cameras} == {"train/r_0.png", "train/r_1.png", "test/r_0.png"}
    assert capture.test_cameras == {"val/r_0.png"}
    assert {camera.name for camera in capture.cameras} == {"train/r_0.png", "train/r_1.png", "val/r_0.png"}
    assert "33.07" in published_table(PROTOCOLS["dnerf"])


def test_an_average_weighs_segments_alike_and_costs_only_where_the_paper_measures_them() -> None:
    figures = {name: {"psnr": 20.0 + index, "fps": 100.0 + index} for index, name in enumerate(N3DV.names)}
    assert averages(N3DV, figures) == {"psnr": 24.0, "fps": 103.0}
    technicolor = PROTOCOLS["technicolor"]
    figures = {name: {"psnr": 30.0, "fps": 10.0 * index} for index, name in enumerate(technicolor.names)}
    assert averages(technicolor, figures) == {"psnr": 30.0, "fps": 20.0}
    del figures["Train"]["psnr"]
    assert averages(technicolor, figures) == {"fps": 20.0}  # the mean of four scenes is not the paper's
    assert averages(technicolor, {"Train": {"psnr": 30.0}}) == {}
    assert averages(technicolor.of(["Train"]), {"Train": {"psnr": 30.0}}) == {"psnr": 30.0}
    assert left_out("technicolor", technicolor) == ""
    assert left_out("technicolor", technicolor.of(["Train", "Fabien"])) == (
        "2 of the 5 captures of technicolor, without Birthday, Painter, Theater: "
        "means are of these alone, and not the paper's."
    )


@pytest.mark.parametrize("name", PROTOCOLS)
def test_published_figures_are_shown(name: str) -> None:
    psnrs = re.findall(r"^\| \S.*? \| ([0-9.]+) \|", published_table(PROTOCOLS[name]), re.MULTILINE)
    assert psnrs and all(20 < float(psnr) < 45 for psnr in psnrs)
