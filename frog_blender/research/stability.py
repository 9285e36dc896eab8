"""The stability suite: methods under conditions in which methods fail, a heat map of the results, and its table."""

import math
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from ..engine import FrogError, named, open_capture, write_atomically
from ..engine.registry import METHODS
from .charts import save_figure
from .conditions import BASES, CONDITIONS, Condition
from .grid import AUTO_ROW, Run, row_named
from .report import Row, differences, off_rig, table
from .results import Record, finished, read, write_csv
from .runs import OFF_RIG

ROWS = ("frog", AUTO_ROW, "ed3dgs", "static", "hexplane")
"""The rows of the suite in the order of its tables: the paper's method, then the baselines."""
WORSE_THAN_STATIC = 1.0
"""A run counts as failed if its PSNR is this much (dB) below the static scene's."""
_WORST = 8.0  # dB at which the colours of the heat map end


def stability_grid(
    captures: Mapping[str, Path],
    common: Run | None = None,
    *,
    conditions: Sequence[str] = tuple(CONDITIONS),
    rows: Sequence[str] = ROWS,
    seeds: tuple[int, int] = (5, 3),
    side: int | None = None,
) -> list[Run]:
    """Runs under every condition whose capture is given: the first seed of everything, then the next.

    Args:
        captures: folders by ``conditions.BASES``.
        common: what all runs share; a condition's own settings are added.
        rows: which of ``grid.ROWS``.
        seeds: of FRoG and of each other row.
        side: longest side of the images in pixels, where a capture's are larger.

    Raises:
        FrogError: for a condition, method or setting that does not exist, and a folder that is no capture.
    """
    common = replace(common or Run(), group="stability")
    scales = {base: _scale(folder, side) for base, folder in captures.items()}
    runs: list[Run] = []
    for name in conditions:
        condition = named("condition", name, CONDITIONS)
        if condition.base not in captures:
            continue
        folder = captures[condition.base]
        under = replace(common, scale=scales[condition.base], condition=condition.name)
        for row in rows:
            label, method, own = row_named(row)
            first = under.of(folder.resolve().name, folder, method, label, {**condition.settings, **own})
            runs += first.with_seeds(seeds[row != "frog"])
    return sorted(runs, key=lambda run: run.seed)


def _scale(folder: Path, side: int | None) -> float | None:
    """The factor that reduces a capture's images to that longest side; None where they are not larger. FrogError
    where there is no capture, before the first run."""
    longest = max(max(camera.width, camera.height) for camera in open_capture(folder).cameras)
    return side / longest if side and longest > side else None


def without_captures(captures: Mapping[str, Path], conditions: Sequence[str]) -> list[str]:
    """A sentence for each capture that some conditions need and that was not given."""
    missing: dict[str, list[str]] = {}
    for name in conditions:
        base = CONDITIONS[name].base
        if base not in captures:
            missing.setdefault(base, []).append(name)
    return [f"Left out without --{base} ({BASES[base]}): {', '.join(names)}." for base, names in missing.items()]


@dataclass
class Outcome:
    """The results by cell: ``cells`` by (condition, label), ``labels`` in the order of the tables. A cell is a row of a
    chart with one figure, "psnr" of the held-out images in dB. Where the light was dimmed both images are brightened
    first."""

    labels: list[str]
    cells: dict[tuple[str, str], Row]

    @property
    def conditions(self) -> list[Condition]:
        """Those with a result."""
        return [item for item in CONDITIONS.values() if any(name == item.name for name, _ in self.cells)]

    def cell(self, condition: str, label: str) -> Row:
        return self.cells.get((condition, label), Row(label, "", ""))

    def lead(self, condition: str, first: str, second: str) -> list[float]:
        """Differences of one method to another, for the seeds that both have."""
        return list(differences(self.cell(condition, first), self.cell(condition, second), "psnr").values())

    def loss(self, condition: Condition, label: str) -> float | None:
        """Median PSNR minus that of the same method under the reference condition, dB; None without both."""
        here, there = (self.cell(name, label).median("psnr") for name in (condition.name, condition.against))
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
    cells: dict[tuple[str, str], Row] = {}

    def cell_of(record: Record) -> Row:
        return cells.setdefault((record["condition"], record["label"]), Row(record["label"], "", ""))

    for record in records:
        if record["kind"] == "failed" and record["key"] not in done:
            cell_of(record).failures.append(f"seed {record['seed']}: {record['error']}")
    for record in done.values():
        psnr = record["psnr"] if record.get("psnr_bright") is None else record["psnr_bright"]
        if psnr is None:
            cell_of(record).failures.append(f"seed {record['seed']}: its images are not finite")
        else:
            cell_of(record).records[record["seed"]] = {name: record.get(name) for name in OFF_RIG} | {"psnr": psnr}
    if not cells:
        raise FrogError("There is no finished run of the stability suite, expected at least one.")
    static = METHODS["static"].title
    for (condition, label), cell in cells.items():
        base = cells.get((condition, static), Row(static, "", "")).median("psnr")
        if base is None or label == static:
            continue
        for seed, psnr in cell.by_seed("psnr").items():
            if psnr < base - WORSE_THAN_STATIC:
                cell.failures.append(f"seed {seed}: {base - psnr:.1f} dB worse than a static scene")
    labels, order = {label for _, label in cells}, [row_named(name)[0] for name in ROWS]
    return Outcome([label for label in order if label in labels] + sorted(labels - set(order)), cells)


