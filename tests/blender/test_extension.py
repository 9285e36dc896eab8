"""The zip that users install: built and validated with Blender's own tool, installed into a throw-away folder."""

import ast
import io
import json
import os
import platform
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import bpy
import pytest
from support.blender_windows import another_blender, said_by, script
from support.small_scenes import rig_of_three, write_scene
from support.wheels import native_wheel

ROOT = Path(__file__).resolve().parents[2]
BUILD = (ROOT / "tools" / "build_extension.py").read_text()
SYSTEMS = ("linux", "macos", "windows")

PLATFORM = {"linux": "linux", "darwin": "macos", "win32": "windows"}[sys.platform]
OURS = f"{PLATFORM}-{'arm64' if platform.machine().lower() in {'arm64', 'aarch64'} else 'x64'}"
ANOTHER = "windows-x64" if OURS != "windows-x64" else "linux-x64"
INSTALL = """
import os, pathlib, sys, bpy
archive, scene_file, folder = sys.argv[-3:]
folder = pathlib.Path(folder)
bpy.ops.extensions.package_install_files(filepath=archive, repo="user_default", enable_on_install=True)
name = "bl_ext.user_default.frog_blender"
assert name in bpy.context.preferences.addons, list(bpy.context.preferences.addons.keys())
assert bpy.context.preferences.addons[name].preferences is not None
assert "frog_blender" not in sys.modules and "torch" not in sys.modules
bpy.ops.import_scene.frog(filepath=scene_file)
scene, capture = bpy.context.scene, bpy.data.objects["figure Gaussians"]

def points(frame):
    scene.frame_set(frame)
    positions = capture.data.attributes["position"].data
    return [value for point in positions for value in point.vector]

assert points(1) != points(5) and len(points(5)) == 180, "scrubbing moves the points"

def still(file):
    scene.render.filepath = str(folder / file)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(folder / file))
    return list(image.pixels)

before = still("before.png")
capture.frog_edits.grade.exposure = 1.0
assert bpy.ops.frog.add_crop(shape="SPHERE") == {"FINISHED"}
after = still("after.png")
assert sum(after) != sum(before), "an edit is seen in the render"
bpy.ops.export_scene.frog_frames(filepath=str(folder / "frame.ply"))
assert (folder / "frame.ply").stat().st_size > 1000
import frog_blender_native
assert "site-packages" in frog_blender_native.__file__ and str(folder) in frog_blender_native.__file__
registered = sorted({"FROG_OT_train", "FROG_OT_install_torch", "FROG_OT_pick"} & set(dir(bpy.types)))
bpy.ops.preferences.addon_disable(module=name)
buttons = {"FROG_OT_train", "FROG_OT_install_torch", "FROG_OT_calibrate", "FROG_OT_capture_scene", "FROG_PT_train"}
assert not buttons & set(dir(bpy.types)), "nothing stays"
print("installed and drawn", registered)
sys.stdout.flush()
os._exit(0)  # the bpy 4.5 module never leaves by itself
"""


@pytest.fixture(scope="module", params=["training", "player"])
def edition(request):
    return request.param


def built(edition: str, folder: Path, *options: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(ROOT / "tools" / "build_extension.py"), "--edition", edition]
    command += ["--output", str(folder), "--work", str(folder / "work"), *map(str, options)]
    return subprocess.run(command, capture_output=True, text=True)


@pytest.fixture(scope="module")
def extension(edition, tmp_path_factory):
    """The zip; FROG_ZIPS names a folder with those of both editions, so that every Blender is given the same ones."""
    name = "frog_blender_player" if edition == "player" else "frog_blender"
    if given := os.environ.get("FROG_ZIPS"):
        return next(Path(given).resolve().glob(f"{name}-*-{OURS}.zip"))
    if bpy.app.binary_path:
        pytest.skip("the extension is built with the bpy module's own tool, or FROG_ZIPS names the folder of the zips")
    folder = tmp_path_factory.mktemp("extension")
    native_wheel(folder / "wheels")
    index = ["--index", folder / "repository"] if edition == "training" else []
    result = built(edition, folder, "--wheels", folder / "wheels", *index)
    if "could not be fetched" in result.stderr:
        pytest.skip("the safetensors wheel cannot be fetched here")
    assert result.returncode == 0, result.stdout + result.stderr
    return next(folder.glob("*.zip"))


