"""The tables of docs/experiments are what the results kept there say."""

import gzip
import importlib.util
import json
import re
import shutil
from pathlib import Path
from types import ModuleType

import pytest
from support.builders import REPOSITORY

pytest.importorskip("torch")  # the methods' titles come from the module that trains them


def tool_of(repository: Path) -> ModuleType:
    """The tool, which works on the repository that its file lies in."""
    spec = importlib.util.spec_from_file_location("experiment_tables", repository / "tools" / "experiment_tables.py")
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the folder, which the tool of ``tool`` works on."""
    return shutil.copytree(REPOSITORY / "docs" / "experiments", tmp_path / "docs" / "experiments")


@pytest.fixture
def tool(copy: Path, tmp_path: Path) -> ModuleType:
    """A copy of the tool beside ``copy``."""
    for part in ("tools/experiment_tables.py", "benchmarks/raster_report.py"):
        (tmp_path / part).parent.mkdir()
        shutil.copyfile(REPOSITORY / part, tmp_path / part)
    return tool_of(tmp_path)


def test_no_table_was_written_by_hand(capsys: pytest.CaptureFixture[str]) -> None:
    assert tool_of(REPOSITORY).main(["--check"]) == 0, capsys.readouterr().out


@pytest.mark.parametrize("name", ["compression.md", "grid/tables.md", "stability/tables.md"])
def test_a_changed_figure_is_noticed_and_mended(
    tool: ModuleType, copy: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    page = copy / name
    text = page.read_text(encoding="utf-8")
    before, mark, table = text.rpartition("<!-- table ")
    page.write_text(before + mark + re.sub(r"\d\.\d\d\b", "9.99", table, count=1), encoding="utf-8")
    assert tool.main(["--check"]) == 1
    assert capsys.readouterr().out.startswith(f"docs/experiments/{name} is not what the data say")
    assert tool.main(["--tables-only"]) == 0 and page.read_text(encoding="utf-8") == text


def test_a_table_that_does_not_exist_is_refused(tool: ModuleType, copy: Path) -> None:
    (copy / "page.md").write_text("<!-- table acuracy -->\n<!-- end of table -->\n")
    with pytest.raises(SystemExit, match=r"page\.md: found table acuracy, expected one of accuracy, "):
        tool.main(["--check"])


def test_new_results_are_kept(tool: ModuleType, copy: Path, tmp_path: Path) -> None:
    lines = gzip.decompress((copy / "drafts" / "runs.jsonl.gz").read_bytes()).decode().splitlines(keepends=True)
    run = json.loads(lines[0])
    results = tmp_path / "runs.jsonl"
    results.write_text(json.dumps({**run, "scene": "corridor"}) + "\n")
    assert tool.main(["--tables-only", "--keep", str(results), "more"]) == 0
    assert "## corridor (draft" in (copy / "more" / "tables.md").read_text(encoding="utf-8")
    assert gzip.decompress((copy / "more" / "runs.jsonl.gz").read_bytes()) == results.read_bytes()


def test_the_folder_stays_small() -> None:
    files = [path for path in (REPOSITORY / "docs" / "experiments").rglob("*") if path.is_file()]
    assert sum(path.stat().st_size for path in files) < 3_000_000
