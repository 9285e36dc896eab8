"""``frog render``: cameras of files, times, sizes, and what is in the images."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import REPOSITORY, scene_file
from support.layouts.lists import posed_as

from frog_blender.cli.main import main
from frog_blender.engine.errors import UsageError
from frog_blender.engine.playback.passes import NO_SURFACE
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw, to_uint8
from frog_blender.engine.playback.render_files import image_files, write_exr
from frog_blender.engine.playback.views import View, read_cameras, sized
from frog_blender.engine.scene.scene_file import write_scene
from frog_blender.engine.srgb import linear_to_srgb


@pytest.fixture
def scene(tmp_path: Path) -> ScenePlayer:
    write_scene(tmp_path / "x.frog", scene_file())
    return ScenePlayer.load(tmp_path / "x.frog")


def render(tmp_path: Path, *words: object) -> int:
    return main(["render", str(tmp_path / "x.frog"), *map(str, words)])


def read(path: Path) -> np.ndarray:
    return cv2.cvtColor(cv2.imread(str(path), cv2.IMREAD_UNCHANGED), cv2.COLOR_BGRA2RGBA)[..., :4]


def write_cameras(path: Path, scene: ScenePlayer, *own: dict[str, object]) -> Path:
    """The scene's first camera for each entry."""
    camera = scene.header.cameras[0]
    k = camera.intrinsics
    lens = {"w": camera.width, "h": camera.height, "fl_x": k[0, 0], "fl_y": k[1, 1], "cx": k[0, 2], "cy": k[1, 2]}
    frames = [posed_as(camera, "image.png", **lens, **entry) for entry in own]
    path.write_text(json.dumps({"frames": frames}))
    return path


def test_a_file_of_cameras_says_which_frames_they_show(scene: ScenePlayer, tmp_path: Path) -> None:
    file = write_cameras(tmp_path / "c.json", scene, *({"frame": n / 2, "number": 10 + n} for n in range(3)))
    assert render(tmp_path, "--cameras", file, "--frames", "11-12", "-o", tmp_path / "o" / "f_##.png") == 0
    assert sorted(path.name for path in (tmp_path / "o").iterdir()) == ["f_11.png", "f_12.png"]
    expected = draw(scene.at_frame(0.5), scene.header.cameras[0], scene.header.background).rgb
    np.testing.assert_array_equal(read(tmp_path / "o" / "f_11.png")[..., :3], to_uint8(expected))


