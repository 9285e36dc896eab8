"""Charts that can be read: no label covers another, whatever the figures."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.chart_records import run_record, timing_record, whole_chart

from frog_blender.engine.errors import FrogError
from frog_blender.engine.registry import METHODS
from frog_blender.research.charts import (
    STYLES,
    ablation_chart,
    capacity_chart,
    pareto_front,
    speed_chart,
    training_chart,
    write_charts,
)
from frog_blender.research.labels import overlapping
from frog_blender.research.report import write_report
from frog_blender.research.results import append
from frog_blender.research.summary import sections


def texts(figure: object) -> str:
    from matplotlib.text import Text

    return "\n".join(text.get_text() for text in figure.findobj(Text))  # type: ignore[attr-defined]


def test_every_chart_of_a_whole_grid() -> None:
    section = sections(whole_chart())[0]
    for make in (speed_chart, training_chart, ablation_chart, capacity_chart):
        assert overlapping(make(section)) == [], make.__name__
    assert "FRoG, 6.2 MB" in texts(speed_chart(section)) and "dB" in texts(speed_chart(section))
    assert "sampling: off" in texts(ablation_chart(section)) and "training, s" in texts(training_chart(section))


def test_the_check_for_overlaps_finds_one() -> None:
    from matplotlib.figure import Figure

    figure = Figure()
    figure.text(0.5, 0.5, "one")
    figure.text(0.51, 0.5, "two")
    figure.text(0.9, 0.9, "far")
    assert overlapping(figure) == [("one", "two")]


@pytest.mark.parametrize("seed", [0, 2, 4])
def test_labels_never_cover_each_other(seed: int) -> None:
    """Points in clusters of different widths."""
    random = np.random.default_rng(seed)
    speeds = 10 ** random.uniform(0, 2) * np.exp(random.normal(0, 0.1 + 0.3 * seed, 8))
    psnrs = random.uniform(20, 35) + random.normal(0, 0.05 * 4**seed, 8)
    sizes = random.integers(1, 10**8, 8)
    check_speed_chart(list(zip(speeds.tolist(), psnrs.tolist(), sizes.tolist(), strict=True)))


def test_a_single_point_by_the_edge_of_two_ticks() -> None:
    check_speed_chart([(86.0, 15.25, 1)])


@pytest.mark.parametrize("count", [1, 9])
def test_labels_of_points_in_one_place(count: int) -> None:
    check_speed_chart([(50.0, 30.0, 5_000_000)] * count)


def check_speed_chart(points: list[tuple[float, float, int]]) -> None:
    records = []
    for number, (fps, psnr, size) in enumerate(points):
        label = f"A method named {number}"
        method = list(METHODS)[number % len(METHODS)]
        records.append(run_record(method, label=label, psnr=psnr, bytes=size))
        records.append(timing_record(method, fps, label=label))
    figure = speed_chart(sections(records)[0])
    assert overlapping(figure) == []
    assert all(f"A method named {number}, " in texts(figure) for number in range(len(points)))


def test_missing_figures_leave_a_chart_out() -> None:
    bare = sections([run_record("static", curve=[])])[0]
    assert speed_chart(bare) is None and training_chart(bare) is None and ablation_chart(bare) is None
    one = sections([run_record(), timing_record()])[0]
    assert overlapping(speed_chart(one)) == [] and overlapping(training_chart(one)) == []
    assert ablation_chart(one) is None
    alone = run_record(label="opacity: off", group="opacity", psnr=29.0, psnr_moving=None)
    chart = ablation_chart(sections([run_record(), alone])[0])
    assert overlapping(chart) == [] and "moving" not in texts(chart)
    assert ablation_chart(sections([alone])[0]) is None


def test_a_sweep_is_compared_over_its_own_seeds() -> None:
    auto = [
        run_record("frog", label="FRoG auto", seed=seed, psnr=30.0 + seed, packed_bytes=3_000_000) for seed in range(3)
    ]
    frog = [run_record("frog", seed=seed, psnr=31.0 + seed, packed_bytes=6_000_000) for seed in range(3)]
    sweep = [
        run_record("frog", label="10% move", group="capacity", psnr=29.0, packed_bytes=2_000_000),
        run_record("frog", label="40% move", group="capacity", psnr=30.0, packed_bytes=3_000_000),  # as automatic
    ]
    chart = capacity_chart(sections([*auto, *frog, *sweep])[0])
    star = next(line for line in chart.axes[0].lines if line.get_label() == "automatic choice")
    assert (list(star.get_xdata()), list(star.get_ydata())) == ([3.0], [30.0])
    assert overlapping(chart) == [] and "10% move" in texts(chart) and "40% move" not in texts(chart)
    late = run_record("frog", label="5% move", group="capacity", seed=7, psnr=29.0, packed_bytes=2_000_000)
    assert capacity_chart(sections([*frog, late])[0]) is None


def test_curves_of_different_lengths() -> None:
    records = [run_record(seed=seed, curve=[[i, i, 20 + i] for i in range(3 + seed)]) for seed in range(3)]
    assert overlapping(training_chart(sections(records)[0])) == []


def test_dedicated_seconds_stretch_the_curves() -> None:
    records = [run_record(train_seconds=140.0, curve=[[70.0, 1, 20.0], [140.0, 2, 25.0]]), timing_record()]
    axes = training_chart(sections(records)[0]).axes[0]
    assert axes.lines[0].get_xdata() == pytest.approx([34.15, 68.3])


def test_the_pareto_front() -> None:
    points = [(1.0, 5.0), (2.0, 4.0), (2.0, 3.0), (3.0, 4.5), (0.5, 5.0), (4.0, 1.0)]
    assert pareto_front(points) == [(1.0, 5.0), (3.0, 4.5), (4.0, 1.0)]
    assert pareto_front([(1.0, 1.0)] * 2) == [(1.0, 1.0)]


def test_every_method_has_a_colour_and_a_marker_of_its_own() -> None:
    assert set(STYLES) == set(METHODS)
    assert (
        len({color for color, _ in STYLES.values()}) == len({marker for _, marker in STYLES.values()}) == len(METHODS)
    )


def test_a_report(tmp_path: Path) -> None:
    with pytest.raises(FrogError, match="no finished run"):
        write_report(tmp_path)
    for record in whole_chart():
        if record["scene"] == "dim":
            append(tmp_path / "runs.jsonl", record)
    written = write_report(tmp_path)
    text = (tmp_path / "tables.md").read_text(encoding="utf-8")
    assert written[0] == tmp_path / "tables.md" and text.endswith(")\n")
    images = {path.name for path in written if path.suffix == ".png"}
    assert images == {f"{kind}_dim_draft.png" for kind in ("speed", "training", "ablation", "capacity")}
    for path in written[1:]:
        assert path.stat().st_size > 5000 and (path.suffix == ".svg" or f"({path.name})" in text)


def test_the_same_results_give_the_same_bytes(tmp_path: Path) -> None:
    records = sections([run_record(seed=seed) for seed in range(2)])
    written = write_charts(records, tmp_path)
    before = [path.read_bytes() for path in written]
    assert len(written) == 2
    write_charts(records, tmp_path)
    assert [path.read_bytes() for path in written] == before
