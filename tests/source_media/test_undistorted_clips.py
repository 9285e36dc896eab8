"""Films free of lens distortion: what they show, when they are needed, and that nothing half-written is left."""

import os
import time
from dataclasses import replace
from itertools import product
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import refused, scene_header
from support.layouts.lists import opencv_entry, posed, write_listed, write_opencv
from support.layouts.rigs import technicolor
from support.small_captures import write_film

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.decoding import decode_shots
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.video import decode, read_facts, read_image
from frog_blender.engine.scene.header import SceneHeader
from frog_blender.engine.source_media.clips import Clip
from frog_blender.engine.source_media.undistorted_clips import clips_folder, undistorted_clips, undistortion

WIDTH, HEIGHT, FRAMES = 96, 72, 5


def header_of(capture: Capture) -> SceneHeader:
    """What a training of the capture would say of it."""
    filmed = [[shot.frame for shot in capture.shots if shot.camera == index] for index in range(len(capture.cameras))]
    said = {"frames_per_second": capture.frames_per_second, "capture_path": str(capture.path)}
    said |= {"capture_format": capture.format, "camera_shots": tuple(map(tuple, filmed))}
    return scene_header(capture.cameras, capture.frame_count, test_cameras=tuple(capture.test_cameras), **said)


def film(path: Path, seed: int) -> None:
    """Smooth blobs that differ from frame to frame."""
    random = np.random.default_rng(seed)
    small = [random.integers(40, 220, (6, 8, 3), np.uint8) for _ in range(FRAMES)]
    write_film(path, [cv2.resize(image, (WIDTH, HEIGHT)) for image in small], 24.0)


@pytest.fixture
def bent(tmp_path: Path) -> Path:
    """Two cameras, one of whose lenses distorts much."""
    lens = np.array([[80.0, 0, 46], [0, 80.0, 38], [0, 0, 1]])
    cameras = [Camera(name, WIDTH, HEIGHT, lens, np.eye(4)) for name in ("left", "right")]
    bends = ([-0.3, 0.05, 0.0, 0.0], [0.0] * 4)
    entries = [opencv_entry(camera, dist=dist) for camera, dist in zip(cameras, bends, strict=True)]
    folder = write_opencv(tmp_path / "bent", entries)
    for seed, camera in enumerate(cameras):
        film(folder / f"{camera.name}.mp4", seed)
    return folder


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    return tmp_path / "x.frog"


@pytest.fixture
def header(bent: Path) -> SceneHeader:
    return header_of(open_capture(bent))


def difference(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.abs(a.astype(float) - b).mean())


def write_films(header: SceneHeader, scene: Path, folder: Path) -> None:
    films = undistortion(header, scene, folder)
    list(films.steps)


def test_films_show_what_training_saw(bent: Path, scene: Path, header: SceneHeader) -> None:
    capture = open_capture(bent)
    assert undistorted_clips(header, scene) == {}
    films = undistortion(header, scene, bent)
    assert films.total == 2 * FRAMES
    assert list(films.steps) == list(range(1, 2 * FRAMES + 1))
    folder = clips_folder(scene)
    assert undistorted_clips(header, scene) == {
        name: Clip(folder / f"{name}.mp4", "VIDEO", count=FRAMES) for name in ("left", "right")
    }
    assert read_facts(folder / "left.mp4").frames_per_second == 24.0
    expected = list(decode_shots(capture, [capture.shot_index(0, frame) or 0 for frame in range(FRAMES)]))
    stored = list(decode(bent / "left.mp4", range(FRAMES)))
    for frame, shown in enumerate(decode(folder / "left.mp4", range(FRAMES))):
        others = [difference(shown, entry) for entry in [*expected[:frame], *expected[frame + 1 :], *stored]]
        assert difference(shown, expected[frame]) < 4.0 < min(others)
    assert undistortion(header, scene, bent) is None, "they are there already"


