"""The report of a chart: its tables, and a picture of accuracy against speed."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

from ..engine import FrogError, write_atomically
from .report import Row, Section, markdown, sections
from .results import read, write_csv

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
_FARTHEST = 10.0  # dB below the best method: what lies farther is drawn there


def write_report(folder: Path, published: str = "") -> list[Path]:
    """Writes ``tables.md``, ``runs.csv`` and the charts of the results in ``folder``; returns their paths.

    Args:
        published: a table of a paper's own figures, shown beside ours.

    Raises:
        FrogError: if there is no finished run yet.
    """
    records = read(folder / "runs.jsonl")
    grouped = sections(records)
    if not grouped:
        raise FrogError(f"{folder}: found no finished run, expected at least one in runs.jsonl.")
    figures = {section.file_name: speed_chart(section) for section in grouped}
    charts = [save_figure(chart, folder / f"speed_{name}.svg") for name, chart in figures.items() if chart is not None]
    shown = "\n## Charts\n\n" + "\n\n".join(f"![{path.stem}]({path.name})" for path in charts) if charts else ""
    write_atomically(folder / "tables.md", ((markdown(records, published) + shown).rstrip() + "\n").encode())
    return [folder / "tables.md", write_csv(folder, records), *charts]


def speed_chart(section: Section) -> Any:
    """FPS against PSNR, storage as the discs' area, and the Pareto front; None if no row has both.

    A method far below the best (mostly the static scene) is drawn at the lower edge with its PSNR in the legend, so
    that the others can be distinguished.
    """
    rows = [row for row in section.rows.get("methods", ()) if row.fps and row.median("psnr") is not None]
    if not rows:
        return None
    figure, axes = _figure(section.title)
    points = [(row.fps or 0.0, row.median("psnr") or 0.0) for row in rows]
    sizes = [(row.median("bytes") or 0.0) / 1e6 for row in rows]
    edge = max(psnr for _, psnr in points) - _FARTHEST
    front = pareto_front(points)
    if len(front) > 1:
        axes.plot(*zip(*front, strict=True), color="0.55", linestyle="--", linewidth=1.2, label="Pareto front")
    for row, (fps, psnr), size, (color, marker) in zip(rows, points, sizes, _styles(rows), strict=True):
        name, height = f"{row.label}, {size:.1f} MB", max(psnr, edge)
        if psnr < edge:
            name += f", {psnr:.1f} dB (below)"
        else:
            axes.vlines(fps, min(row.values("psnr")), max(row.values("psnr")), color=color, linewidth=1.2)
        name += f"\n{_seeds(row)}"
        area = 60 + 840 * size / max([*sizes, 1e-9])  # square points
        axes.scatter(fps, height, s=area, color=color, alpha=0.35, linewidths=0)
        axes.scatter(fps, height, s=42, color=color, marker=marker, edgecolors="white", linewidths=0.7, label=name)
    axes.scatter([], [], s=120, color="0.5", alpha=0.35, linewidths=0, label="area: storage on disk")
    axes.set_xscale("log")
    axes.margins(x=0.15, y=0.15)
    _plain_ticks(axes)
    at_times = [row.label for row in rows if any(run["recipe"].get("moment_seeds") for run in row.records.values())]
    seeds = f"seeds at many times: {', '.join(at_times) or 'none'}"
    axes.set_xlabel(f"frames a second, deformation and rasterization (logarithmic)\n{seeds}")
    axes.set_ylabel("PSNR of the held-out images, dB")
    figure.legend(loc="outside right upper", frameon=False, fontsize=9)
    return figure


def _seeds(row: Row) -> str:
    """Such as ``3 seeds ±0.05``."""
    deviation, count = row.deviation("psnr"), len(row.records)
    return "1 seed" if count == 1 else f"{count} seeds" + ("" if deviation is None else f" ±{deviation:.2f}")


def pareto_front(points: Sequence[tuple[float, float]]) -> list[tuple[float, float]]:
    """The points that no other point exceeds in both coordinates, from left to right."""
    front: list[tuple[float, float]] = []
    for point in sorted(set(points), reverse=True):
        if not front or point[1] > front[-1][1]:
            front.append(point)
    return front[::-1]


def _figure(title: str) -> tuple[Any, Any]:
    from matplotlib.figure import Figure

    figure = Figure(figsize=(8.2, 5.2), dpi=130, layout="constrained")
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


def save_figure(figure: Any, path: Path) -> Path:
    """Writes a figure as SVG; the same bytes for the same figure."""
    import matplotlib

    content = BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "frog"}):
        figure.savefig(content, format="svg", metadata={"Date": None})
    write_atomically(path, content.getvalue())
    return path