def write_stability(folder: Path) -> list[Path]:
    """Writes ``stability.md``, ``runs.csv`` and the heat map of the results in ``folder``; returns their paths.

    Raises:
        FrogError: if there is no finished run yet.
    """
    records = read(folder / "runs.jsonl")
    results = outcome(records)
    image, path = save_figure(heat_map(results), folder / "stability.svg"), folder / "stability.md"
    write_atomically(path, stability_table(results).encode())
    return [path, write_csv(folder, records), image]


def heat_map(results: Outcome) -> Any:
    """A matplotlib figure: rows are conditions, columns are methods.

    Colours are the dB lost against the same method's reference condition. A cell without one has its PSNR and no
    colour. Each cell has its standard deviation over seeds, and after ``!`` the number of failed runs.
    """
    import numpy as np
    from matplotlib.figure import Figure

    rows, labels = results.conditions, results.labels
    losses = np.array([[results.loss(row, label) for label in labels] for row in rows], float)
    figure = Figure(figsize=(2.6 + 1.45 * len(labels), 1.6 + 0.3 * len(rows)), dpi=130, layout="constrained")
    axes = figure.subplots()
    colors = axes.imshow(losses, cmap="RdBu", vmin=-_WORST, vmax=_WORST, aspect="auto")
    for y, row in enumerate(rows):
        for x, label in enumerate(labels):
            cell, loss = results.cell(row.name, label), losses[y, x]
            dark = abs(loss) > 0.6 * _WORST
            axes.text(x, y, _cell_text(cell, loss), ha="center", va="center", fontsize=7.5, color="w" if dark else "k")
    axes.set_xticks(range(len(labels)), labels)
    axes.xaxis.tick_top()
    axes.set_yticks(range(len(rows)), [row.name for row in rows])
    axes.tick_params(length=0)
    figure.colorbar(colors, ax=axes, label="dB against the same method's clean case", shrink=0.6)
    figure.supxlabel(  # in lines that fit the narrowest image
        "PSNR where a row has no clean case\n±: standard deviation over seeds; !: failed runs", fontsize="medium"
    )
    return figure


def _cell_text(cell: Row, loss: float) -> str:
    """Such as ``-1.32 ±0.10 !1``, where the last is the number of failed runs."""
    psnr, deviation = cell.median("psnr"), cell.deviation("psnr")
    if psnr is None:
        words = "-"
    else:
        words = f"{psnr:.2f} dB" if math.isnan(loss) else f"{loss:+.2f}"
    words += "" if deviation is None else f" ±{deviation:.2f}"
    return words + (f" !{len(cell.failures)}" if cell.failures else "")


def stability_table(results: Outcome) -> str:
    """Median PSNR with its deviation and number of seeds, FRoG's lead, and every failure in words, as Markdown."""
    frog, base, static = (METHODS[name].title for name in ("frog", "ed3dgs", "static"))
    lines, failures, named_cells = [], [], dict[str, Row]()
    for row in results.conditions:
        cells = {label: results.cell(row.name, label) for label in results.labels}
        named_cells |= {f"{row.name}, {label}": cell for label, cell in cells.items()}
        leads = [results.lead(row.name, frog, other) for other in (base, static)]
        words = [f"{statistics.mean(lead):+.2f}" if lead else "-" for lead in leads]
        lines.append([row.name, *map(_figure, cells.values()), *words])
        failures += [f"- {row.name}, {label}, {said}" for label, cell in cells.items() for said in cell.failures]
    intro = (
        "PSNR of the held-out images in dB: median over seeds, their standard deviation, their number. Images of "
        "less light are compared after brightening both by as much.\n\n![what each condition costs](stability.svg)\n\n"
    )
    shown = table(["condition", *results.labels, f"{frog} - {base}", f"{frog} - {static}"], lines)
    shown = "\n\n".join([shown, *off_rig(named_cells)])
    return f"# Stability\n\n{intro}{shown}\n\n## Failed runs\n\n" + ("\n".join(failures) or "None.") + "\n"


def _figure(cell: Row) -> str:
    psnr, deviation = cell.median("psnr"), cell.deviation("psnr")
    if psnr is None:
        return "-"
    spread = "" if deviation is None else f" ± {deviation:.2f}"
    return f"{psnr:.2f}{spread} ({len(cell.records)})"
