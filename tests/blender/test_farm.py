"""Frames on a farm: the same pixels however they are shared out, and a failure that a program notices."""

import subprocess
from pathlib import Path

import bpy
import pytest
from support.blender_windows import another_blender
from support.small_scenes import read_png

from frog_blender.render.compositing.renders import is_render

ROOT = Path(__file__).resolve().parents[2]
ENABLE = f"import sys; sys.path.insert(0, {str(ROOT)!r}); import frog_blender; frog_blender.register()"
IN_MODULE = f"""
{ENABLE}
import os
import bpy
_, blend, out, first, last = sys.argv
bpy.ops.wm.open_mainfile(filepath=blend)
scene = bpy.context.scene
scene.render.filepath, scene.frame_start, scene.frame_end = out, int(first), int(last)
bpy.ops.render.render(animation=True)
frog_blender.unregister()
if bpy.app.version < (5, 0):
    os._exit(0)
"""
"""The bpy 4.5 module never leaves by itself while any script's handler is registered."""


def render(folder: Path, out: Path, first: int, last: int) -> subprocess.CompletedProcess[str]:
    """Renders frames of ``folder``'s scene.blend in a Blender of its own."""
    blend, pattern = folder / "scene.blend", f"{out}/####"
    if bpy.app.binary_path:
        command = [bpy.app.binary_path, "-b", "--factory-startup", "--python-expr", ENABLE, str(blend)]
        command += ["-o", pattern, "-s", str(first), "-e", str(last), "-a"]
    else:
        (folder / "render.py").write_text(IN_MODULE)
        command = another_blender(folder / "render.py", blend, pattern, first, last)
    return subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=ROOT)


@pytest.fixture
def saved(empty, static_rig, tmp_path):
    """The folder of a scene.blend that plays a capture beside it, by a relative path."""
    assert bpy.ops.import_scene.frog(filepath=str(static_rig)) == {"FINISHED"}
    settings = empty.render
    settings.engine = "FROG"
    settings.image_settings.file_format = "PNG"
    empty.frame_start, empty.frame_end = 1, 10
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    bpy.ops.file.make_paths_relative()
    bpy.ops.wm.save_mainfile()
    return tmp_path


def test_frames_are_the_same_in_one_run_and_in_two(saved, tmp_path):
    for out, parts in (("whole", [(1, 6)]), ("parts", [(4, 6), (1, 3)])):
        for first, last in parts:
            ended = render(saved, tmp_path / out, first, last)
            assert ended.returncode == 0, ended.stdout + ended.stderr
    whole, parts = (sorted((tmp_path / out).iterdir()) for out in ("whole", "parts"))
    assert [path.name for path in whole] == [path.name for path in parts] == [f"{n:04}.png" for n in range(1, 7)]
    pixels = [read_png(path).tobytes() for path in whole]  # the files have their dates
    assert pixels == [read_png(path).tobytes() for path in parts]
    assert len(set(pixels)) > 3, "something moves"


def test_a_missing_scene_file_is_an_exit_status(saved, static_rig, tmp_path):
    if not bpy.app.binary_path and bpy.app.version < (5, 0):
        pytest.skip("the bpy 4.5 module has no exit status, see IN_MODULE")
    static_rig.unlink()
    ended = render(saved, tmp_path / "out", 1, 2)
    assert ended.returncode == 1, ended.stdout + ended.stderr
    assert "figure.frog" in ended.stdout + ended.stderr
    assert not list((tmp_path / "out").glob("*0002.png")), "the animation ends with the image that failed"


def test_what_a_command_line_asks_for():
    for arguments in ("-a", "-y --render-output /o --render-frame 1..10", "-f 3 -- --steps 4"):
        assert is_render(["blender", "-b", "x.blend", *arguments.split()]), arguments
    for arguments in ("-b --python x.py -- -a", "x.blend"):
        assert not is_render(["blender", *arguments.split()]), arguments
