"""Results grouped for tables and charts: sections by scene, rows by method, values by seed."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

from .grid import ABLATIONS, AUTO_LABEL, ROWS
from .results import Record, finished, timings

GROUPS = ("methods", "time", *ABLATIONS)
FIGURES = ("psnr", "psnr_moving", "ssim", "flip", "lpips")


@dataclass
class Row:
    """A method or an ablation on one scene.

    Attributes:
        label, method, group: see ``grid.Run``.
        records: finished runs by seed.
        timing: from the timing pass; None without one.
    """

    label: str
    method: str
    group: str
    records: dict[int, Record] = field(default_factory=dict)
    timing: Record | None = None

    def by_seed(self, name: str) -> dict[int, float]:
        """Values of a figure; seeds without it are left out."""
        found = {seed: record.get(name) for seed, record in sorted(self.records.items())}
        return {seed: value for seed, value in found.items() if value is not None}

    def values(self, name: str) -> list[float]:
        return list(self.by_seed(name).values())

    def median(self, name: str) -> float | None:
        values = self.values(name)
        return statistics.median(values) if values else None

    def of_seeds(self, seeds: set[int]) -> Row:
        """The row with the runs of these seeds only."""
        return replace(self, records={seed: record for seed, record in self.records.items() if seed in seeds})

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

    def why_missing(self, name: str) -> str:
        """Why a figure is missing; "" if unknown."""
        reasons = {record.get("missing", {}).get(name, "") for record in self.records.values()}
        return ", ".join(sorted(reasons - {""}))


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


_IDENTITY = ("scene", "recipe_name", "planned_steps", "scale", "holdout_frames", "protocol")


def sections(records: Iterable[Record]) -> list[Section]:
    """All finished runs, grouped. Of two runs with the same row and seed the later one counts."""
    records = list(records)
    times = timings(records, (*_IDENTITY, "label"))
    found: dict[tuple[object, ...], Section] = {}
    for record in finished(records).values():
        identity = tuple(record[name] for name in _IDENTITY)
        section = found.setdefault(identity, Section(*identity))
        rows = section.rows.setdefault(record["group"], [])
        row = next((row for row in rows if row.label == record["label"]), None)
        if row is None:
            group = record["group"]
            row = Row(record["label"], record["method"], group, {}, times.get((*identity, record["label"])))
            rows.append(row)
        row.records[record["seed"]] = record
    for section in found.values():
        for rows in section.rows.values():
            rows.sort(key=_place)
        section.rows = {group: section.rows[group] for group in GROUPS if group in section.rows}
    return list(found.values())


def _place(row: Row) -> tuple[int, bool]:
    return ROWS.index(row.method) if row.method in ROWS else len(ROWS), row.label == AUTO_LABEL


def differences(first: Row | None, second: Row | None, name: str) -> dict[int, float]:
    """``first - second`` by seed, for the seeds that both have."""
    if first is None or second is None:
        return {}
    a, b = first.by_seed(name), second.by_seed(name)
    return {seed: a[seed] - b[seed] for seed in a if seed in b}


def spread(values: Sequence[float]) -> tuple[float, float, float]:
    """Median, smallest and largest."""
    return statistics.median(values), min(values), max(values)
