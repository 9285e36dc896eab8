"""The example without a window: with the add-on beside it, and with the extension that a Blender has."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import bpy
import pytest
from support.blender_windows import another_blender

from frog_blender.engine.scene.scene_file import read_scene

ROOT = Path(__file__).resolve().parents[2]
ENABLE = """
import bpy, addon_utils
addon_utils.enable("bl_ext.user_default.frog_blender", default_set=True)
bpy.ops.wm.save_userpref()
"""


@pytest.mark.parametrize("has", [pytest.param("nothing", marks=pytest.mark.slow), "extension that is on"])
def test_it_trains_and_renders(tmp_path, monkeypatch, has):
    pytest.importorskip("torch")
    pytest.importorskip("cv2")
    if not bpy.app.binary_path and bpy.app.version < (5, 0):
        pytest.skip("the bpy 4.5 module never leaves while any script's handler is registered")
    capture = pytest.importorskip("support.synthetic_capture").write_capture(tmp_path / "capture")
    resources, cache = tmp_path / "user", tmp_path / "cache"
    resources.mkdir()
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(resources), "FROG_CACHE": str(cache)}
    if has != "nothing":
        extension = resources / "extensions" / "user_default" / "frog_blender"
        shutil.copytree(ROOT / "frog_blender", extension, ignore=shutil.ignore_patterns("__pycache__"))
        shutil.copy(ROOT / "blender_manifest.toml", extension)
    if has == "extension that is on":
        (tmp_path / "enable.py").write_text(ENABLE)
        command = [word for word in another_blender(tmp_path / "enable.py") if word != "--factory-startup"]
        subprocess.run(command, env=environment, check=True, capture_output=True, timeout=120)
    command = another_blender(ROOT / "examples" / "headless.py", capture, tmp_path / "out", "--steps", 4)
    command = [word for word in command if word != "--factory-startup"]
    if not bpy.app.binary_path:
        command[1:1] = ["-P"]  # or the folder beside the script could stand in for the extension
    ended = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=400, cwd=tmp_path)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    for text in ("Traceback", "has been registered before"):
        assert text not in ended.stdout + ended.stderr, ended.stdout + ended.stderr
    scene = read_scene(tmp_path / "out" / "scene.frog").header
    assert len(list((tmp_path / "out" / "frames").iterdir())) == scene.frame_count
    assert scene.recipe["capacity"] == "auto"
