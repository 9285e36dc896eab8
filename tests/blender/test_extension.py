"""The zip that users install: built and validated with Blender's own tool, installed into a throw-away folder."""

from __future__ import annotations

import ast
import json
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path, PurePosixPath

import bpy
import pytest
from support.small_scenes import rig_of_three, write_scene

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


@pytest.fixture(scope="module", params=["training", "player"])
def edition(request):
    return request.param


@pytest.fixture(scope="module")
def extension(edition, tmp_path_factory):
    if bpy.app.binary_path:
        pytest.skip("the extension is built with the bpy module's own tool")
    folder = tmp_path_factory.mktemp("extension")
    command = [sys.executable, str(ROOT / "tools" / "build_extension.py"), "--edition", edition]
    command += ["--output", str(folder), "--work", str(folder / "work")]
    command += ["--index", str(folder / "repository")] if edition == "training" else []
    result = subprocess.run(command, capture_output=True, text=True)
    if "could not be fetched" in result.stderr:
        pytest.skip("the safetensors wheel cannot be fetched here")
    assert result.returncode == 0, result.stdout + result.stderr
    return next(folder.glob("*.zip"))


def test_the_repository_lists_the_edition_that_trains(edition, extension):
    if edition == "player":
        pytest.skip("Blender's own repository serves the player")
    listed = json.loads((extension.parent / "repository" / "index.json").read_text())["data"]
    assert [(entry["id"], entry["name"]) for entry in listed] == [("frog_blender", "FRoG")]
    assert listed[0]["archive_url"].endswith(extension.name) and "network" in listed[0]["permissions"]


def test_the_player_runs_no_code_from_elsewhere(edition, extension):
    with zipfile.ZipFile(extension) as archive:
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        sources = {name: archive.read(name).decode() for name in archive.namelist() if name.endswith(".py")}
    changes_path, downloads = r"sys\.path(\.\w+\(|\[.*\] =)", r"urllib\.request|urlopen|http\.client|\"-m\", \"pip\""
    outside = re.compile(f"{changes_path}|{downloads}")
    found = {name for name, source in sources.items() if outside.search(source)}
    if edition == "training":
        assert manifest["name"] == "FRoG" and "network" in manifest["permissions"] and found
        return
    assert manifest["name"] == "FRoG Player" and set(manifest["permissions"]) == {"files"}
    assert not found


def test_zip_holds_what_playing_needs_and_no_more(extension):
    names = zipfile.ZipFile(extension).namelist()
    assert "blender_manifest.toml" in names and "__init__.py" in names and "LICENSE" in names
    assert any(Path(name).stem.endswith("frog_native") for name in names), "the native library is missing"
    assert any(name.startswith("wheels/safetensors") for name in names)
    assert not any("__pycache__" in name or name.startswith("tests") for name in names)
    assert not any(name.startswith(("cli/", "experiments/")) for name in names), "nothing in Blender uses these"


class Unguarded(ast.NodeTransformer):
    """Leaves out what only the edition that trains, or a type checker, imports."""

    def visit_If(self, node: ast.If) -> ast.AST:
        if ast.unparse(node.test) in ("edition.TRAINS", "TYPE_CHECKING"):
            return ast.Module(node.orelse, [])
        return self.generic_visit(node)


def imported(path: PurePosixPath, source: str, edition: str) -> Iterator[str]:
    """The files, without suffix, of what a module imports from the package, those for type checkers included in the
    edition that trains."""
    tree: ast.AST = ast.parse(source)
    if edition == "player":
        tree = Unguarded().visit(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            folder = path.parts[: -node.level]
            module = [*folder, *(node.module.split(".") if node.module else [])]
            yield from ("/".join([*module, alias.name]) for alias in node.names)


def test_zip_lacks_nothing_that_it_imports(edition, extension):
    with zipfile.ZipFile(extension) as archive:
        names = [PurePosixPath(name) for name in archive.namelist()]
        modules = {str(name.with_suffix("")).removesuffix("/__init__") for name in names if name.suffix == ".py"}
        sources = {name: archive.read(str(name)).decode() for name in names if name.suffix == ".py"}
    found = [(name, file) for name, source in sources.items() for file in imported(name, source, edition)]
    assert len(found) > 300
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
