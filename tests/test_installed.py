"""Installed as a user installs it, not as an editable checkout: README and the examples work then as well."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
from support.builders import REPOSITORY, printed


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the package as ``pip install .`` leaves it. What the checkout has compiled serves again."""
    folder = tmp_path_factory.mktemp("installed")
    command = [sys.executable, "-m", "pip", "install", "-q", "--disable-pip-version-check", "--no-deps"]
    command += ["--no-build-isolation", "--target", str(folder), str(REPOSITORY)]
    printed(subprocess.run(command, capture_output=True, text=True, timeout=600))
    return folder


@pytest.fixture
def clone(tmp_path: Path, filmed: Path) -> Path:
    """A checkout in which nothing was built, with a small capture in it: its package hides the installed one."""
    folder = tmp_path / "clone"
    shutil.copytree(
        REPOSITORY / "frog_blender", folder / "frog_blender", ignore=shutil.ignore_patterns("*frog_native.*", "__pyc*")
    )
    assert not list((folder / "frog_blender").rglob("libfrog_native*"))
    (folder / "capture").symlink_to(filmed, target_is_directory=True)
    return folder


def run_at(folder: Path, installed: Path, *command: object) -> str:
    """What it prints, with the packages of this interpreter, but without what makes its checkout importable (-S)."""
    packages = [str(installed), *(path for path in sys.path if "site-packages" in path)]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(packages), "FROG_CACHE": str(folder.parent / "cache")}
    words = [sys.executable, "-S", *map(str, command)]
    return printed(subprocess.run(words, cwd=folder, env=environment, capture_output=True, text=True, timeout=300))


def code_of(page: str) -> str:
    """The Python of a page, made short: it trains for a few steps."""
    text = (REPOSITORY / page).read_text(encoding="utf-8")
    blocks = re.findall(r"^    from frog_blender import engine as frog\n(?:(?:    .*)?\n)+", text, re.M)
    blocks += re.findall(r"^```python\n(.+?)^```", text, re.M | re.S)
    code = "\n".join(line.removeprefix("    ") for line in blocks[0].splitlines())
    assert 'recipe="draft"' in code
    return code.replace('recipe="draft"', 'recipe="draft", steps=4, max_gaussians=250')


@pytest.mark.parametrize("page", ["README.md", "docs/python-api.md"])
def test_the_python_of_a_page_runs_inside_the_clone(installed: Path, clone: Path, page: str) -> None:
    code = code_of(page).replace("examples/captures/room", "capture")
    said = run_at(clone, installed, "-c", f"{code}\nprint(image.shape, image.mean() > 0, frog.__file__)")
    assert re.search(r"^\(\d+, \d+, 3\) True .*clone", said.splitlines()[-1])


def test_the_command_line_runs_inside_the_clone(installed: Path, clone: Path) -> None:
    frog = installed / "bin" / "frog"
    for command in (
        ["train", "capture", "--out", "scene.frog", "--recipe", "draft", "--steps", "4", "--max-gaussians", "250"],
        ["render", "scene.frog", "--camera", "cam00", "--out", "frames"],
    ):
        run_at(clone, installed, frog, *command)
    assert (clone / "scene.frog").is_file() and list((clone / "frames").iterdir())


def test_nothing_is_missing_in_the_installed_package(installed: Path, tmp_path: Path) -> None:
    """Away from the clone the installed files are used: what is no Python (kernels, the web page) is there as well."""
    code = "import frog_blender.engine.native.binding as binding; print(binding.__file__, binding.library_path())"
    assert run_at(tmp_path, installed, "-c", code).count(str(installed)) == 2
    kinds = ("*.py", "*.md", "*.js", "*.html", "*.glsl", "*.cu", "*.cuh", "*.inl", "*.toml", "*.json")
    package = REPOSITORY / "frog_blender"
    shipped = {path.relative_to(package) for kind in kinds for path in package.rglob(kind)}
    assert [path for path in shipped if not (installed / "frog_blender" / path).is_file()] == []
