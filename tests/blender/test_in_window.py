"""What needs a window: every operator invoked as a window does, and what is dropped into one.

Where there is no window, Blender runs ``execute`` though a script asks for ``invoke``.
"""

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

from frog_blender.engine.interchange.frame_files import write_frame
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


def run_in_window(display: str, script: str, *arguments: Path) -> tuple[dict[str, Any], str]:
    """What a script of this folder wrote to the last of its arguments, and what was said on the way."""
    words = another_blender(HERE / script, HERE.parents[1], *arguments)
    words.remove("-b")
    environment = os.environ | {"DISPLAY": display, "LIBGL_ALWAYS_SOFTWARE": "1"}
    words[1:1] = ["--gpu-backend", "opengl"]
    ended = subprocess.run(words, env=environment, capture_output=True, text=True, timeout=300)
    assert arguments[-1].is_file(), ended.stdout + ended.stderr
    return json.loads(arguments[-1].read_text()), ended.stderr


@pytest.mark.slow
def test_every_operator_is_invoked_as_a_window_does(display: str, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    pytest.importorskip("av")
    scene = write_scene(tmp_path / "a.frog", rig_of_three())
    splats, capture, result = tmp_path / "s.ply", tmp_path / "capture", tmp_path / "result.json"
    write_frame(splats, ScenePlayer.load(scene).at_frame(0))
    pytest.importorskip("support.synthetic_capture").write_capture(capture)
    found, said = run_in_window(display, "window_script.py", scene, splats, capture, result)
    assert not found["errors"], "\n".join(found["errors"])
    assert "Traceback" not in said, said
    assert found["tabs"] == ["FRoG", "FRoG"] and found["captures"] == 1
    operators = found["operators"]
    assert operators["drop scene"] == operators["drop ply"] == ["RUNNING_MODAL"], "they ask for options"
    # in so short a time, or beside the window
    assert {*operators["drop videos"], *operators["menu"]} <= {"FINISHED", "RUNNING_MODAL"}
    assert len(operators) > 20 and operators["import_scene.frog"] == ["RUNNING_MODAL"]


@pytest.mark.slow
def test_splats_are_drawn_in_every_shading_mode(display: str, tmp_path: Path) -> None:
    scene = write_scene(tmp_path / "a.frog", rig_of_three(), count=200)
    found, said = run_in_window(display, "window_splats.py", scene, tmp_path / "result.json")
    assert not found["errors"], "\n".join(found["errors"])
    assert "Traceback" not in said and not found["failed"], said
    drawn = found["drawn"]
    assert all(drawn[mode] for mode in ("SOLID", "WIREFRAME", "MATERIAL", "another frame"))
    assert drawn["nothing new"] == 0
    assert found["lost"] == 0, "what Blender draws after the splats goes where they went"
    assert found["free"]["psnr"] >= 38 and found["free"]["step"] == 1
    hidden, whole = found["behind a cube"]["alpha"]
    assert whole > 0.3 and hidden < 0.3 * whole, "the cube is before the splats"
    assert found["points"] == {"rendered by FROG": False, "splats": False, "points": True}
