"""What every file of the package keeps to. Who may import whom is import-linter's contract in pyproject.toml."""

import ast
import functools
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path

import pytest
from support.builders import REPOSITORY, run_python

from frog_blender.cli.main import main

PACKAGE = REPOSITORY / "frog_blender"
ENGINE = PACKAGE / "engine"
FILES = sorted(PACKAGE.rglob("*.py"))


@functools.cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text(encoding="utf-8"))


HEAVY = {"torch", "pycolmap", "matplotlib", "av", "PIL", "scipy"}


def imports(path: Path, *, also_inside_functions: bool = True) -> Iterator[str]:
    """Absolute names of the modules that a file imports; those for type checkers are left out."""
    package = path.relative_to(REPOSITORY).with_suffix("").parts[:-1]

    def walk(nodes: list[ast.stmt]) -> Iterator[ast.AST]:
        for node in nodes:
            if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
                continue
            yield node
            for child in ast.iter_child_nodes(node):
                if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and not also_inside_functions:
                    continue
                yield from walk([child])  # type: ignore[list-item]

    for node in walk(tree_of(path).body):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            yield module
            yield from (f"{module}.{alias.name}" for alias in node.names)


def test_the_contract_has_no_exceptions() -> None:
    """``make lint`` holds every room to the layers of ``pyproject.toml``."""
    settings = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["importlinter"]
    assert len(settings["contracts"]) >= 6 and "exclude_type_checking_imports" not in settings
    assert not [contract["name"] for contract in settings["contracts"] if "ignore_imports" in contract]
    layered = [contract for contract in settings["contracts"] if contract["type"] == "layers"]
    assert layered and all(contract["exhaustive"] for contract in layered)


def offenders(rule: Callable[[Path], Iterable[str]], files: Iterable[Path] = FILES) -> list[str]:
    """What breaks a rule of the house, as "file: what", a line each."""
    return [f"{path.relative_to(PACKAGE)}: {what}" for path in files for what in rule(path)]


def test_nothing_heavy_is_imported_at_the_top_outside_training() -> None:
    """Registering the add-on must not wait for what only some users have."""

    def heavy(path: Path) -> Iterable[str]:
        in_engine = ("training", "model", "rasterizer", "cuda")
        rooms = (*(ENGINE / room for room in in_engine), PACKAGE / "research" / "baselines")
        with_torch = any(path.is_relative_to(room) for room in rooms)
        top = {name.split(".")[0] for name in imports(path, also_inside_functions=False)}
        return top & HEAVY - ({"torch"} if with_torch else set())

    assert offenders(heavy) == []


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
        "frog_blender.cli.commands",
        "frog_blender.engine.playback.player, frog_blender.engine.playback.render",
    ],
)
def test_importing_needs_neither_blender_nor_torch(modules: str) -> None:
    run = run_python(IMPORTED.format(modules=modules, heavy=("torch", "bpy", "cv2", "matplotlib", "pycolmap")))
    assert (run.returncode, run.stdout.strip()) == (0, "[]"), run.stderr


def test_nothing_is_unpickled_or_evaluated() -> None:
    def unsafe(path: Path) -> Iterator[str]:
        modules = {name.split(".")[0] for name in imports(path)}
        yield from modules & {"pickle", "marshal", "shelve", "dill", "joblib"}
        calls = {ast.unparse(node.func) for node in ast.walk(tree_of(path)) if isinstance(node, ast.Call)}
        yield from calls & {"eval", "exec", "torch.load", "torch.save", "compile"}
        text = path.read_text(encoding="utf-8")
        if "allow_pickle=True" in text or text.count("np.load(") > text.count("allow_pickle=False"):
            yield "np.load with pickles"

    assert offenders(unsafe) == []


def test_files_are_short_and_say_what_they_are_for() -> None:
    def too_long_or_mute(path: Path) -> Iterator[str]:
        text = path.read_text(encoding="utf-8")
        if len(text.splitlines()) > 450:
            yield "over 450 lines"
        if text.strip() and not ast.get_docstring(tree_of(path)):
            yield "no sentence at the top"

    assert offenders(too_long_or_mute) == []


def test_kernels_are_short_too() -> None:
    kinds = (".cpp", ".h", ".inl", ".cu", ".cuh")
    sources = [path for path in ENGINE.rglob("*") if path.suffix in kinds]
    assert len(sources) > 20
    assert all(len(path.read_text().splitlines()) <= 250 for path in sources)


def functions(path: Path) -> Iterator[ast.FunctionDef | ast.AsyncFunctionDef]:
    for node in ast.walk(tree_of(path)):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield node


def test_functions_take_few_parameters_by_position() -> None:
    def crowded(path: Path) -> Iterator[str]:
        for function in functions(path):
            names = {argument.arg for argument in (*function.args.posonlyargs, *function.args.args)}
            if len(names - {"self", "cls"}) > 6:
                yield function.name

    assert offenders(crowded) == []


OPTIMIZE = ENGINE / "training" / "optimize"


def test_nobody_else_asks_for_the_whole_trainer() -> None:
    def takes_it(path: Path) -> Iterator[str]:
        for function in functions(path):
            arguments = [node.annotation for node in ast.walk(function.args) if isinstance(node, ast.arg)]
            annotations = [ast.unparse(node) for node in (*arguments, function.returns) if node is not None]
            if any(re.search(r"\bTrainer\b", annotation) for annotation in annotations):
                yield function.name

    assert offenders(takes_it, [path for path in FILES if not path.is_relative_to(OPTIMIZE)]) == []


MUTABLE = (ast.List, ast.Dict, ast.Set, ast.ListComp, ast.DictComp, ast.SetComp)
MUTABLE_TYPES = {"list", "dict", "set", "bytearray", "deque", "defaultdict", "Counter", "OrderedDict"}


def holds_state(value: ast.expr | None) -> bool:
    if isinstance(value, ast.Call):
        return ast.unparse(value.func).split("[")[0].split(".")[-1] in MUTABLE_TYPES
    return isinstance(value, MUTABLE)


def test_modules_keep_no_state() -> None:
    """Objects do; Blender's side finds them in ``addon_state``. Tables in capitals are constants."""

    def stateful(path: Path) -> Iterator[str]:
        tree = tree_of(path)
        yield from (name for node in ast.walk(tree) if isinstance(node, ast.Global) for name in node.names)
        for node in tree.body:
            if isinstance(node, ast.Assign | ast.AnnAssign) and holds_state(node.value):
                targets = node.targets if isinstance(node, ast.Assign) else [node.target]
                names = [ast.unparse(target) for target in targets]
                yield from (name for name in names if not (name.isupper() or name == "__all__"))

    assert offenders(stateful, [path for path in FILES if path.name != "addon_state.py"]) == []


def test_frog_prints_the_version_of_the_manifest(capsys: pytest.CaptureFixture[str]) -> None:
    manifest = tomllib.loads((REPOSITORY / "blender_manifest.toml").read_text(encoding="utf-8"))
    with pytest.raises(SystemExit) as exit:
        main(["--version"])
    assert exit.value.code == 0
    assert capsys.readouterr().out == f"frog {manifest['version']}\n"


def test_the_project_states_no_version_of_its_own() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "version" in project["dynamic"] and "version" not in project
