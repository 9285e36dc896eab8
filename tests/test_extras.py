"""What is installed besides, by name: the extras, what the commands say without them, and Blender in the Makefile."""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import tomllib
from pathlib import Path

import pytest
from helpers import REPOSITORY, run_python, scene_file

from frog_blender.command_line.extras import EXTRAS, missing
from frog_blender.engine.files import write_scene

DISTRIBUTIONS = {"cv2": "opencv-contrib-python-headless", "flip_evaluator": "flip-evaluator"}
COMMAND = "from frog_blender.cli import main; sys.exit(main(sys.argv[1:]))"


def extra(name: str) -> list[str]:
    """The distributions that an extra names."""
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return [re.split("[><=;]", each)[0].strip() for each in project["optional-dependencies"][name]]


@pytest.mark.parametrize("module", EXTRAS)
def test_every_extra_that_is_named_brings_what_is_missing(module: str) -> None:
    for name in EXTRAS[module]:
        assert DISTRIBUTIONS.get(module, module) in extra(name)
        assert f'".[{name}]"' in missing(ModuleNotFoundError(name=f"{module}.part"))
        assert f"`{name}`" in (REPOSITORY / "README.md").read_text(encoding="utf-8")


def test_a_package_of_nobodys() -> None:
    assert "'other' is missing; see the README" in missing(ModuleNotFoundError(name="other"))


def test_rendering_needs_no_torch() -> None:
    assert "torch" not in extra("render")


@pytest.mark.parametrize(
    ("command", "module"), [("render --camera a", "cv2"), ("render --camera a", "tqdm"), ("export", "tqdm")]
)
def test_a_command_says_which_extra_it_wants(tmp_path: Path, command: str, module: str) -> None:
    write_scene(tmp_path / "x.frog", scene_file())
    name, *options = command.split()
    code = f"import sys; sys.modules[{module!r}] = None\n{COMMAND}"
    run = run_python(code, name, tmp_path / "x.frog", *options, "--out", tmp_path / "o")
    assert run.returncode == 1 and run.stderr.count("\n") == 1, run.stderr
    assert f"'{module}' is missing; pip install \".[render]\"" in run.stderr


def test_export_needs_no_opencv(tmp_path: Path) -> None:
    write_scene(tmp_path / "x.frog", scene_file())
    code = f"import sys; sys.modules['cv2'] = sys.modules['torch'] = None\n{COMMAND}"
    run = run_python(code, "export", tmp_path / "x.frog", "--frames", ":1", "--out", tmp_path / "o")
    assert run.returncode == 0, run.stderr


@pytest.mark.skipif(shutil.which("make") is None, reason="needs make")
@pytest.mark.parametrize("target", ["test-blender", "tour"])
@pytest.mark.parametrize("name", ["BLENDER", "FROG_BLENDER"])
def test_the_makefile_takes_a_blender_by_either_name(target: str, name: str) -> None:
    command = ["make", "-n", target, f"{name}=/somewhere/blender"]
    here = {key: value for key, value in os.environ.items() if "BLENDER" not in key and "MAKE" not in key}
    run = subprocess.run(command, cwd=REPOSITORY, capture_output=True, text=True, env=here)
    assert run.returncode == 0, run.stderr
    assert re.search(r"^(BLENDER_USER_RESOURCES=\S+ )?/somewhere/blender .*--factory-startup", run.stdout, re.MULTILINE)


def test_panel_and_readme_expect_the_same_of_the_standard_recipe() -> None:
    panel = (REPOSITORY / "frog_blender" / "ui" / "training_settings.py").read_text(encoding="utf-8")
    readme = (REPOSITORY / "README.md").read_text(encoding="utf-8")
    assert "three to ten minutes on a processor" in panel and "`standard` three to ten, and" in readme
