"""The charts of results, and the command that draws and tells them."""

from dataclasses import replace
from pathlib import Path

import pytest
from support import synthetic_capture as film
from support.builders import Run, refused
from support.chart_records import run_record, timing_record, whole_chart

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.registry import METHODS
from frog_blender.research import grid, protocols, timing
from frog_blender.research.charts import STYLES, pareto_front, speed_chart, write_report
from frog_blender.research.report import sections
from frog_blender.research.results import append, read

pytestmark = pytest.mark.usefixtures("quick_seeds")


def test_a_small_chart(run: Run, filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Later one of its captures cannot be used: the others are drawn nevertheless."""
    monkeypatch.setattr(timing, "STEPS", 8)
    out = tmp_path / "chart"
    options = ("--out", out, "--methods", "static,frog", "--steps", 4, "--seeds", 1)
    more = ("--equal-time", "--row", "Narrow=static,sh_degree=0", "--timing")
    status, text, err = run("chart", filmed, *options, *more)
    assert status == 0, err
    records = read(out / "runs.jsonl")
    assert [(record["kind"], record["label"], record["equal_time"]) for record in records] == [
        ("run", "3DGS (static)", False),
        ("run", "FRoG", False),
        ("run", "Narrow", False),
        ("run", "3DGS (static)", True),
        ("timing", "3DGS (static)", False),
        ("timing", "FRoG", False),
        ("timing", "Narrow", False),
    ]
    assert "4 runs, 4 to do" in text and "capture, FRoG, seed 0:" in err and "dB" in err
    tables = (out / "tables.md").read_text(encoding="utf-8")
    assert "| FRoG |" in tables and "| Narrow |" in tables and "As long as FRoG took" in tables
    assert [path.name for path in out.glob("*.svg")] == ["speed_capture_draft_4.svg"]
    assert (out / "scenes" / ".gitignore").read_text() == "*\n" and not list(out.rglob("*.checkpoint"))

    (tmp_path / "gone").mkdir()
    monkeypatch.setattr(grid, "open_capture", lambda folder: None)  # it was there when the runs began
    status, text, err = run("chart", filmed, tmp_path / "gone", *options)
    assert status == 1 and "4 runs, 2 to do" in text and len(read(out / "runs.jsonl")) == len(records) + 2
    assert "2 runs failed" in err and "gone: found an empty folder" in err and str(out / "tables.md") in text
    assert "gone: found an empty folder" in (out / "tables.md").read_text()
    status, text, _ = run("chart", filmed, "--out", out, "--only-report")
    assert status == 0 and "to do" not in text


def test_a_plan_runs_nothing(run: Run, filmed: Path, tmp_path: Path) -> None:
    status, text, _ = run("chart", filmed, "--out", tmp_path / "o", "--methods", "frog,ed3dgs,static", "--plan")
    assert status == 0 and not (tmp_path / "o").exists()
    assert "capture: FRoG, at equal steps, 3 seeds" in text and "7 runs, 7 to do" in text
    assert "capture: 3DGS (static), at equal steps, 1 seed\n" in text


def test_a_protocol(run: Run, filmed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The protocol opens the captures, names them, chooses the recipe, and its published table stands beside ours."""
    asked: list[object] = []

    def captures(protocol: str, directory: Path, names: object = None) -> list[tuple[str, Capture]]:
        asked.append((protocol, directory, names))
        return [("flame", replace(open_capture(filmed), test_cameras=frozenset({"cam02"})))]

    monkeypatch.setattr(protocols, "captures", captures)
    out = tmp_path / "o"
    options = ("--protocol", "n3dv", "--scenes", "flame", "--methods", "static", "--steps", 2, "--seeds", 1)
    status, said, err = run("chart", filmed.parent, *options, "--out", out)
    assert status == 0, err
    (record,) = read(out / "runs.jsonl")
    assert (record["scene"], record["protocol"], record["recipe_name"]) == ("flame", "n3dv", "paper-exact")
    assert record["scale"] == 1.0 and record["frames"] == film.FRAMES
    assert "0 of the 9 captures of n3dv, without coffee_martini, " in said
    assert asked[0] == ("n3dv", filmed.parent, ["flame"]) and ("n3dv", filmed.parent, ["flame"]) in asked
    assert "## Published" in (out / "tables.md").read_text() and "E-D3DGS" in (out / "tables.md").read_text()


def texts(figure: object) -> str:
    from matplotlib.text import Text

    return "\n".join(text.get_text() for text in figure.findobj(Text))  # type: ignore[attr-defined]


def test_accuracy_against_speed() -> None:
    records = [*whole_chart(), run_record("static", label="other", psnr=12.5), timing_record("static", label="other")]
    figure = speed_chart(sections(records)[0])
    assert "FRoG, 6.2 MB\n3 seeds ±0.05" in texts(figure)
    assert "other, 5.5 MB, 12.5 dB (below)\n1 seed" in texts(figure)
    assert figure.axes[0].get_ylim()[0] > 17, "what lies far below the others does not squeeze them"


def test_missing_figures_leave_a_chart_out() -> None:
    bare = sections([run_record("static")])[0]
    assert speed_chart(bare) is None


def test_the_pareto_front() -> None:
    points = [(1.0, 5.0), (2.0, 4.0), (2.0, 3.0), (3.0, 4.5), (0.5, 5.0), (4.0, 1.0)]
    assert pareto_front(points) == [(1.0, 5.0), (3.0, 4.5), (4.0, 1.0)]
    assert pareto_front([(1.0, 1.0)] * 2) == [(1.0, 1.0)]


def test_every_method_has_a_colour_and_a_marker_of_its_own() -> None:
    assert set(STYLES) == set(METHODS)
    assert all(len({style[part] for style in STYLES.values()}) == len([*METHODS]) for part in (0, 1))


def test_a_report(tmp_path: Path) -> None:
    refused("no finished run", write_report, tmp_path)
    records = [record for record in whole_chart() if record["scene"] == "dim"]
    for record in records:
        append(tmp_path / "runs.jsonl", record)
    written = write_report(tmp_path)
    text = (tmp_path / "tables.md").read_text(encoding="utf-8")
    assert written[0] == tmp_path / "tables.md" and text.endswith(")\n")
    assert [path.name for path in written[1:]] == ["runs.csv", "speed_dim_draft.svg"]
    assert all(path.stat().st_size > 5000 for path in written[1:]) and "(speed_dim_draft.svg)" in text
    before = [path.read_bytes() for path in written[1:]]
    assert write_report(tmp_path) == written
    assert [path.read_bytes() for path in written[1:]] == before, "the same bytes for the same results"
