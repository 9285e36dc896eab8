"""What the command line says: files' texts without what commands a terminal, and the end of a training."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from support.builders import scene_file

from frog_blender.cli.main import main
from frog_blender.cli.progress import show
from frog_blender.cli.terminal import complain, say
from frog_blender.engine.errors import FrogError, brief, found_instead, printable
from frog_blender.engine.scene.scene_file import SceneFile, write_scene
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.output_paths import checkpoint_path

EVIL = "\x1b]0;owned\x07\x1b[31mred\r\nfrog: all is well\x9b2J\u2028\u202etxt\0\ud800"


def test_controls_are_written_out_and_what_is_printable_stays() -> None:
    for text in ("", "cam 00", "C:\\Küche\\厨房", "👩‍💻", "نیم‌فاصله", "a b"):
        assert printable(text) == text
    assert printable("a\x1b[2Jb\n\t\x7f") == "a\\x1b[2Jb\\n\\t\\x7f"
    assert printable(EVIL).isprintable() and "red" in printable(EVIL)
    assert printable(Path("a\nb")) == "a\\nb" and printable(5) == "5"
    for error in (FrogError(EVIL), found_instead(EVIL, EVIL, EVIL), FrogError(Path("a\nb"))):
        assert str(error).isprintable()
    assert brief("a\nb") == "a b" and brief("x" * 1000) == f"{'x' * 300} ..." and brief("a\x1bb") == "a\\x1bb"


def test_commands_print_no_controls(capsys: pytest.CaptureFixture[str]) -> None:
    say(EVIL)
    complain(EVIL)
    for stream in capsys.readouterr():
        assert stream.count("\n") == 1 and stream[:-1].isprintable()


def test_what_a_scene_says_of_itself(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    scene = scene_file()
    evil = {
        "recipe": {"name": EVIL},
        "metrics": {EVIL: EVIL, "psnr": 30.0},
        "capture_path": EVIL,
        "capture_format": EVIL,
    }
    odd, *others = scene.header.cameras
    object.__setattr__(odd, "name", EVIL)  # as a hostile file has it
    header = replace(scene.header, cameras=(odd, *others), **evil)
    path = tmp_path / "x\x1b[2J.frog"
    write_scene(path, SceneFile(header, scene.arrays))
    assert main(["info", str(path)]) == 0
    told = capsys.readouterr().out
    assert all(line.isprintable() for line in told.split("\n")) and told.count("owned") == 3
    assert main(["info", str(path), "--json"]) == 0
    json.loads(capsys.readouterr().out)
    for arguments in (["render", str(path), "--camera", "a\x1bb"], ["export", str(path), "--frames", "9:\x1b"]):
        assert main([*arguments, "--out", str(tmp_path / "out")]) == 2
        complaint = capsys.readouterr().err
        assert complaint.count("\n") == 1 and complaint[:-1].isprintable()
    assert not (tmp_path / "out").exists()


def test_a_camera_of_any_name_is_rendered(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Into the folder that was named, and no other."""
    scene = scene_file()
    odd, *others = scene.header.cameras
    for index, name in enumerate(("../../evil", "..\\..\\evil", "C:evil", EVIL)):
        header = replace(scene.header, cameras=(replace(odd, name=name), *others))
        write_scene(tmp_path / "x.frog", SceneFile(header, scene.arrays))
        folder = tmp_path / str(index) / "out"
        command = ["render", str(tmp_path / "x.frog"), "--camera", printable(name), "--frames", "0:1"]
        assert main([*command, "--out", str(folder)]) == 0, capsys.readouterr().err
        (image,) = (tmp_path / str(index)).rglob("*.png")
        assert image.parent == folder and not set(image.name) & set('/\\:*?"<>|')


@pytest.mark.parametrize(
    ("place", "checkpoint", "said"),
    [
        ("out/x.frog", True, "kept in {place}; --resume goes on."),
        ("out/x.frog", False, "kept in {place}."),
        ("rescued/x.frog", True, "kept in {place}; --resume goes on from {checkpoint}."),
        ("rescued/x.frog", False, "kept in {place}."),
        (None, False, "nothing was written."),
    ],
)
def test_a_cancelled_training_says_what_can_be_resumed(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], place: str | None, checkpoint: bool, said: str
) -> None:
    """A scene that its disk did not take lies elsewhere; a checkpoint lies beside the output, or nowhere."""
    output = tmp_path / "out" / "x.frog"
    output.parent.mkdir()
    if checkpoint:
        checkpoint_path(output).write_bytes(b"")
    path = str(tmp_path / place) if place else None
    assert not show(iter([events.Cancelled(9, path)]), output)
    sentence = said.format(place=path, checkpoint=checkpoint_path(output))
    assert capsys.readouterr().err.rstrip().endswith(f"cancelled at step 9, {sentence}")
