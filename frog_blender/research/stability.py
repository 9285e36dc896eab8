"""The stability suite: methods under conditions in which methods fail, and a summary of the results."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from ..engine import FrogError, open_capture
from ..engine.registry import METHODS
from .corruptions.catalogue import BASES, CONDITIONS, Condition, condition_named
from .grid import AUTO_ROW, CommonSettings, Run, row_named, with_seeds
from .results import Record, finished

ROWS = ("frog", AUTO_ROW, "ed3dgs", "static", "hexplane")
"""The rows of the suite in the order of its tables: the paper's method, then the baselines."""
WORSE_THAN_STATIC = 1.0
"""A run counts as failed if its PSNR is this much (dB) below the static scene's."""


def stability_grid(
    captures: Mapping[str, Path],
    common: CommonSettings | None = None,
    *,
    conditions: Sequence[str] = tuple(CONDITIONS),
    methods: Sequence[str] = ROWS,
    frog_seeds: int = 5,
    seeds: int = 3,
    side: int | None = None,
) -> list[Run]:
    """Runs under every condition whose capture is given: the first seed of everything, then the next.

    Args:
        captures: folders by ``corruptions.catalogue.BASES``.
        common: what all runs share; a condition's own settings are added.
        frog_seeds, seeds: of FRoG and of each other method.
        side: longest side of the images in pixels, where a capture's are larger.

    Raises:
        FrogError: for a condition, method or setting that does not exist.
    """
    common = common or CommonSettings()
    scales = {base: _scale(folder, side) for base, folder in captures.items()}
    runs: list[Run] = []
    for condition in map(condition_named, conditions):
        if condition.base not in captures:
            continue
        folder = captures[condition.base]
        scaled = replace(common, scale=scales[condition.base])
        for row in methods:
            method, label, own = row_named(row)
            changes = {**condition.settings, **own}
            first = scaled.run(folder.resolve().name, folder, method, label=label, **changes)
            first = replace(first, group="stability", condition=condition.name)
            runs += with_seeds(first, frog_seeds if row == "frog" else seeds)
    return sorted(runs, key=lambda run: run.seed)


def _scale(folder: Path, side: int | None) -> float | None:
    """The factor that reduces a capture's images to that longest side; None where they are not larger."""
    if side is None:
        return None
    longest = max(max(camera.width, camera.height) for camera in open_capture(folder).cameras)
    return side / longest if longest > side else None


def without_captures(captures: Mapping[str, Path], conditions: Sequence[str]) -> list[str]:
    """A sentence for each capture that some conditions need and that was not given."""
    missing: dict[str, list[str]] = {}
    for condition in map(condition_named, conditions):
        if condition.base not in captures:
            missing.setdefault(condition.base, []).append(condition.name)
    return [f"Left out without --{base} ({BASES[base]}): {', '.join(names)}." for base, names in missing.items()]


@dataclass
class Cell:
    """A method under a condition.

    Attributes:
        psnr: of the held-out images in dB, by seed. Where the light was dimmed both images are brightened first.
        failures: a sentence for each run that failed.
    """

    psnr: dict[int, float] = field(default_factory=dict)
    failures: list[str] = field(default_factory=list)

    @property
    def median(self) -> float | None:
        return statistics.median(self.psnr.values()) if self.psnr else None

    @property
    def deviation(self) -> float | None:
        """Over seeds; None for fewer than two."""
        return statistics.stdev(self.psnr.values()) if len(self.psnr) > 1 else None


@dataclass
class Outcome:
    """The results by cell: ``cells`` by (condition, label), ``labels`` in the order of the tables."""

    labels: list[str]
    cells: dict[tuple[str, str], Cell]

    @property
    def conditions(self) -> list[Condition]:
        """Those with a result."""
        return [item for item in CONDITIONS.values() if any(name == item.name for name, _ in self.cells)]

    def cell(self, condition: str, label: str) -> Cell:
        return self.cells.get((condition, label), Cell())

    def loss(self, condition: Condition, label: str) -> float | None:
        """Median PSNR minus that of the same method under the reference condition, dB; None without both."""
        here, there = self.cell(condition.name, label).median, self.cell(condition.against, label).median
        return None if here is None or there is None or not condition.against else here - there


def outcome(records: Iterable[Record]) -> Outcome:
    """Gathers the last finished run of each key, and the failed runs.

    A run failed when it ended with an error, when its images have no finite PSNR, or when they are worse than the
    static scene's of the same condition by ``WORSE_THAN_STATIC``.

    Raises:
        FrogError: where there is no run of the suite.
    """
    records = [record for record in records if record.get("condition") in CONDITIONS]
    done = finished(records)
    order = [row_named(name)[1] for name in ROWS]
    found = Outcome([], {})
    for record in records:
        key = (record["condition"], record["label"])
        if record["kind"] == "failed" and record["key"] not in done:
            found.cells.setdefault(key, Cell()).failures.append(f"seed {record['seed']}: {record['error']}")
    for record in done.values():
        cell = found.cells.setdefault((record["condition"], record["label"]), Cell())
        psnr = record["psnr"] if record.get("psnr_bright") is None else record["psnr_bright"]
        if psnr is None:
            cell.failures.append(f"seed {record['seed']}: its images are not finite")
        else:
            cell.psnr[record["seed"]] = psnr
    if not found.cells:
        raise FrogError("There is no finished run of the stability suite, expected at least one.")
    labels = {label for _, label in found.cells}
    found.labels = [label for label in order if label in labels] + sorted(labels - set(order))
    static = METHODS["static"].title
    for (condition, label), cell in found.cells.items():
        base = found.cell(condition, static).median
        if base is None or label == static:
            continue
        for seed, psnr in cell.psnr.items():
            if psnr < base - WORSE_THAN_STATIC:
                cell.failures.append(f"seed {seed}: {base - psnr:.1f} dB worse than a static scene")
    return found
