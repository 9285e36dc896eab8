"""The charts: accuracy against speed, accuracy against training time, the effect of each ablation, capacity."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from ..engine import FrogError
from .grid import AUTO_LABEL
from .labels import place_labels
from .summary import Row, Section, differences

# Okabe and Ito's palette, which is distinguishable with any colour vision; each method also has its own marker.
STYLES = {
    "frog": ("#D55E00", "o"),
    "ed3dgs": ("#0072B2", "s"),
    "static": ("#000000", "X"),
    "d3dgs": ("#009E73", "^"),
    "hexplane": ("#CC79A7", "D"),
    "curves": ("#E69F00", "v"),
}
_OTHERS = (("#56B4E9", "P"), ("#F0E442", "h"), ("#999999", "p"))
_GROUP_COLORS = {
    "fusion": "#0072B2",
    "modulation": "#CC79A7",
    "sampling": "#009E73",
    "seeds": "#F0E442",
    "loss": "#999999",
    "opacity": "#D55E00",
    "k": "#E69F00",
    "capacity": "#56B4E9",
}
_DPI = 130
_LARGEST_SVG = 300_000  # bytes


def write_charts(sections: Sequence[Section], folder: Path) -> list[Path]:
    """Writes every chart that the results suffice for, as PNG, and as SVG if that is small; returns their paths."""
    written: list[Path] = []
    for section in sections:
        for name, make in _CHARTS.items():
            figure = make(section)
            if figure is not None:
                written += save_figure(figure, folder / f"{name}_{section.file_name}")
    return written


def speed_chart(section: Section) -> Any:
    """FPS against PSNR, storage as the discs' area, and the Pareto front; None if no row has both.

    A method far below all others (mostly the static scene) is drawn at the lower edge with its PSNR in its label, so
    that the others can be distinguished.
    """
    rows = [row for row in section.rows.get("methods", ()) if row.fps and row.median("psnr") is not None]
    if not rows:
        return None
    figure, axes = _figure(section.title)
    points = [(row.fps or 0.0, row.median("psnr") or 0.0) for row in rows]
    sizes = [(row.median("bytes") or 0.0) / 1e6 for row in rows]
    areas = [60 + 840 * size / max([*sizes, 1e-9]) for size in sizes]  # square points
    names = [f"{row.label}, {size:.1f} MB" for row, size in zip(rows, sizes, strict=True)]
    front = pareto_front(points)
    bottom = _far_below([psnr for _, psnr in points])
    if bottom is not None:
        names[bottom] += f", {points[bottom][1]:.1f} dB (below)"
    seen = [psnr for i, (_, psnr) in enumerate(points) if i != bottom]
    margin = max(0.4, 0.3 * (max(seen) - min(seen)))
    low = min(seen) - margin * (1 if bottom is None else 2)
    if bottom is not None:
        points[bottom] = (points[bottom][0], low + 0.5 * margin)
    fps = [x for x, _ in points]
    axes.set_xscale("log")
    axes.set_xlim(min(fps) / 1.7, max(fps) * 1.7)
    axes.set_ylim(low, max(seen) + margin)
    _plain_ticks(axes)
    if len(front) > 1:
        axes.plot(
            *zip(*front, strict=True), color="0.55", linestyle="--", linewidth=1.2, zorder=1, label="Pareto front"
        )
    for i, (row, (color, marker)) in enumerate(zip(rows, _styles(rows), strict=True)):
        axes.scatter(*points[i], s=areas[i], color=color, alpha=0.35, linewidths=0, zorder=2)
        axes.scatter(*points[i], s=42, color=color, marker=marker, edgecolors="white", linewidths=0.7, zorder=4)
        if i != bottom:
            low, high = min(row.values("psnr")), max(row.values("psnr"))
            axes.vlines(points[i][0], low, high, color=color, linewidth=1.2, zorder=3)
    axes.scatter([], [], s=120, color="0.5", alpha=0.35, linewidths=0, label="area: storage on disk")
    axes.set_xlabel("frames a second, deformation and rasterization (logarithmic)")
    axes.set_ylabel("PSNR of the held-out images, dB")
    axes.legend(loc="lower left", frameon=False, fontsize=9)
    figure.draw_without_rendering()  # the layout decides where things lie
    figure.set_layout_engine("none")
    radii = [(area**0.5) / 2 * figure.dpi / 72 for area in areas]
    place_labels(axes, points, names, radii)
    return figure


def _far_below(values: Sequence[float]) -> int | None:
    """Index of a value so far below all others that they could not be distinguished; None if there is none."""
    if len(values) < 3:
        return None
    lowest, second, *_, highest = sorted(values)
    far = second - lowest > max(2.0, 2.0 * (highest - second))
    return list(values).index(lowest) if far else None


def pareto_front(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points that no other point exceeds in both coordinates, from left to right."""
    front: list[tuple[float, float]] = []
    for point in sorted(set(points), reverse=True):
        if not front or point[1] > front[-1][1]:
            front.append(point)
    return front[::-1]


