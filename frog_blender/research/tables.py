"""The tables of a chart as Markdown, in the layout of the paper's."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import replace

from .protocols import averages, protocol_named
from .results import Record
from .summary import FIGURES, Row, Section, differences, sections, spread

TITLES = {"psnr": "PSNR", "psnr_moving": "moving PSNR", "ssim": "SSIM", "flip": "FLIP", "lpips": "LPIPS"}
_DIGITS = {"psnr": 2, "psnr_moving": 2, "ssim": 4, "flip": 4, "lpips": 4}
_NONE = "-"
_ABLATION_TITLES = {
    "fusion": "Temporal fusion",
    "modulation": "Products of temporal and Gaussian embedding",
    "sampling": "Canonical sampling",
    "seeds": "Seeds on what moves, at many times",
    "loss": "Squares in the loss",
    "opacity": "Opacity reduction",
    "k": "Sharpness k of the opacity reduction",
    "capacity": "Capacity",
}


def markdown(records: Iterable[Record], published: str = "") -> str:
    """All tables of the results, as one page.

    Args:
        published: a table of a paper's own figures, shown beside ours.
    """
    records = list(records)
    found = sections(records)
    parts = [_head(records)]
    for section in found:
        parts.append(f"## {section.title}\n\n" + _section(section))
    parts += _averages(found)
    parts += [part for part in (_paired(found), _times(found), _failed(records)) if part]
    if published:
        parts.insert(1, "## Published\n\n" + published.strip())
    return "\n\n".join(parts) + "\n"


def table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; the first column is left-aligned, the others right."""
    lines = ["| " + " | ".join(titles) + " |", "|---|" + "---:|" * (len(titles) - 1)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def _head(records: list[Record]) -> str:
    machines = sorted({_machine(record) for record in records if "machine" in record})
    text = (
        "# Comparison\n\nHigher is better for PSNR (dB; of all pixels, and of the moving region) and SSIM (3DGS's "
        "window), lower for FLIP (67 pixels a degree) and LPIPS (AlexNet), all of the held-out images. Median over "
        "the seeds, and (smallest to largest). Storage is the `.frog` on disk. Training time and FPS (deformation and "
        "rasterization by the inference engine) are of a dedicated pass in which nothing else ran; a time with * was "
        "taken during the grid instead, with several runs at once."
    )
    return "\n\n".join([text, *(f"Made on {machine}." for machine in machines)])


def _machine(record: Record) -> str:
    machine, versions = record["machine"], record["versions"]
    parts = [machine["cpu"], f"{machine['cores']} cores", machine["instruction_set"], machine["gpu"]]
    parts += [f"{name} {versions[name]}" for name in ("torch", "numpy") if versions.get(name)]
    return ", ".join(str(part) for part in parts if part)


def cell(row: Row, name: str) -> str:
    """Median and range of a figure, or why it is missing."""
    values = row.values(name)
    if not values:
        return row.why_missing(name) or _NONE
    median, smallest, largest = (f"{value:.{_DIGITS[name]}f}" for value in spread(values))
    return f"{median} ({smallest} to {largest})" if len(values) > 1 else median


def duration(seconds: float | None) -> str:
    """``71 s``, ``12 min`` or ``1 h 52 min``."""
    if seconds is None:
        return _NONE
    if seconds < 120:
        return f"{seconds:.0f} s"
    hours, minutes = divmod(round(seconds / 60), 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min"


def _number(value: float | None, digits: int) -> str:
    return _NONE if value is None else f"{value:.{digits}f}"


_COLUMNS = (*TITLES.values(), "storage, MB", "Gaussians", "training", "FPS", "seeds")


def _rows(rows: Sequence[Row]) -> str:
    return table(["", *_COLUMNS], ([row.label, *_cells(row)] for row in rows))


def _cells(row: Row) -> list[str]:
    """In the order of ``_COLUMNS``."""
    return [
        *(cell(row, name) for name in FIGURES),
        _megabytes(row.median("bytes")),
        _number(row.median("gaussians"), 0),
        duration(row.training_seconds) + ("" if row.is_dedicated else " *"),
        _number(row.fps, 1),
        str(len(row.records)),
    ]


def _megabytes(size: float | None) -> str:
    return _NONE if size is None else f"{size / 1e6:.1f}"


def _section(section: Section) -> str:
    frog = section.of_method("frog")
    first = [frog] if frog else []
    parts = []
    for group, rows in section.rows.items():
        if group == "methods":
            parts.append(_rows(rows))
        elif group == "time":
            parts.append(
                "### As long as FRoG took\n\n" + _rows([*(replace(row, group="time") for row in first), *rows])
            )
        else:
            changes = table(
                ["difference to FRoG", *TITLES.values()],
                ([row.label, *(_change(row, frog, name) for name in FIGURES)] for row in rows),
            )
            parts.append(f"### {_ABLATION_TITLES[group]}\n\n{_rows([*first, *rows])}\n\n{changes}")
    return "\n\n".join(parts)


def _change(row: Row | None, base: Row | None, name: str) -> str:
    """The mean difference by seed, and its range."""
    values = list(differences(row, base, name).values())
    if not values:
        return _NONE
    digits = _DIGITS[name]
    text = f"{statistics.mean(values):+.{digits}f}"
    return f"{text} ({min(values):+.{digits}f} to {max(values):+.{digits}f})" if len(values) > 1 else text


def _averages(found: list[Section]) -> list[str]:
    """Over the scenes of each recipe: the mean of the scenes' medians, or as a paper's protocol takes them."""
    parts = []
    for protocol, recipe in dict.fromkeys((section.protocol, section.recipe) for section in found):
        scenes = [s for s in found if (s.protocol, s.recipe) == (protocol, recipe) and "methods" in s.rows]
        if len(scenes) < 2:
            continue
        lines = []
        for label in dict.fromkeys(row.label for section in scenes for row in section.rows["methods"]):
            rows = {section.scene: row for section in scenes if (row := section.row(label)) is not None}
            means = _means(protocol, {scene: _figures(row) for scene, row in rows.items()})
            star = "" if all(row.is_dedicated for row in rows.values()) else " *"
            lines.append(
                [
                    label,
                    *(_number(means.get(name), _DIGITS[name]) for name in FIGURES),
                    _megabytes(means.get("bytes")),
                    duration(means.get("train_seconds")) + star,
                    _number(means.get("fps"), 1),
                    str(len(rows)),
                ]
            )
        titles = ["", *TITLES.values(), "storage, MB", "training", "FPS", "scenes"]
        name = f"{protocol}, {recipe}" if protocol else recipe
        parts.append(f"## Average over the scenes ({name})\n\n" + table(titles, lines))
    return parts


def _figures(row: Row) -> dict[str, float | None]:
    quality = {name: row.median(name) for name in (*FIGURES, "bytes")}
    return {**quality, "train_seconds": row.training_seconds, "fps": row.fps}


def _means(protocol: str, figures: dict[str, dict[str, float | None]]) -> dict[str, float]:
    """By figure, of the figures that every scene has (every one of the protocol, if there is one)."""
    if protocol:
        return averages(protocol_named(protocol), figures)
    means = {}
    for name in next(iter(figures.values())):
        known = [value for row in figures.values() if (value := row[name]) is not None]
        if len(known) == len(figures):
            means[name] = statistics.mean(known)
    return means


def _paired(found: list[Section]) -> str:
    """FRoG against its baseline, seed by seed."""
    lines: list[list[str]] = []
    means: dict[str, list[float]] = {name: [] for name in FIGURES}
    for section in found:
        frog, base = section.of_method("frog"), section.of_method("ed3dgs")
        count = len(differences(frog, base, "psnr"))
        if not count:
            continue
        lines.append([section.title, *(_change(frog, base, name) for name in FIGURES), str(count)])
        for name in FIGURES:
            if values := list(differences(frog, base, name).values()):
                means[name].append(statistics.mean(values))
    if not lines:
        return ""
    if len(lines) > 1:
        mean = [f"{statistics.mean(m):+.{_DIGITS[name]}f}" if (m := means[name]) else _NONE for name in FIGURES]
        lines.append(["mean of the scenes", *mean, ""])
    return "## FRoG minus E-D3DGS, by seed\n\nMean (smallest to largest) of the differences.\n\n" + table(
        ["", *TITLES.values(), "pairs"], lines
    )


def _times(found: list[Section]) -> str:
    """The times of the timing pass in milliseconds."""
    lines = []
    for section in found:
        for row in (row for group in ("methods", "fusion") for row in section.rows.get(group, ())):
            if row.timing is None:
                continue
            path, play, steps = row.timing["training_path"], row.timing["playback"], row.timing["training"]
            times = [path["forward_ms"], path["forward_backward_ms"], play["deformation_ms"], play["rasterization_ms"]]
            figures = [*times, play["frame_ms"], steps["step_ms"]]
            threads = row.timing["threads"] or row.timing["machine"]["cores"]
            values = (f"{value:.2f}" for value in figures)
            where = f"{path['device']}, {threads} threads"
            lines.append([section.scene, row.label, str(play["gaussians"]), *values, where])
    if not lines:
        return ""
    titles = ["scene", "", "Gaussians", "deformation in training, forward", "forward and backward"]
    titles += ["deformation at playback", "rasterization", "frame", "training step", "on"]
    return "## Times, ms\n\n" + table(titles, lines)


def _failed(records: list[Record]) -> str:
    done = {record["key"] for record in records if record["kind"] == "run"}
    failed = {record["key"]: record for record in records if record["kind"] == "failed" and record["key"] not in done}
    if not failed:
        return ""
    lines = [f"- {r['scene']}, {r['label']}, seed {r['seed']}: {r['error']}" for r in failed.values()]
    return "## Failed\n\n" + "\n".join(lines)