@pytest.fixture
def archive(extension):
    with zipfile.ZipFile(extension) as archive:
        yield archive


@pytest.fixture
def sources(archive):
    """The content of each module in the zip."""
    return {name: archive.read(name).decode() for name in archive.namelist() if name.endswith(".py")}


def manifest_of(archive):
    return tomllib.loads(archive.read("blender_manifest.toml").decode())


def test_wheels_are_shipped_as_they_are(archive):
    manifest, names = manifest_of(archive), archive.namelist()
    wheels = {Path(wheel).name: archive.read(wheel.removeprefix("./")) for wheel in manifest["wheels"]}
    assert [name.split("-")[0] for name in wheels] == ["frog_blender_native", "safetensors"]
    assert all(wheel.startswith("./wheels/") for wheel in manifest["wheels"]) and manifest["platforms"] == [OURS]
    assert not [name for name in names if Path(name).suffix in (".so", ".dll", ".dylib")], "libraries are in wheels"
    native = next(content for name, content in wheels.items() if name.startswith("frog_blender_native"))
    with zipfile.ZipFile(io.BytesIO(native)) as wheel:
        assert any(Path(name).stem.endswith("frog_native") for name in wheel.namelist())
        assert wheel.testzip() is None


@pytest.mark.slow
@pytest.mark.skipif(bool(bpy.app.binary_path), reason="the bpy module's own tool builds extensions")
def test_the_native_wheel_is_compiled_where_none_is_given(tmp_path):
    result = built("player", tmp_path)
    assert result.returncode == 0, result.stdout + result.stderr
    with zipfile.ZipFile(next(tmp_path.glob("*.zip"))) as archive:
        (name,) = (name for name in archive.namelist() if name.startswith("wheels/frog_blender_native"))
        with zipfile.ZipFile(io.BytesIO(archive.read(name))) as wheel:
            assert any(Path(name).stem.endswith("frog_native") for name in wheel.namelist())


@pytest.fixture
def empty_wheels(tmp_path):
    """A folder of wheels with nothing in them, for three platforms."""
    folder = tmp_path / "wheels"
    folder.mkdir()
    version = tomllib.loads((ROOT / "blender_manifest.toml").read_text())["version"]
    for tag in ("manylinux_2_28_x86_64", "macosx_11_0_arm64", "win_amd64"):
        (folder / f"frog_blender_native-{version}-py3-none-{tag}.whl").write_bytes(tag.encode())
        (folder / f"safetensors-0.8.0-cp310-abi3-{tag}.whl").write_bytes(tag.encode())
    return folder


@pytest.mark.skipif(bool(bpy.app.binary_path), reason="the bpy module's own tool builds extensions")
def test_a_zip_for_another_platform_is_built_from_given_wheels(empty_wheels, tmp_path):
    result = built("player", tmp_path / "out", "--platform", ANOTHER, "--wheels", empty_wheels)
    assert result.returncode == 0, result.stdout + result.stderr
    with zipfile.ZipFile(next((tmp_path / "out").glob(f"*-{ANOTHER}.zip"))) as archive:
        manifest = manifest_of(archive)
        tags = {archive.read(wheel.removeprefix("./")).decode() for wheel in manifest["wheels"]}
    assert manifest["platforms"] == [ANOTHER] and len(manifest["wheels"]) == 2
    assert tags == {"win_amd64" if ANOTHER == "windows-x64" else "manylinux_2_28_x86_64"}


@pytest.mark.skipif(bool(bpy.app.binary_path), reason="the bpy module's own tool builds extensions")
def test_a_platform_without_the_wheel_of_this_version_is_a_sentence(tmp_path):
    for name in ("safetensors-0.8.0-cp310-abi3", "frog_blender_native-0.0.1-py3-none"):
        (tmp_path / f"{name}-win_arm64.whl").write_bytes(b"")
    result = built("player", tmp_path / "out", "--platform", "windows-arm64", "--wheels", tmp_path)
    assert result.returncode and "expected frog_blender_native" in result.stderr and "Traceback" not in result.stderr


