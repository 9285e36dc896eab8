"""Scenes to and from other programs: frog -> ply -> frog is the same scene, and no trained scene is written over."""

import zipfile
from pathlib import Path

import numpy as np
import pytest
from support import foreign_files
from support.builders import refused, scene_file
from support.foreign_takes import assert_plays_alike

from frog_blender.cli.main import main
from frog_blender.engine.gaussians import LOW_PASS
from frog_blender.engine.interchange.frame_files import export_frames, write_frame
from frog_blender.engine.interchange.imports import free_scene_path, import_scene
from frog_blender.engine.interchange.ply import PROMISE, read_splats
from frog_blender.engine.interchange.take import scene_take
from frog_blender.engine.interchange.usd_export import write_usd
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.playback.transform import Y_DOWN, transform
from frog_blender.engine.scene.scene_file import read_scene, write_scene


@pytest.fixture
def trained(tmp_path: Path) -> Path:
    """Seven frames of forty Gaussians that move."""
    write_scene(tmp_path / "x.frog", scene_file(sh_count=16))
    return tmp_path / "x.frog"


def test_the_command_turns_z_up_to_y_down(trained: Path, tmp_path: Path) -> None:
    """Places and colours; as they are unless it is told to."""
    before = ScenePlayer.load(trained).at_frame(3)
    for options, turn in (([], np.eye(4)), (["--y-down"], Y_DOWN)):
        assert main(["export", str(trained), "--frames", "3:4", "--out", str(tmp_path), *options]) == 0
        actual, expected = read_splats(tmp_path / "x_0003.ply").gaussians, transform(before, turn)
        for name in ("means", "scales", "sh"):
            np.testing.assert_allclose(getattr(actual, name), getattr(expected, name), rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(Y_DOWN @ (0, 0, 1, 1), (0, -1, 0, 1))  # up


@pytest.mark.parametrize("ending", ["ply", "usda"])
def test_what_comes_back_is_drawn_as_before(trained: Path, tmp_path: Path, ending: str) -> None:
    scene, path = ScenePlayer.load(trained), tmp_path / f"back.{ending}"
    assert scene.header.low_pass == 0.1 != LOW_PASS
    if ending == "ply":
        path = next(export_frames(scene, [2], path))
    else:
        list(write_usd(path, scene_take(scene, "x", [2]), full_precision=True))
    back = ScenePlayer.load(import_scene(path, tmp_path / "back.frog").path)
    assert back.header.low_pass == 0.1
    images = [draw(each, scene.header.cameras[0]).rgb for each in (scene.at_frame(2), back.at_frame(0))]
    np.testing.assert_allclose(*images, atol=2e-3)


def test_no_trained_scene_is_written_over(trained: Path, tmp_path: Path) -> None:
    """x.frog lies beside x.ply, which was exported from it."""
    path = tmp_path / "x.ply"
    next(export_frames(ScenePlayer.load(trained), [0], tmp_path / "x.ply")).rename(path)
    target = free_scene_path(path)
    assert target.name == "x_ply.frog"
    import_scene(path, target)
    assert free_scene_path(path) == target  # once more: the same file
    target.write_bytes(b"something else")
    assert free_scene_path(path).name == "x_ply2.frog"
    trained.unlink()
    assert free_scene_path(path) == trained


def test_a_bad_import_changes_nothing(trained: Path, tmp_path: Path) -> None:
    before = trained.read_bytes()
    (tmp_path / "bad.ply").write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    refused("no Gaussians", import_scene, tmp_path / "bad.ply", trained)
    refused(r"ends in \.frog", import_scene, tmp_path / "bad.ply", tmp_path / "x.blend")
    assert trained.read_bytes() == before and len(list(tmp_path.iterdir())) == 2


def test_a_map_s_places_in_double_precision_keep_their_details(
    scene: ScenePlayer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Gaussians five million units away, where a float32 has steps of half a unit."""
    before, source = scene.at_frame(0), tmp_path / "map.ply"
    before.scales = before.scales * np.float32(0.1)
    source.write_bytes(foreign_files.double_ply(before))
    imported = import_scene(source, tmp_path / "map.frog")
    after = read_scene(imported.path)
    places = after.arrays["means"].astype(np.float64) + np.array(after.header.world.origin)
    np.testing.assert_allclose(places, before.means + np.array([5e6, 0, 0]), atol=1e-5)
    assert "they are (5000" in imported.warning and imported.warning.endswith(" + the scene's coordinates.")
    assert main(["info", str(imported.path)]) == 0
    assert "the files' coordinates are (5000" in capsys.readouterr().out
    source.write_bytes(foreign_files.double_ply(before, 0.0))
    assert read_splats(source).world.is_plain


def test_our_frames_come_back_as_what_plays(
    scene: ScenePlayer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    frames = tmp_path / "frames"
    assert main(["export", str(tmp_path / "x.frog"), "--out", str(frames)]) == 0
    assert PROMISE.encode() in (frames / "x_0003.ply").read_bytes()
    assert main(["import", str(frames), "--fps", "24", "--out", str(tmp_path / "back.frog")]) == 0
    assert "40 Gaussians, 7 frames" in capsys.readouterr().out
    back = ScenePlayer.load(tmp_path / "back.frog")
    assert back.header.frames_per_second == 24
    assert_plays_alike(back, scene.at_frame, [0, 3, 6], 1e-5)
    before, after, between = (back.at_frame(frame).means for frame in (2, 3, 2.5))
    np.testing.assert_allclose(between, (before + after) / 2, atol=1e-6)


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_varying_counts_of_a_zip(scene: ScenePlayer, tmp_path: Path, compression: int) -> None:
    """In the order of the numbers in their names: 10 comes after 9."""
    counts = [30, 40, 35, 1, 40, 20, 28]
    (tmp_path / "take.zip").write_bytes(foreign_files.zipped(scene, compression, counts))
    imported = import_scene(tmp_path / "take.zip", tmp_path / "back.frog")
    assert (imported.gaussians, imported.frames, imported.keeps_identity) == (40, 7, False)
    assert "by place alone" in imported.warning
    back = ScenePlayer.load(imported.path)
    for frame, count in enumerate(counts):
        actual, expected = back.at_frame(frame), scene.at_frame(frame)
        np.testing.assert_allclose(actual.means[:count], expected.means[:count], atol=1e-6)
        assert not actual.opacities[count:].any()
        np.testing.assert_array_equal(back.at_frame(min(frame + 0.9, 6)).means, actual.means)
    assert not back.keeps_identity and scene.keeps_identity
    for path in export_frames(back, [0, 1], tmp_path / "again" / "x.ply"):
        assert PROMISE.encode() not in path.read_bytes(), "its rows are other Gaussians in each frame"


def test_a_frame_that_is_bad_is_named(scene: ScenePlayer, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    assert main(["export", str(tmp_path / "x.frog"), "--out", str(frames)]) == 0
    (frames / "x_0004.ply").write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    refused(r"x_0004\.ply: found no Gaussians", import_scene, frames, tmp_path / "back.frog")
    (tmp_path / "empty").mkdir()
    refused(r"found 0 \.ply files", import_scene, tmp_path / "empty", tmp_path / "back.frog")
    assert not (tmp_path / "back.frog").exists()


def test_the_folder_where_one_is(scene: ScenePlayer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its frames have whatever names, and what an import left that was killed goes."""
    (tmp_path / "take" / "below").mkdir(parents=True)
    for frame, name in enumerate(("1²2.ply", "9.ply", "10.ply")):
        write_frame(tmp_path / "take" / name, scene.at_frame(frame))
    part = tmp_path / ".take.frog.0123abcd.part"
    part.write_bytes(b"half")
    for folder, name in (("take", "."), ("take/below", "..")):
        monkeypatch.chdir(tmp_path / folder)
        assert main(["import", name]) == 0
        assert ScenePlayer.load(tmp_path / "take.frog").header.frame_count == 3
        assert not part.exists()
    refused("without a name", free_scene_path, Path("/"))