def test_cameras_and_frames_have_to_fit(scene: ScenePlayer, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file = write_cameras(tmp_path / "c.json", scene, {}, {})
    out = ("-o", tmp_path / "o")
    for words, told in (
        (["--cameras", file], "which frame each shows"),
        (["--cameras", file, "--frames", "0-2"], "2 cameras and 3 frames"),
        (["--cameras", write_cameras(tmp_path / "d.json", scene, {"frame": 1e4})], "10000"),
        (["--camera", "odd", "--times", "0", "--step", "0.5"], "--times"),
        (["--camera", "odd", "--vectors"], ".exr"),
        (["--camera", "odd", "--frames", "0-0", "--size", "30000x30000"], "pixels"),
    ):
        assert render(tmp_path, *words, *out) != 0
        assert told in capsys.readouterr().err
    assert not (tmp_path / "o").exists(), "nothing is made before all is known to be right"


def test_fractions_of_frames_sizes_and_alpha(scene: ScenePlayer, tmp_path: Path) -> None:
    options = ("--camera", "odd", "--frames", "1-2", "--step", "0.5", "--size", "50%", "--alpha", "straight")
    assert render(tmp_path, *options, "-o", tmp_path / "o") == 0
    camera = next(camera for camera in scene.header.cameras if camera.name == "odd").scaled(0.5)
    images = sorted((tmp_path / "o").iterdir())
    assert [path.name for path in images] == ["odd_0000.png", "odd_0001.png", "odd_0002.png"]
    image, drawing = read(images[1]), draw(scene.at_frame(1.5), camera)
    np.testing.assert_array_equal(image[..., 3], to_uint8(drawing.alpha))
    straight = drawing.rgb / np.maximum(drawing.alpha, 1e-6)[..., None].clip(0, 1)
    np.testing.assert_allclose(image[..., :3], to_uint8(straight), atol=1)


def test_the_canonical_field_stands_still(scene: ScenePlayer, tmp_path: Path) -> None:
    still = scene.canonical()
    np.testing.assert_array_equal(still.at(0.0).means, still.at(1.0).means)
    assert not np.array_equal(still.at(1.0).means, scene.at(1.0).means)
    assert render(tmp_path, "--camera", "odd", "--canonical", "--frames", "2-2", "-o", tmp_path / "o_#.png") == 0
    camera = next(camera for camera in scene.header.cameras if camera.name == "odd")
    expected = to_uint8(draw(still.at(0.0), camera, scene.header.background).rgb)
    np.testing.assert_array_equal(read(tmp_path / "o_2.png")[..., :3], expected)


def test_ready_paths(scene: ScenePlayer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(REPOSITORY / "examples")
    from ready_path import along_rig, listed, turntable

    cameras, around = scene.header.cameras, turntable(scene, 9)
    np.testing.assert_allclose(around[0].world_to_camera, cameras[0].world_to_camera, atol=1e-9)
    middles = np.array([camera.world_to_camera[:3] for camera in around])
    point = np.linalg.lstsq(middles[:, :2, :3].reshape(-1, 3), -middles[:, :2, 3].reshape(-1), rcond=None)[0]
    distances = [np.linalg.norm(camera.center - point) for camera in around]
    np.testing.assert_allclose(distances, distances[0], rtol=1e-3)
    flight = along_rig(scene, 7)
    ends = {tuple(np.round(camera.center, 6)) for camera in cameras}
    assert {tuple(np.round(flight[index].center, 6)) for index in (0, -1)} <= ends
    (tmp_path / "path.json").write_text(json.dumps(listed(scene, flight, None)))
    views = read_cameras(tmp_path / "path.json", scene.header)
    assert [view.number for view in views] == list(range(1, 8))
    assert (views[0].frame, views[-1].frame) == (0, scene.header.frame_count - 1)
    for view, camera in zip(views, flight, strict=True):
        np.testing.assert_allclose(view.camera.world_to_camera, camera.world_to_camera, atol=1e-9)


def test_names_of_images(scene: ScenePlayer) -> None:
    views = [View(7, 0.0, scene.header.cameras[0])]
    for output, name in (("a_##_b.png", "a_07_b.png"), ("a.exr", "a0007.exr"), ("s_###", "s_007.png")):
        assert [path.name for path in image_files(views, Path(output))] == [name]
    with pytest.raises(UsageError, match=r"the ending \.tif"):
        image_files(views, Path("a_#.tif"))


def test_other_proportions_keep_what_is_seen_from_left_to_right(scene: ScenePlayer) -> None:
    camera = scene.header.cameras[0]
    other = sized(camera, 2 * camera.width, camera.height)
    np.testing.assert_allclose(other.intrinsics[0], 2 * camera.intrinsics[0])
    points = camera.unproject(np.array([[3.0, camera.height / 2]]), np.array([2.0]))
    np.testing.assert_allclose(other.project(points)[0], [[6.0, camera.height / 2]], atol=1e-9)


def test_layers_of_an_exr(scene: ScenePlayer, tmp_path: Path) -> None:
    library = pytest.importorskip("OpenEXR")
    options = ("--camera", "odd", "--frames", "0-2", "--vectors", "--alpha", "premultiplied", "--float")
    assert render(tmp_path, *options, "-o", tmp_path / "o_#.exr") == 0
    channels = library.File(str(tmp_path / "o_1.exr"), separate_channels=True).channels()
    values = {name.removeprefix("ViewLayer."): channel.pixels for name, channel in channels.items()}
    camera = next(camera for camera in scene.header.cameras if camera.name == "odd")
    drawing = draw(scene.at_frame(1), camera)
    there = np.isfinite(drawing.median_z)
    np.testing.assert_array_equal(values["Depth.Z"], np.where(there, drawing.median_z, np.float32(NO_SURFACE)))
    np.testing.assert_array_equal(values["Mean Depth.Z"][there], drawing.mean_depth[there])
    np.testing.assert_array_equal(values["Combined.A"], drawing.alpha.clip(0, 1))
    solid = drawing.alpha > 0.99
    np.testing.assert_allclose(linear_to_srgb(values["Combined.R"])[solid], drawing.rgb[..., 0][solid], atol=0.02)
    assert values["Vector.X"].any() and values["Vector.X"].dtype == np.float32
    write_exr(tmp_path / "half.exr", {"R": np.ones((2, 3), np.float16)})
    assert library.File(str(tmp_path / "half.exr"), separate_channels=True).channels()["R"].pixels.dtype == np.float16


def test_the_reader_takes_views_to_the_scene(scene: ScenePlayer, tmp_path: Path) -> None:
    (view,) = read_cameras(write_cameras(tmp_path / "c.json", scene, {"frame": 1.5, "number": 4}), scene.header)
    assert isinstance(view, View) and (view.number, view.frame) == (4, 1.5)
    np.testing.assert_allclose(view.camera.world_to_camera, scene.header.cameras[0].world_to_camera, atol=1e-12)
