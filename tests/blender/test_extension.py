"""The zip that users install: built and validated with Blender's own tool, installed into a throw-away folder."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import bpy
import pytest
from small_scenes import rig_of_three, write_scene

ROOT = Path(__file__).resolve().parents[2]

INSTALL = """
import sys, bpy, addon_utils
bpy.ops.extensions.package_install_files(filepath=sys.argv[1], repo="user_default", enable_on_install=True)
name = "bl_ext.user_default.frog_blender"
assert name in bpy.context.preferences.addons, list(bpy.context.preferences.addons.keys())
assert bpy.context.preferences.addons[name].preferences is not None
assert "frog_blender" not in sys.modules and "torch" not in sys.modules
bpy.ops.import_scene.frog(filepath=sys.argv[2])
bpy.context.scene.frame_set(5)
bpy.context.scene.render.filepath = sys.argv[3]
bpy.ops.render.render(write_still=True)
addon_utils.disable(name)
print("installed and drawn", "FROG_OT_train" not in dir(bpy.types))
"""


@pytest.fixture(scope="module")
def extension(tmp_path_factory):
    if bpy.app.binary_path:
        pytest.skip("the extension is built with the bpy module's own tool")
    folder = tmp_path_factory.mktemp("extension")
    command = [sys.executable, str(ROOT / "tools" / "build_extension.py"), "--output", str(folder), "--work"]
    result = subprocess.run([*command, str(folder / "work")], capture_output=True, text=True)
    if "could not be fetched" in result.stderr:
        pytest.skip("the safetensors wheel cannot be fetched here")
    assert result.returncode == 0, result.stdout + result.stderr
    return next(folder.glob("*.zip"))


def test_zip_holds_what_playing_needs_and_no_more(extension):
    names = zipfile.ZipFile(extension).namelist()
    assert "blender_manifest.toml" in names and "__init__.py" in names and "LICENSE" in names
    assert any(Path(name).stem.endswith("frog_native") for name in names), "the native library is missing"
    assert any(name.startswith("wheels/safetensors") for name in names)
    assert not any("__pycache__" in name or name.startswith("tests") for name in names)
    assert not any(name.startswith(("cli/", "experiments/")) for name in names), "nothing in Blender uses these"


def imported(path: PurePosixPath, source: str) -> Iterator[str]:
    """The files, without suffix, of what a module imports from the package, those for type checkers included."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.ImportFrom) and node.level:
            folder = path.parts[: -node.level]
            module = [*folder, *(node.module.split(".") if node.module else [])]
            yield from ("/".join([*module, alias.name]) for alias in node.names)


def test_zip_lacks_nothing_that_it_imports(extension):
    with zipfile.ZipFile(extension) as archive:
        names = [PurePosixPath(name) for name in archive.namelist()]
        modules = {str(name.with_suffix("")).removesuffix("/__init__") for name in names if name.suffix == ".py"}
        sources = {name: archive.read(str(name)).decode() for name in names if name.suffix == ".py"}
    found = [(name, file) for name, source in sources.items() for file in imported(name, source)]
    assert len(found) > 500
    # A name is a module of its own, or something in the module before it.
    lacking = [(str(name), file) for name, file in found if not {file, file.rpartition("/")[0] or "__init__"} & modules]
    assert not lacking


def test_installed_zip_imports_plays_and_renders(extension, tmp_path):
    path = write_scene(tmp_path / "figure.frog", rig_of_three())
    environment = os.environ | {"BLENDER_USER_RESOURCES": str(tmp_path / "user"), "PYTHONPATH": ""}
    command = [sys.executable, "-c", INSTALL, str(extension), str(path), str(tmp_path / "still.png")]
    result = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=tmp_path, timeout=180)
    assert "installed and drawn True" in result.stdout, result.stdout + result.stderr
    assert (tmp_path / "still.png").stat().st_size > 1000


def test_the_recipe_builds_every_platform_that_it_names():
    """Read as text: no YAML reader is needed for four lines."""
    recipe = (ROOT / ".github" / "workflows" / "extension.yml").read_text()
    found = re.findall(r"platform: ([a-z]+-[a-z0-9]+), runner: (\S+),", recipe)
    assert {name for name, _ in found} == {"linux-x64", "macos-arm64", "macos-x64", "windows-x64"}
    command = [sys.executable, str(ROOT / "tools" / "build_extension.py"), "--expect", "amiga-m68k"]
    if not bpy.app.binary_path:
        result = subprocess.run(command, capture_output=True, text=True)
        assert result.returncode and "expected amiga-m68k" in result.stderr
