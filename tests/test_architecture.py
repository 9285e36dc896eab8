"""The rooms of the package, and who may enter which."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.builders import REPOSITORY, run_python

PACKAGE = REPOSITORY / "frog_blender"
ENGINE = PACKAGE / "engine"
FILES = sorted(PACKAGE.rglob("*.py"))
ENGINE_FILES = sorted(ENGINE.rglob("*.py"))


def is_for_types_only(node: ast.AST) -> bool:
    return isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)


def imports(path: Path, *, also_inside_functions: bool = True) -> Iterator[str]:
    """Absolute names of the modules that a file imports; those for type checkers are left out."""
    package = path.relative_to(REPOSITORY).with_suffix("").parts[:-1]

    def walk(nodes: list[ast.stmt]) -> Iterator[ast.AST]:
        for node in nodes:
            if is_for_types_only(node):
                continue
            yield node
            for child in ast.iter_child_nodes(node):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not also_inside_functions:
                    continue
                yield from walk([child])  # type: ignore[list-item]

    for node in walk(ast.parse(path.read_text(encoding="utf-8")).body):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def room_of(module: str) -> str | None:
    """``training`` for ``frog_blender.engine.training.session.job``; None for what is no room of the engine."""
    parts = module.split(".")
    if parts[:2] != ["frog_blender", "engine"] or len(parts) < 3:
        return None
    return parts[2] if (ENGINE / parts[2]).is_dir() else None


def name_of(path: Path) -> str:
    return str(path.relative_to(PACKAGE))


MAY_IMPORT = {
    "capture": set(),
    "conditions": {"capture"},
    "rasterizer": {"capture"},
    "model": {"capture", "rasterizer"},
    "inference": {"capture", "rasterizer", "model"},
    "evaluation": {"capture", "rasterizer", "model", "inference"},
    "training": {"capture", "rasterizer", "model", "inference", "evaluation"},
    "comparison": {"capture", "conditions", "rasterizer", "model", "inference", "evaluation", "training"},
}


def test_every_room_is_known() -> None:
    rooms = {path.name for path in ENGINE.iterdir() if path.is_dir() and (path / "__init__.py").exists()}
    assert rooms == set(MAY_IMPORT)


@pytest.mark.parametrize("path", ENGINE_FILES, ids=name_of)
def test_data_flows_one_way(path: Path) -> None:
    found = list(imports(path))
    forbidden = [name for name in found if name.split(".")[0] in ("bpy", "mathutils", "gpu", "bpy_extras")]
    assert not forbidden, "the engine knows nothing of Blender"
    room = room_of(".".join(path.relative_to(REPOSITORY).with_suffix("").parts))
    for name in found:
        if name.startswith("frog_blender."):
            assert name.startswith("frog_blender.engine"), f"{name} lies above the engine"
        if room is not None and (other := room_of(name)) is not None:
            assert other == room or other in MAY_IMPORT[room], f"{room} must not import {other}"


PLAYBACK = [ENGINE / "files.py", ENGINE / "errors.py", *sorted((ENGINE / "inference").glob("*.py"))]


@pytest.mark.parametrize("path", [*PLAYBACK, *sorted((ENGINE / "evaluation").glob("*.py"))], ids=name_of)
def test_playback_never_names_torch(path: Path) -> None:
    assert not [name for name in imports(path) if name.split(".")[0] == "torch"]


@pytest.mark.parametrize("path", sorted((ENGINE / "capture").rglob("*.py")), ids=name_of)
def test_opening_a_capture_never_names_torch(path: Path) -> None:
    assert not [name for name in imports(path) if name.split(".")[0] == "torch"]


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_nothing_heavy_is_imported_at_the_top_outside_training(path: Path) -> None:
    """Registering the add-on must not wait for what only some users have."""
    room = room_of(".".join(path.relative_to(REPOSITORY).with_suffix("").parts))
    if room in ("training", "model") or path.parent.name in ("rasterizer", "cuda"):
        allowed = {"torch"}
    else:
        allowed = set()
    heavy = {"torch", "pycolmap", "matplotlib", "imageio_ffmpeg", "scipy"} - allowed
    top = {name.split(".")[0] for name in imports(path, also_inside_functions=False)}
    assert not top & heavy


IMPORTED = """
import sys
sys.modules["torch"] = sys.modules["bpy"] = None
import {modules}
print(sorted(name for name, module in sys.modules.items() if module and name.split(".")[0] in {heavy}))
"""


@pytest.mark.parametrize(
    "modules",
    [
        "frog_blender",
        "frog_blender.cli.main",
        "frog_blender.engine.playback.player, frog_blender.engine.playback.render",
    ],
)
def test_importing_needs_neither_blender_nor_torch(modules: str) -> None:
    run = run_python(IMPORTED.format(modules=modules, heavy=("torch", "bpy", "cv2", "matplotlib", "pycolmap")))
    assert (run.returncode, run.stdout.strip()) == (0, "[]"), run.stderr


def calls(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Call):
            yield ast.unparse(node.func)


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_nothing_is_unpickled_or_evaluated(path: Path) -> None:
    assert not {name.split(".")[0] for name in imports(path)} & {"pickle", "marshal", "shelve", "dill", "joblib"}
    assert not {name for name in calls(path) if name in ("eval", "exec", "torch.load", "torch.save", "compile")}
    text = path.read_text(encoding="utf-8")
    assert "allow_pickle=True" not in text
    if "np.load(" in text:
        assert text.count("np.load(") == text.count("allow_pickle=False")


@pytest.mark.parametrize("path", FILES, ids=name_of)
def test_files_are_short_and_say_what_they_are_for(path: Path) -> None:
    text = path.read_text(encoding="utf-8")
    assert len(text.splitlines()) <= 350
    if text.strip():
        assert ast.get_docstring(ast.parse(text)), "a sentence at the top"


def test_kernels_are_short_too() -> None:
    kinds = (".cpp", ".h", ".inl", ".cu", ".cuh")
    sources = [path for path in (ENGINE / "rasterizer").rglob("*") if path.suffix in kinds]
    assert len(sources) > 20
    assert all(len(path.read_text().splitlines()) <= 250 for path in sources)