def test_films_of_other_lenses_are_not_taken(bent: Path, scene: Path, header: SceneHeader) -> None:
    write_films(header, scene, bent)
    for changed in (
        replace(header, capture_path="/another"),
        replace(header, cameras=(header.cameras[0].resized(48, 36), header.cameras[1])),
    ):
        assert undistorted_clips(changed, scene) == {}
    write_films(replace(header, cameras=tuple(c.resized(47, 35) for c in header.cameras)), scene, bent)
    facts = read_facts(clips_folder(scene) / "right.mp4")
    assert (facts.width, facts.height) == (48, 36), "videos have even sides"
    for damaged in ("{", "[]", '{"scene": 1}', "[" * 100_000):
        (clips_folder(scene) / "clips.json").write_text(damaged)
        assert undistorted_clips(header, scene) == {}


def test_what_changed_is_written_again(bent: Path, scene: Path, header: SceneHeader) -> None:
    write_films(header, scene, bent)
    film(bent / "right.mp4", 7)
    assert undistortion(header, scene, bent) is not None, "another video of the same name"
    calibration = bent / "cameras_opencv.json"
    calibration.write_text(calibration.read_text().replace("-0.3", "-0.2"))
    write_films(header, scene, bent)
    assert undistortion(header, scene, bent) is None
    calibration.write_text(calibration.read_text().replace("-0.2", "-0.1"))
    write_films(header, scene, bent)
    (clips_folder(scene) / "left.mp4").unlink()
    assert undistorted_clips(header, scene) == {}, "one is missing"
    assert undistortion(header, scene, bent) is not None


