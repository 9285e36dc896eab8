"""The stability suite: methods under the conditions in which they fail, and what came out, put together."""

from __future__ import annotations

import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ..engine.capture.readers import open_capture
from ..engine.errors import FrogError
from ..engine.training.methods import method_named
from .corruptions.catalogue import BASES, CONDITIONS, Condition, condition_named
from .grid import AUTO_ROW, Run, row_named
from .results import Record, finished

METHODS = ("frog", AUTO_ROW, "ed3dgs", "static", "hexplane")
"""Those that the suite compares, in the order of its tables: the paper's, its base, the baseline, one more rival."""
WORSE_THAN_STATIC = 1.0
"""Decibels under the static scene from which on a run counts as failed."""


def stability_grid(
    captures: Mapping[str, Path],
    *,
    conditions: Sequence[str] = tuple(CONDITIONS),
    methods: Sequence[str] = METHODS,
    recipe: str = "draft",
    overrides: Mapping[str, Any] | None = None,
    frog_seeds: int = 5,
    seeds: int = 3,
    steps: int | None = None,
    side: int | None = None,
) -> list[Run]:
    """Runs under every condition whose capture is there: a first seed of everything, then the next.

    Args:
        captures: folders by ``conditions.catalogue.BASES``.
        frog_seeds, seeds: of FRoG and of each other method.
        recipe, overrides, steps: the same for all.
        side: longest side of the images in pixels, where a capture's are larger.

    Raises:
        FrogError: for a condition, method or setting that does not exist.
    """
    runs = []
    scales = {base: _scale(folder, side) for base, folder in captures.items()}
    for condition in map(condition_named, conditions):
        if condition.base not in captures:
            continue
        folder = captures[condition.base]
        for method in methods:
            name, label, own = row_named(method)
            settings = {**(overrides or {}), **condition.settings, **own}
            run = Run(
                folder.resolve().name,
                str(folder),
                name,
                label,
                recipe,
                tuple(sorted(settings.items())),
                steps=steps,
                scale=scales[condition.base],
                group="stability",
                condition=condition.name,
            )
            run.settings()  # says what is mistaken now, not hours later
            runs += [replace(run, seed=seed) for seed in range(frog_seeds if method == "frog" else seeds)]
    return sorted(runs, key=lambda run: run.seed)


def _scale(folder: Path, side: int | None) -> float | None:
    """The factor that brings a capture's images to that longest side, None where they are no larger."""
    if side is None:
        return None
    longest = max(max(camera.width, camera.height) for camera in open_capture(folder).cameras)
    return side / longest if longest > side else None


def without_captures(captures: Mapping[str, Path], conditions: Sequence[str]) -> list[str]:
    """A sentence for each kind of capture that conditions need and that was not given."""
    missing: dict[str, list[str]] = {}
    for condition in map(condition_named, conditions):
        if condition.base not in captures:
            missing.setdefault(condition.base, []).append(condition.name)
    return [f"Left out without --{base} ({BASES[base]}): {', '.join(names)}." for base, names in missing.items()]


@dataclass
class Cell:
    """A method under a condition.

    Attributes:
        psnr: of held-out images by seed, dB; brightened ones where the light was less.
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
    """What a results file says: ``cells`` by (condition, label), ``labels`` in the order of the tables."""

    labels: list[str]
    cells: dict[tuple[str, str], Cell]

    @property
    def conditions(self) -> list[Condition]:
        """Those with a result."""
        return [item for item in CONDITIONS.values() if any(name == item.name for name, _ in self.cells)]

    def cell(self, condition: str, label: str) -> Cell:
        return self.cells.get((condition, label), Cell())

    def loss(self, condition: Condition, label: str) -> float | None:
        """Median PSNR less that of the same method in the condition it is measured against; None without both."""
        here, there = self.cell(condition.name, label).median, self.cell(condition.against, label).median
        return None if here is None or there is None or not condition.against else here - there


def outcome(records: Iterable[Record]) -> Outcome:
    """Puts the last finished run of each key together, and those that failed.

    A run failed when it ended with an error, when its images have no finite PSNR, or when they are worse than the
    static scene's of the same condition by ``WORSE_THAN_STATIC``.

    Raises:
        FrogError: where there is no run of the suite.
    """
    records = [record for record in records if record.get("condition") in CONDITIONS]
    done = finished(records)
    order = [row_named(name)[1] for name in METHODS]
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
    static = method_named("static").title
    for (condition, label), cell in found.cells.items():
        base = found.cell(condition, static).median
        if base is None or label == static:
            continue
        for seed, psnr in cell.psnr.items():
            if psnr < base - WORSE_THAN_STATIC:
                cell.failures.append(f"seed {seed}: {base - psnr:.1f} dB worse than a static scene")
    return found
