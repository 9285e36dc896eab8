"""The tables of a chart's results as Markdown, in the layout of the paper's.

Results are grouped: sections by scene, rows by method, values by seed.
"""

import statistics
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from ..engine import named
from .grid import AUTO_LABEL, ROWS
from .protocols import PROTOCOLS, averages, left_out
from .results import Record, finished
from .runs import OFF_RIG

FIGURES = {
    "psnr": "PSNR",
    "psnr_moving": "moving PSNR",
    "ssim": "SSIM",
    "flip": "FLIP",
    "lpips": "LPIPS",
    "lpips_vgg": "LPIPS (VGG)",
}
"""Titles of the figures of quality."""
_DIGITS = {"psnr": 2, "psnr_moving": 2, "ssim": 4, "flip": 4, "lpips": 4, "lpips_vgg": 4}
_NONE = "-"
_GROUPS = {
    "methods": "",
    "time": "As long as FRoG took",
    "fusion": "Temporal fusion",
    "modulation": "Products of temporal and Gaussian embedding",
    "sampling": "Canonical sampling",
    "seeds": "Seeds on what moves, at many times",
    "loss": "Squares in the loss",
    "opacity": "Opacity reduction",
    "k": "Sharpness k of the opacity reduction",
    "capacity": "Capacity",
}
"""Titles of the groups of runs, in the order of the tables."""


@dataclass
class Row:
    """A method or an ablation on one scene.

    Attributes:
        label, method, group: see ``grid.Run``.
        records: finished runs by seed.
        timing: from the timing pass; None without one.
        failures: a sentence for each run that failed.
    """

    label: str
    method: str
    group: str
    records: dict[int, Record] = field(default_factory=dict)
    timing: Record | None = None
    failures: list[str] = field(default_factory=list)

    def by_seed(self, name: str) -> dict[int, float]:
        """Values of a figure; seeds without it are left out."""
        values = {seed: record.get(name) for seed, record in sorted(self.records.items())}
        return {seed: value for seed, value in values.items() if value is not None}

    def values(self, name: str) -> list[float]:
        """Of all seeds; none where a seed lacks it, since a middle over the others is of other runs."""
        values = list(self.by_seed(name).values())
        return values if len(values) == len(self.records) else []

    def median(self, name: str) -> float | None:
        values = self.values(name)
        return statistics.median(values) if values else None

    def deviation(self, name: str) -> float | None:
        """Over seeds; None for fewer than two."""
        values = self.values(name)
        return statistics.stdev(values) if len(values) > 1 else None

    @property
    def fps(self) -> float | None:
        """Frames a second of playback, deformation and rasterization; None if it was not timed."""
        return self.timing["playback"]["fps"] if self.timing else None

    @property
    def training_seconds(self) -> float | None:
        """From the timing pass if there is one; from the runs themselves otherwise, and for runs at equal time."""
        if self.timing and self.group != "time":
            return float(self.timing["training"]["seconds"])
        return self.median("train_seconds")

    @property
    def is_dedicated(self) -> bool:
        """Whether the training seconds were measured while no other run worked."""
        timed = self.timing is not None and self.group != "time"
        return timed or all(record["dedicated"] for record in self.records.values())


_NOT_FOR_ALL = {"moment_seeds": "seeds at many times", "size_limit": "limit on sizes"}
"""Titles of settings that not every method has, or had."""
_WORDS = {0: "no", 1: "yes"}
_IDENTITY = ("scene", "recipe_name", "planned_steps", "scale", "holdout_frames", "protocol")