def test_nobody_s_own_files_are_touched(bent: Path, scene: Path, header: SceneHeader) -> None:
    footage = clips_folder(scene) / "left.mp4"
    footage.parent.mkdir()
    footage.write_bytes(b"mine")
    refused("found files of others", undistortion, header, scene, bent)
    assert footage.read_bytes() == b"mine"
    footage.unlink()
    writing: set[Path] = set()
    films = undistortion(header, scene, bent, writing=writing)  # an empty folder will do
    next(films.steps)
    refused("being written already", undistortion, header, scene, bent, writing=writing)
    (footage.parent / "notes.txt").write_text("mine")
    films.steps.close()
    assert not writing and [path.name for path in footage.parent.iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("rate", [23.976, 239.8461])
def test_any_frame_rate_has_films(bent: Path, tmp_path: Path, rate: float) -> None:
    header = replace(header_of(open_capture(bent)), frames_per_second=rate)
    write_films(header, tmp_path / "x.frog", bent)
    clip = undistorted_clips(header, tmp_path / "x.frog")["left"]
    assert read_facts(clip.path).frame_count == FRAMES


def test_a_part_of_a_capture_is_not_the_whole(bent: Path, tmp_path: Path) -> None:
    header = header_of(open_capture(bent).segment(1, 3))
    refused("found 5 frames, expected 3", undistortion, header, tmp_path / "x.frog", bent)
    renamed = replace(header, cameras=tuple(replace(c, name=f"other {c.name}") for c in header.cameras), frame_count=5)
    refused("not all images of other left", undistortion, renamed, tmp_path / "x.frog", bent)
    assert undistortion(header, tmp_path / "x.frog", tmp_path / "nowhere") is None


def test_images_no_program_takes_for_a_film(tmp_path: Path) -> None:
    """Technicolor's, of which one camera's lacks a frame."""
    folder = tmp_path / "Birthday"
    cameras = technicolor(folder)
    (folder / "Birthday_undist_00152_09.png").unlink()
    header = header_of(open_capture(folder))
    films = undistortion(header, tmp_path / "b.frog", folder)
    assert films is not None and films.total == 19
    list(films.steps)
    assert undistorted_clips(header, tmp_path / "b.frog").keys() == {camera.name for camera in cameras}


def moving_capture(folder: Path, **own: float) -> Path:
    names = [f"images/view {index}.png" for index in range(6)]
    write_listed(folder, names, [posed(name, index, **own) for index, name in enumerate(names)], k1=0.1)
    return folder


def test_one_moving_camera_has_one_film(tmp_path: Path) -> None:
    folder = moving_capture(tmp_path / "mono")
    header = header_of(open_capture(folder))
    write_films(header, tmp_path / "m.frog", folder)
    ((_, clip),) = undistorted_clips(header, tmp_path / "m.frog").items()
    brightness = [image.mean() for image in decode(clip.path, range(6))]
    np.testing.assert_allclose(brightness, [0, 10, 20, 30, 40, 50], atol=4)


def test_a_single_frame_is_an_image_and_any_name_a_file(tmp_path: Path) -> None:
    folder = moving_capture(tmp_path / "still", time=0.0)
    capture = open_capture(folder)
    header = replace(header_of(capture), cameras=capture.cameras)
    write_films(header, tmp_path / "s.frog", folder)
    clips = undistorted_clips(header, tmp_path / "s.frog")
    assert [clip.kind for clip in clips.values()] == ["IMAGE"] * 6
    assert {clip.path.parent for clip in clips.values()} == {clips_folder(tmp_path / "s.frog")}
    assert [read_image(clip.path).mean() for clip in clips.values()] == [0, 10, 20, 30, 40, 50]


def test_stopped_or_failed_nothing_is_left(bent: Path, tmp_path: Path, header: SceneHeader) -> None:
    scene = tmp_path / "scenes" / "x.frog"
    scene.parent.mkdir()
    films = undistortion(header, scene, bent)
    next(films.steps)
    films.steps.close()
    assert not list(scene.parent.iterdir())
    films = undistortion(header, scene, bent)
    whole = (bent / "right.mp4").read_bytes()
    next(films.steps)
    (bent / "right.mp4").write_bytes(whole[: len(whole) // 2])
    refused(r"right\.mp4", list, films.steps)
    assert not list(scene.parent.iterdir())
    (bent / "right.mp4").write_bytes(whole)
    films = undistortion(header, scene.parent / "nowhere" / "x.frog", bent)
    refused("cannot be written here", list, films.steps)


@pytest.fixture
def precious(tmp_path: Path) -> Path:
    """What a scene's folder must never lead to."""
    path = tmp_path / "home" / "precious.txt"
    path.parent.mkdir()
    path.write_text("mine")
    return path


@pytest.mark.parametrize("link", [*product(("left.mp4", "right.mp4", "clips.json"), (False, True))])
def test_no_link_is_written_through(
    bent: Path, scene: Path, header: SceneHeader, precious: Path, link: tuple[str, bool]
) -> None:
    """The folder came with the scene, films begun in it, and a link under the name of one or of the index."""
    folder, (name, dangling) = clips_folder(scene), link
    folder.mkdir()
    (folder / "clips.json").write_text("{}")
    (folder / name).unlink(missing_ok=True)
    (folder / name).symlink_to(precious.with_name("new.txt") if dangling else precious)
    if name == "clips.json" and dangling:  # no index at all
        refused("found files of others", undistortion, header, scene, bent)
    else:
        write_films(header, scene, bent)
        assert not any(path.is_symlink() for path in folder.iterdir())
        assert len(undistorted_clips(header, scene)) == 2
    assert precious.read_text() == "mine" and [entry.name for entry in precious.parent.iterdir()] == ["precious.txt"]


@pytest.mark.parametrize("exists", [False, True])
def test_a_folder_that_is_a_link_is_left_alone(bent: Path, scene: Path, precious: Path, exists: bool) -> None:
    clips_folder(scene).symlink_to(precious.parent if exists else precious.parent / "new")
    refused("found files of others", undistortion, header_of(open_capture(bent)), scene, bent)
    assert [entry.name for entry in precious.parent.iterdir()] == ["precious.txt"]


def test_what_was_written_before_stays_until_all_is_new(bent: Path, scene: Path, header: SceneHeader) -> None:
    write_films(header, scene, bent)
    before = undistorted_clips(header, scene)
    film(bent / "right.mp4", 7)
    films = undistortion(header, scene, bent).steps
    next(films)
    assert undistorted_clips(header, scene) == before
    films.close()
    assert undistorted_clips(header, scene) == before
    names = sorted(path.name for path in clips_folder(scene).iterdir())
    assert names == ["clips.json", "left.mp4", "right.mp4"]


def test_what_a_killed_process_left_goes_with_time(bent: Path, scene: Path, header: SceneHeader) -> None:
    for name, age in (("old", 100_000), ("young", 100)):
        partial = clips_folder(scene) / f".partial-{name}"
        partial.mkdir(parents=True)
        (partial / "left.mp4").write_bytes(b"half")
        os.utime(partial, (time.time() - age,) * 2)
    write_films(header, scene, bent)
    assert [path.name for path in clips_folder(scene).glob(".partial-*")] == [".partial-young"]
