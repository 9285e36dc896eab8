"""The charts show every figure there is, and are left out where there is none."""

from pathlib import Path

import pytest
from support.chart_records import run_record, timing_record, whole_chart

from frog_blender.engine.errors import FrogError
from frog_blender.engine.registry import METHODS
from frog_blender.research.charts import STYLES, pareto_front, speed_chart, write_report
from frog_blender.research.report import sections
from frog_blender.research.results import append


def texts(figure: object) -> str:
    from matplotlib.text import Text

    return "\n".join(text.get_text() for text in figure.findobj(Text))  # type: ignore[attr-defined]


def test_accuracy_against_speed() -> None:
    records = [*whole_chart(), run_record("static", label="other", psnr=12.5), timing_record("static", label="other")]
    figure = speed_chart(sections(records)[0])
    assert "FRoG, 6.2 MB" in texts(figure) and "other, 5.5 MB, 12.5 dB (below)" in texts(figure)
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
    with pytest.raises(FrogError, match="no finished run"):
        write_report(tmp_path)
    records = [record for record in whole_chart() if record["scene"] == "dim"]
    for record in records:
        append(tmp_path / "runs.jsonl", record)
    written = write_report(tmp_path)
    text = (tmp_path / "tables.md").read_text(encoding="utf-8")
    assert written[0] == tmp_path / "tables.md" and text.endswith(")\n")
    assert [path.name for path in written[1:]] == ["speed_dim_draft.svg"]
    assert all(path.stat().st_size > 5000 and f"({path.name})" in text for path in written[1:])
    before = [path.read_bytes() for path in written[1:]]
    assert write_report(tmp_path) == written
    assert [path.read_bytes() for path in written[1:]] == before, "the same bytes for the same results"