def test_the_repository_lists_the_edition_that_trains(edition, extension):
    if edition == "player":
        pytest.skip("Blender's own repository serves the player")
    if not (extension.parent / "repository").is_dir():
        pytest.skip("FROG_ZIPS has no repository")
    listed = json.loads((extension.parent / "repository" / "index.json").read_text())["data"]
    assert [(entry["id"], entry["name"]) for entry in listed] == [("frog_blender", "FRoG")]
    assert listed[0]["archive_url"].endswith(extension.name) and "network" in listed[0]["permissions"]


def test_the_player_runs_no_code_from_elsewhere(edition, archive, sources):
    manifest = manifest_of(archive)
    changes_path, downloads = r"sys\.path(\.\w+\(|\[.*\] =)", r"urllib\.request|urlopen|http\.client|\"-m\", \"pip\""
    outside = re.compile(f"{changes_path}|{downloads}")
    files = {name for name, source in sources.items() if outside.search(source)}
    if edition == "training":
        assert manifest["name"] == "FRoG" and "network" in manifest["permissions"] and files
        return
    assert manifest["name"] == "FRoG Player" and set(manifest["permissions"]) == {"files"}
    assert not files


def test_zip_holds_what_playing_needs_and_no_more(archive):
    names = archive.namelist()
    assert "blender_manifest.toml" in names and "__init__.py" in names and "LICENSE" in names
    assert not any("__pycache__" in name or name.startswith("tests") for name in names)
    assert not any(name.startswith(("cli/", "research/")) for name in names), "nothing in Blender uses these"


class Unguarded(ast.NodeTransformer):
    """Leaves out what only the edition that trains, or a type checker, imports."""

    def visit_If(self, node: ast.If) -> ast.AST:
        if ast.unparse(node.test) in ("edition.TRAINS", "TYPE_CHECKING"):
            return ast.Module(node.orelse, [])
        return self.generic_visit(node)


def imported(path: str, source: str, edition: str) -> Iterator[str]:
    """The files, without suffix, of what a module imports from the package, those for type checkers included in the
    edition that trains."""
    tree: ast.AST = ast.parse(source)
    if edition == "player":
        tree = Unguarded().visit(tree)
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level:
            folder = path.split("/")[: -node.level]
            module = [*folder, *(node.module.split(".") if node.module else [])]
            yield from ("/".join([*module, alias.name]) for alias in node.names)


def test_zip_lacks_nothing_that_it_imports(edition, sources):
    modules = {name.removesuffix(".py").removesuffix("/__init__") for name in sources}
    imports = [(name, file) for name, source in sources.items() for file in imported(name, source, edition)]
    assert len(imports) > 300
    # A name is a module of its own, or something in the module before it.
    assert not [pair for pair in imports if not {pair[1], pair[1].rpartition("/")[0] or "__init__"} & modules]


def test_installed_zip_imports_scrubs_edits_renders_and_exports(edition, extension, tmp_path):
    path = write_scene(tmp_path / "figure.frog", rig_of_three())
    printed = said_by(another_blender(script(tmp_path, INSTALL), extension, path, tmp_path), tmp_path)
    buttons = ["FROG_OT_install_torch", "FROG_OT_pick", "FROG_OT_train"] if edition == "training" else ["FROG_OT_pick"]
    assert f"installed and drawn {buttons}" in printed, printed
    assert (tmp_path / "after.png").stat().st_size > 1000


def test_the_recipe_builds_every_platform_that_it_names():
    """Read as text: no YAML reader is needed for a few lines."""
    recipe = (ROOT / ".github" / "workflows" / "extension.yml").read_text()
    builds = re.findall(r"platform: ([a-z]+-[a-z0-9]+), runner: (\S+)", recipe)
    assert {name for name, _ in builds} == {f"{system}-{machine}" for system in SYSTEMS for machine in ("x64", "arm64")}
    assert {name for name, _ in builds} == set(re.findall(r'^    "([a-z]+-[a-z0-9]+)": \(', BUILD, re.MULTILINE))