def training_chart(section: Section) -> Any:
    """PSNR against seconds of training: a thin line for each seed, a thick one for their median; None without a curve.

    If there was a timing pass, curves are scaled to its seconds.
    """
    rows = [row for row in section.rows.get("methods", ()) if any(r.get("curve") for r in row.records.values())]
    if not rows:
        return None
    figure, axes = _figure(section.title)
    for row, (color, marker) in zip(rows, _styles(rows), strict=True):
        curves = [_seconds_and_psnr(row, record) for record in row.records.values() if record.get("curve")]
        if len(curves) > 1:
            for seconds, psnr in curves:
                axes.plot(seconds, psnr, color=color, linewidth=0.7, alpha=0.4)
        points = range(min(len(seconds) for seconds, _ in curves))
        middle = [[statistics.median(curve[axis][i] for curve in curves) for i in points] for axis in (0, 1)]
        top = 4 if row.method == "frog" else 3
        style = {"markersize": 6, "markeredgecolor": "white", "markeredgewidth": 0.6, "linewidth": 1.6, "zorder": top}
        axes.plot(*middle, color=color, marker=marker, label=row.label, **style)
    dedicated = all(row.timing is not None or row.is_dedicated for row in rows)
    axes.set_xlabel("training, s" + ("" if dedicated else " (some with several runs at once)"))
    axes.set_ylabel("PSNR of the held-out images, dB")
    figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


def _seconds_and_psnr(row: Row, record: dict[str, Any]) -> tuple[list[float], list[float]]:
    """A run's curve, with its seconds scaled to those of the timing pass, if there is one."""
    factor = 1.0
    if row.timing is not None and row.timing["training"]["seconds"] and record["train_seconds"]:
        factor = row.timing["training"]["seconds"] / record["train_seconds"]
    return [point[0] * factor for point in record["curve"]], [point[2] for point in record["curve"]]


def ablation_chart(section: Section) -> Any:
    """The difference of each ablation to FRoG, in all and in moving pixels; None without an ablation.

    Bars are mean differences over seeds, whiskers their range.
    """
    frog = section.of_method("frog")
    rows = [row for group in _GROUP_COLORS for row in section.rows.get(group, ()) if differences(row, frog, "psnr")]
    if frog is None or not rows:
        return None
    panels = [("psnr", "all pixels")]
    if any(differences(row, frog, "psnr_moving") for row in rows):
        panels.append(("psnr_moving", "moving pixels"))
    from matplotlib.figure import Figure

    figure = Figure(figsize=(2.6 + 3.4 * len(panels), 1.6 + 0.36 * len(rows)), dpi=_DPI, layout="constrained")
    figure.suptitle(f"{section.title}: difference to FRoG", fontsize=11)
    all_axes = figure.subplots(1, len(panels), sharey=True, squeeze=False)[0]
    for axes, (name, title) in zip(all_axes, panels, strict=True):
        for index, row in enumerate(rows):
            values = list(differences(row, frog, name).values())
            if not values:
                continue
            axes.barh(index, statistics.mean(values), height=0.62, color=_GROUP_COLORS[row.group], alpha=0.85)
            axes.plot([min(values), max(values)], [index, index], color="black", linewidth=1.3)
            axes.plot(values, [index] * len(values), linestyle="none", marker="|", color="black", markersize=7)
        axes.axvline(0, color="black", linewidth=0.8)
        axes.set_xlabel(f"PSNR of {title}, dB")
        axes.locator_params(axis="x", nbins=5)
        axes.grid(axis="x", color="0.9")
        axes.set_axisbelow(True)
    all_axes[0].set_yticks(range(len(rows)), [row.label for row in rows])
    all_axes[0].invert_yaxis()
    return figure