@dataclass
class Section:
    """Runs that are compared with each other: on one scene, with the same recipe, steps and image size.

    Attributes:
        scene: the capture's name.
        recipe: its name.
        planned_steps, scale, holdout_frames: as asked for; None for the defaults.
        protocol: the paper's protocol that the scene belongs to, "" for none.
        rows: by group, in the order of the tables.
    """

    scene: str
    recipe: str
    planned_steps: int | None
    scale: float | None
    holdout_frames: int | None
    protocol: str = ""
    rows: dict[str, list[Row]] = field(default_factory=dict)

    @property
    def title(self) -> str:
        """``room (draft, 4000 steps, scale 0.5)``."""
        steps = {record["steps"] for row in self.rows.get("methods", ()) for record in row.records.values()}
        parts = [self.recipe]
        if len(steps) == 1:
            parts.append(f"{steps.pop()} steps")
        if self.scale is not None:
            parts.append(f"scale {self.scale:g}")
        if self.holdout_frames is not None:
            parts.append(f"one frame in {self.holdout_frames} held out")
        return f"{self.scene} ({', '.join(parts)})"

    @cached_property
    def file_name(self) -> str:
        """A name for this section's images."""
        parts = [self.scene, self.recipe]
        parts += [str(self.planned_steps)] if self.planned_steps else []
        parts += [f"x{self.scale:g}"] if self.scale is not None else []
        return "_".join(parts).replace(" ", "-").replace("/", "-")

    def row(self, label: str, group: str = "methods") -> Row | None:
        return next((row for row in self.rows.get(group, ()) if row.label == label), None)

    def of_method(self, method: str) -> Row | None:
        """The first row of a method in the main table."""
        return next((row for row in self.rows.get("methods", ()) if row.method == method), None)


def sections(records: Iterable[Record]) -> list[Section]:
    """All finished runs, grouped. Of two runs with the same row and seed, and of two timings, the later one counts."""
    records = list(records)

    def identity(record: Record) -> tuple[object, ...]:
        return tuple(record[name] for name in _IDENTITY)

    times = {(identity(record), record["label"]): record for record in records if record["kind"] == "timing"}
    grouped: dict[tuple[object, ...], Section] = {}
    for record in finished(records).values():
        values, label, group = identity(record), record["label"], record["group"]
        section = grouped.setdefault(values, Section(*values))  # type: ignore[arg-type]
        row = section.row(label, group)
        if row is None:
            row = Row(label, record["method"], group, {}, times.get((values, label)))
            section.rows.setdefault(group, []).append(row)
        row.records[record["seed"]] = record
    for section in grouped.values():
        for rows in section.rows.values():
            rows.sort(key=_place)
        section.rows = {group: section.rows[group] for group in _GROUPS if group in section.rows}
    return list(grouped.values())


def _place(row: Row) -> tuple[int, bool]:
    return ROWS.index(row.method) if row.method in ROWS else len(ROWS), row.label == AUTO_LABEL


def differences(first: Row | None, second: Row | None, name: str) -> dict[int, float]:
    """``first - second`` by seed, for the seeds that both have."""
    if first is None or second is None:
        return {}
    a, b = first.by_seed(name), second.by_seed(name)
    return {seed: a[seed] - b[seed] for seed in a if seed in b}


def markdown(records: Iterable[Record], published: str = "") -> str:
    """All tables of the results, as one page.

    Args:
        published: a table of a paper's own figures, shown beside ours.
    """
    records = list(records)
    grouped = sections(records)
    parts = [_head(records), "## Published\n\n" + published.strip() if published else ""]
    parts += [f"## {section.title}\n\n{_section(section)}" for section in grouped]
    parts += [*_averages(grouped), _paired(grouped), _failed(records)]
    return "\n\n".join(part for part in parts if part) + "\n"


