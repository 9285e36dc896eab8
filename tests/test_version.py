"""One source of the version: Blender's manifest."""

import tomllib

import pytest
from support.builders import REPOSITORY

from frog_blender.cli.main import main


def test_frog_prints_the_version_of_the_manifest(capsys: pytest.CaptureFixture[str]) -> None:
    manifest = tomllib.loads((REPOSITORY / "blender_manifest.toml").read_text(encoding="utf-8"))
    with pytest.raises(SystemExit) as exit:
        main(["--version"])
    assert exit.value.code == 0
    assert capsys.readouterr().out == f"frog {manifest['version']}\n"


def test_the_project_states_no_version_of_its_own() -> None:
    project = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    assert "version" in project["dynamic"] and "version" not in project