def capacity_chart(section: Section) -> Any:
    """PSNR against bytes for fewer Gaussians, fewer dynamic ones, and automatic capacity; None without a sweep.

    Medians are over the seeds that all rows have. Rows equal to the automatic choice are not shown twice.
    """
    rows, of_methods = (
        [row for row in section.rows.get(group, ()) if row.median("psnr") and row.median("packed_bytes")]
        for group in ("capacity", "methods")
    )
    frog = section.of_method("frog")
    if not rows or frog is None:
        return None
    automatic = [row for row in of_methods if row.label == AUTO_LABEL]
    seeds = set.intersection(*(set(row.by_seed("packed_bytes")) for row in (frog, *rows, *automatic)))
    if not seeds:
        return None
    frog, rows, automatic = frog.of_seeds(seeds), _of_seeds(rows, seeds), _of_seeds(automatic, seeds)
    figure, axes = _figure(f"{section.title}: what capacity buys")

    def point(row: Row) -> tuple[float, float]:
        return (row.median("packed_bytes") or 0.0) / 1e6, row.median("psnr") or 0.0

    rows = [row for row in rows if point(row) not in map(point, automatic)]
    fewer = [row for row in rows if "Gaussians" in row.label]
    calmer = [row for row in rows if "move" in row.label]
    lines = {
        "fewer Gaussians, all of them moving": ([*fewer, frog], "#0072B2", "o"),
        "fewer that move": (calmer, "#E69F00", "^"),
    }
    for title, (swept, color, marker) in lines.items():
        if not swept:
            continue
        points = sorted(point(row) for row in swept)
        axes.plot(*zip(*points, strict=True), color=color, marker=marker, label=title)
    for row in automatic:
        axes.plot(*point(row), color="#D55E00", marker="*", markersize=17, linestyle="none", label="automatic choice")
    axes.set_xscale("log")
    _plain_ticks(axes)
    axes.set_xlabel("storage of all as packed files, MB (logarithmic)")
    axes.set_ylabel("PSNR of the held-out images, dB")
    axes.margins(x=0.15, y=0.15)
    figure.legend(loc="outside lower center", frameon=False, fontsize=9, ncols=3)
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    named = [*automatic, frog, *rows]
    radii = [10.0] * len(automatic) + [5.0] * (1 + len(rows))
    place_labels(axes, [point(row) for row in named], [row.label for row in named], radii)
    return figure


def _of_seeds(rows: Sequence[Row], seeds: set[int]) -> list[Row]:
    return [row.of_seeds(seeds) for row in rows]


_CHARTS = {"speed": speed_chart, "training": training_chart, "ablation": ablation_chart, "capacity": capacity_chart}


def _figure(title: str) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.2, 5.2), dpi=_DPI, layout="constrained")
    axes = figure.subplots()
    axes.set_title(title, fontsize=11)
    axes.grid(color="0.92")
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)
    return figure, axes


def _styles(rows: Sequence[Row]) -> list[tuple[str, str]]:
    """Colour and marker of each row: the method's own for its first row, spare ones for others."""
    used: set[str] = set()
    spare = iter(_OTHERS * len(rows))
    styles = []
    for row in rows:
        styles.append(STYLES[row.method] if row.method in STYLES and row.method not in used else next(spare))
        used.add(row.method)
    return styles


def _plain_ticks(axes: Any) -> None:
    """Ticks at 1, 2, 5, 10, 20 ..., as plain numbers."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def save_figure(figure: Any, stem: Path) -> list[Path]:
    """Writes a figure as PNG, and as SVG if that is small; the same bytes for the same figure."""
    import matplotlib

    written = [stem.with_name(stem.name + ".png")]
    drawing = stem.with_name(stem.name + ".svg")
    try:
        figure.savefig(written[0], metadata={"Software": None})
        with matplotlib.rc_context({"svg.hashsalt": "frog"}):
            figure.savefig(drawing, metadata={"Date": None})
    except OSError as error:
        raise FrogError(f"{written[0]}: could not be written ({error.strerror}).") from error
    if drawing.stat().st_size <= _LARGEST_SVG:
        written.append(drawing)
    else:
        drawing.unlink()
    return written
