"""Folders and zips of ``.ply`` frames as a capture that plays, and the promise that ours make."""

from __future__ import annotations

import zipfile
from pathlib import Path

import numpy as np
import pytest
from support import foreign_files
from support.foreign_takes import assert_plays_alike, partly_static

from frog_blender.cli.main import main
from frog_blender.engine.errors import FrogError
from frog_blender.engine.interchange.frame_files import export_frames
from frog_blender.engine.interchange.imports import free_scene_path, import_scene
from frog_blender.engine.interchange.ply import PROMISE, write_splats
from frog_blender.engine.playback.player import ScenePlayer


@pytest.fixture
def scene(tmp_path: Path) -> ScenePlayer:
    return partly_static(tmp_path)


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


def test_one_file_promises_nothing(scene: ScenePlayer, tmp_path: Path) -> None:
    write_splats(tmp_path / "x.ply", scene.at_frame(0))
    assert b"comment" not in (tmp_path / "x.ply").read_bytes()


@pytest.mark.parametrize("compression", [zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED])
def test_varying_counts_of_a_zip(scene: ScenePlayer, tmp_path: Path, compression: int) -> None:
    """In the order of the numbers in their names: 10 comes after 9."""
    counts = [30, 40, 35, 40, 20, 28, 33]
    (tmp_path / "take.zip").write_bytes(foreign_files.zipped(scene, compression, counts))
    imported = import_scene(tmp_path / "take.zip", tmp_path / "back.frog")
    assert (imported.gaussians, imported.frames, imported.keeps_identity) == (40, 7, False)
    back = ScenePlayer.load(imported.path)
    for frame, count in enumerate(counts):
        found, expected = back.at_frame(frame), scene.at_frame(frame)
        np.testing.assert_allclose(found.means[:count], expected.means[:count], atol=1e-6)
        assert not found.opacities[count:].any()
    assert not back.keeps_identity and scene.keeps_identity
    for path in export_frames(back, [0, 1], tmp_path / "again" / "x.ply"):
        assert PROMISE.encode() not in path.read_bytes(), "its rows are other Gaussians in each frame"


def test_a_frame_that_is_bad_is_named(scene: ScenePlayer, tmp_path: Path) -> None:
    frames = tmp_path / "frames"
    assert main(["export", str(tmp_path / "x.frog"), "--out", str(frames)]) == 0
    (frames / "x_0004.ply").write_bytes(b"ply\nformat ascii 1.0\nend_header\n")
    with pytest.raises(FrogError, match=r"x_0004\.ply: found the format ascii"):
        import_scene(frames, tmp_path / "back.frog")
    (tmp_path / "empty").mkdir()
    with pytest.raises(FrogError, match=r"found 0 \.ply files"):
        import_scene(tmp_path / "empty", tmp_path / "back.frog")
    assert not (tmp_path / "back.frog").exists()


def test_a_zip_that_unpacks_to_too_much_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "bomb.zip", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("a.ply", b"ply\n" + bytes(20_000_000))
    content = bytearray((tmp_path / "bomb.zip").read_bytes())
    at = content.rindex(b"PK\x01\x02")
    content[at + 24 : at + 28] = (2**31).to_bytes(4, "little")  # its size, as the directory says
    (tmp_path / "bomb.zip").write_bytes(content)
    with pytest.raises(FrogError, match="what its size allows for"):
        import_scene(tmp_path / "bomb.zip", tmp_path / "back.frog")


def test_the_folder_where_one_is(scene: ScenePlayer, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Its frames have whatever names, and what an import left that was killed goes."""
    (tmp_path / "take" / "below").mkdir(parents=True)
    for frame, name in enumerate(("1²2.ply", "9.ply", "10.ply")):
        write_splats(tmp_path / "take" / name, scene.at_frame(frame))
    part = tmp_path / ".take.frog.0123abcd.part"
    part.write_bytes(b"half")
    for folder, name in (("take", "."), ("take/below", "..")):
        monkeypatch.chdir(tmp_path / folder)
        assert main(["import", name]) == 0
        assert ScenePlayer.load(tmp_path / "take.frog").header.frame_count == 3
        assert not part.exists()
    with pytest.raises(FrogError, match="without a name"):
        free_scene_path(Path("/"))


def test_arguments_that_would_do_nothing_are_refused(
    scene: ScenePlayer, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    write_splats(tmp_path / "a.ply", scene.at_frame(0))
    out = ["--out", str(tmp_path / "out")]
    for arguments in (
        ["import", str(tmp_path / "a.ply"), "--fps", "24"],
        ["export", str(tmp_path / "x.frog"), "--float", *out],
        ["export", str(tmp_path / "x.frog"), "--silent", "--spz", *out],
    ):
        assert main(arguments) == 1
        assert f"{next(each for each in arguments if each in ('--fps', '--float', '--silent'))}: found" in (
            capsys.readouterr().err
        )
    assert not (tmp_path / "out").exists() and not (tmp_path / "a.frog").exists()