def table(titles: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table; the first column is left-aligned, the others right."""
    lines = ["| " + " | ".join(titles) + " |", "|---|" + "---:|" * (len(titles) - 1)]
    return "\n".join([*lines, *("| " + " | ".join(row) + " |" for row in rows)])


def _head(records: list[Record]) -> str:
    machines = sorted({_machine(record) for record in records if "machine" in record})
    text = (
        "# Comparison\n\nHigher is better for PSNR (dB; of all pixels, and of the moving region) and SSIM (3DGS's "
        "window), lower for FLIP (67 pixels a degree) and LPIPS (AlexNet), all of the held-out images. Median over "
        "the seeds ± their standard deviation (smallest to largest). Storage is the `.frog` on disk. Training time and "
        "FPS (deformation and rasterization by the inference engine) are of a dedicated pass in which nothing else "
        "ran; a time with * was taken during the grid instead, with several runs at once."
    )
    return "\n\n".join([text, *(f"Made on {machine}." for machine in machines), _unlike(records)])


def _unlike(records: list[Record]) -> str:
    """When and by which code each method's runs were made, and what not all had then, of what could gain by itself."""
    rows: dict[str, list[Record]] = {}
    for record in finished(records).values():
        if record["group"] == "methods":
            rows.setdefault(record["label"], []).append(record)
    lines = []
    for label, runs in rows.items():
        days = sorted({run["finished_at"][:10] for run in runs})
        settings = [{run["recipe"].get(name, 0) for run in runs} for name in _NOT_FOR_ALL]
        had = [" or ".join(_WORDS.get(value, str(value)) for value in sorted(values)) for values in settings]
        codes = {run["code"]["commit"] or run["code"]["hash"] for run in runs if "code" in run}
        by = ", ".join(sorted(name[:8] + name[40:] for name in codes)) or _NONE
        lines.append([label, " to ".join(dict.fromkeys((days[0], days[-1]))), by, *had])
    return table(["", "made", "by commit", *_NOT_FOR_ALL.values()], lines) if lines else ""


def _machine(record: Record) -> str:
    machine, versions = record["machine"], record["versions"]
    parts = [machine["cpu"], f"{machine['cores']} cores", machine["instruction_set"], machine["gpu"]]
    parts += [f"{name} {versions[name]}" for name in ("torch", "numpy") if versions.get(name)]
    return ", ".join(str(part) for part in parts if part)


def _spread(values: Sequence[float], form: str, middle: Callable[[Sequence[float]], float]) -> str:
    """The middle of some values and, where there are several, their standard deviation and range."""
    text = format(middle(values), form)
    if len(values) < 2:
        return text
    return f"{text} ± {statistics.stdev(values):{form.lstrip('+')}} ({min(values):{form}} to {max(values):{form}})"


def cell(row: Row, name: str) -> str:
    """Median and range of a figure, or why it is missing."""
    values = row.values(name)
    if values:
        return _spread(values, f".{_DIGITS.get(name, 2)}f", statistics.median)
    told = sorted({record.get("missing", {}).get(name, "") for record in row.records.values()} - {""})
    if some := row.by_seed(name):
        told.insert(0, f"{len(some)} of {len(row.records)} seeds")
    return ", ".join(told) or _NONE


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


def _megabytes(size: float | None) -> str:
    return _NONE if size is None else f"{size / 1e6:.1f}"


def _rows(rows: Sequence[Row]) -> str:
    lines = [
        [
            row.label,
            *(cell(row, name) for name in FIGURES),
            _megabytes(row.median("bytes")),
            _number(row.median("gaussians"), 0),
            duration(row.training_seconds) + ("" if row.is_dedicated else " *"),
            _number(row.fps, 1),
            str(len(row.records)),
        ]
        for row in rows
    ]
    return table(["", *FIGURES.values(), "storage, MB", "Gaussians", "training", "FPS", "seeds"], lines)


def _section(section: Section) -> str:
    frog = section.of_method("frog")
    first = [frog] if frog else []
    parts = []
    for group, rows in section.rows.items():
        if group == "methods":
            parts += [_rows(rows), *off_rig({row.label: row for row in rows})]
        elif group == "time":
            timed = [replace(row, group="time") for row in first]
            parts.append(f"### {_GROUPS[group]}\n\n{_rows([*timed, *rows])}")
        else:
            changes = ([row.label, *(_change(row, frog, name) for name in FIGURES)] for row in rows)
            changed = table(["difference to FRoG", *FIGURES.values()], changes)
            parts.append(f"### {_GROUPS[group]}\n\n{_rows([*first, *rows])}\n\n{changed}")
    return "\n\n".join(parts)


def off_rig(rows: Mapping[str, Row]) -> list[str]:
    """A table of what rows by title have off the rig; none where none has."""
    lines = [[title, *(cell(row, name) for name in OFF_RIG)] for title, row in rows.items() if row.values("fly")]
    return ["PSNR in images from off the rig:\n\n" + table(["", *OFF_RIG], lines)] if lines else []


def _change(row: Row | None, base: Row | None, name: str) -> str:
    """The mean difference by seed, and its range."""
    values = list(differences(row, base, name).values())
    return _spread(values, f"+.{_DIGITS[name]}f", statistics.mean) if values else _NONE


def _averages(grouped: list[Section]) -> list[str]:
    """Over the scenes of each recipe: the mean of the scenes' medians, or as a paper's protocol takes them."""
    parts = []
    for protocol, recipe in dict.fromkeys((section.protocol, section.recipe) for section in grouped):
        scenes = [s for s in grouped if (s.protocol, s.recipe) == (protocol, recipe) and "methods" in s.rows]
        paper = named("protocol", protocol, PROTOCOLS).of({s.scene for s in scenes}) if protocol else None
        if len(scenes) < 2:
            continue
        lines = []
        for label in dict.fromkeys(row.label for section in scenes for row in section.rows["methods"]):
            rows = {section.scene: row for section in scenes if (row := section.row(label)) is not None}
            means = averages(paper, {s: _values(r) for s, r in rows.items()})
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
        titles = ["", *FIGURES.values(), "storage, MB", "training", "FPS", "scenes"]
        name = f"{protocol}, {recipe}" if protocol else recipe
        lacking = f"{left_out(protocol, paper)}\n\n" if paper and left_out(protocol, paper) else ""
        parts.append(f"## Average over the scenes ({name})\n\n{lacking}" + table(titles, lines))
    return parts


def _values(row: Row) -> Mapping[str, float | None]:
    quality = {name: row.median(name) for name in (*FIGURES, "bytes")}
    return {**quality, "train_seconds": row.training_seconds, "fps": row.fps}


def _paired(grouped: list[Section]) -> str:
    """FRoG against its baseline, seed by seed."""
    pairs = [(section.title, section.of_method("frog"), section.of_method("ed3dgs")) for section in grouped]
    pairs = [(title, frog, base) for title, frog, base in pairs if differences(frog, base, "psnr")]
    if not pairs:
        return ""
    lines = [
        [title, *(_change(frog, base, name) for name in FIGURES), str(len(differences(frog, base, "psnr")))]
        for title, frog, base in pairs
    ]
    if len(pairs) > 1:
        mean = ["mean of the scenes"]
        for name in FIGURES:
            by_scene = [list(differences(frog, base, name).values()) for _, frog, base in pairs]
            means = [statistics.mean(values) for values in by_scene if values]
            mean.append(f"{statistics.mean(means):+.{_DIGITS[name]}f}" if means else _NONE)
        lines.append([*mean, ""])
    return (
        "## FRoG minus E-D3DGS, by seed\n\nMean ± standard deviation (smallest to largest) of the differences.\n\n"
        + table(["", *FIGURES.values(), "pairs"], lines)
    )


def _failed(records: list[Record]) -> str:
    done = finished(records)
    failed = {record["key"]: record for record in records if record["kind"] == "failed" and record["key"] not in done}
    lines = [f"- {r['scene']}, {r['label']}, seed {r['seed']}: {r['error']}" for r in failed.values()]
    return "## Failed\n\n" + "\n".join(lines) if lines else ""
