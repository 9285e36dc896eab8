"""What needs a window: every operator invoked as a window does, and what is dropped into one.

Where there is no window, Blender runs ``execute`` though a script asks for ``invoke``.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
import pytest
from support.blender_windows import another_blender
from support.small_scenes import rig_of_three, write_scene

from frog_blender.engine.interchange.ply import write_splats
from frog_blender.engine.playback.player import ScenePlayer

HERE = Path(__file__).parent


@pytest.fixture
def display() -> Iterator[str]:
    """A screen that nobody sees."""
    if not bpy.app.binary_path:
        pytest.skip("the bpy module has no windows")
    if shutil.which("Xvfb") is None:
        pytest.skip("needs Xvfb")
    reading, writing = os.pipe()
    command = ["Xvfb", "-displayfd", str(writing), "-screen", "0", "1280x800x24", "+extension", "GLX"]
    server = subprocess.Popen(command, pass_fds=[writing], stderr=subprocess.DEVNULL)
    os.close(writing)
    try:
        with os.fdopen(reading) as numbers:
            yield f":{int(numbers.readline())}"
    finally:
        server.terminate()
        server.wait()


@pytest.mark.slow
def test_every_operator_is_invoked_as_a_window_does(display: str, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    scene = write_scene(tmp_path / "a.frog", rig_of_three())
    splats, capture, result = tmp_path / "s.ply", tmp_path / "capture", tmp_path / "result.json"
    write_splats(splats, ScenePlayer.load(scene).at_frame(0))
    pytest.importorskip("support.synthetic_capture").write_capture(capture)
    words = another_blender(HERE / "window_script.py", HERE.parents[1], scene, splats, capture, result)
    words.remove("-b")
    environment = os.environ | {"DISPLAY": display, "LIBGL_ALWAYS_SOFTWARE": "1"}
    words[1:1] = ["--gpu-backend", "opengl"]
    ended = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=300)
    assert result.is_file(), ended.stdout + ended.stderr
    found: dict[str, Any] = json.loads(result.read_text())
    assert not found["errors"], "\n".join(found["errors"])
    assert "Traceback" not in ended.stderr, ended.stderr
    assert found["tabs"] == ["FRoG", "FRoG"] and found["captures"] == 1
    operators = found["operators"]
    assert operators["drop scene"] == operators["drop ply"] == ["RUNNING_MODAL"], "they ask for options"
    assert operators["drop videos"] == operators["menu"] == ["FINISHED"]
    assert operators["click points"] == ["RUNNING_MODAL"] and found["image"] == [48, 36]
    assert len(operators) > 20 and operators["import_scene.frog"] == operators["frog.bake"] == ["RUNNING_MODAL"]
