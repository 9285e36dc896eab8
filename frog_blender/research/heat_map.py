"""The stability suite's report: a heat map of what each condition costs each method, and the table behind it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from ..engine import write_atomically
from ..engine.registry import METHODS
from .charts import save_figure
from .results import read
from .stability import Cell, Outcome, outcome

_WORST = 8.0  # dB at which the colours end


def write_stability(folder: Path) -> list[Path]:
    """Writes ``stability.md`` and the heat map of the results in ``folder``; returns their paths.

    Raises:
        FrogError: if there is no finished run yet.
    """
    found = outcome(read(folder / "runs.jsonl"))
    images = save_figure(heat_map(found), folder / "stability")
    path = folder / "stability.md"
    write_atomically(path, stability_table(found).encode())
    return [path, *images]


def heat_map(found: Outcome) -> Any:
    """A matplotlib figure: rows are conditions, columns are methods.

    Colours are the dB lost against the same method's reference condition. A cell without one has its PSNR and no
    colour. Each cell has its standard deviation over seeds, and after ``!`` the number of failed runs.
    """
    import numpy as np
    from matplotlib.figure import Figure

    rows, labels = found.conditions, found.labels
    losses = np.array(
        [[value if (value := found.loss(row, label)) is not None else np.nan for label in labels] for row in rows]
    )
    figure = Figure(figsize=(2.6 + 1.45 * len(labels), 1.6 + 0.3 * len(rows)), dpi=130, layout="constrained")
    axes = figure.subplots()
    colors = axes.imshow(losses, cmap="RdBu", vmin=-_WORST, vmax=_WORST, aspect="auto")
    for y, row in enumerate(rows):
        for x, label in enumerate(labels):
            cell, loss = found.cell(row.name, label), losses[y, x]
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


def _cell_text(cell: Cell, loss: float) -> str:
    """Such as ``-1.32 ±0.10 !1``, where the last is the number of failed runs."""
    if cell.median is None:
        words = "-"
    elif not math.isnan(loss):
        words = f"{loss:+.2f}"
    else:
        words = f"{cell.median:.2f} dB"
    words += "" if cell.deviation is None else f" ±{cell.deviation:.2f}"
    return words + (f" !{len(cell.failures)}" if cell.failures else "")


def stability_table(found: Outcome) -> str:
    """Median PSNR with its deviation and number of seeds, FRoG's lead, and every failure in words, as Markdown."""
    frog, base, static = (METHODS[name].title for name in ("frog", "ed3dgs", "static"))
    head = ["condition", *found.labels, f"{frog} - {base}", f"{frog} - {static}"]
    lines = ["| " + " | ".join(head) + " |", "|---|" + "---:|" * (len(head) - 1)]
    failures = []
    for row in found.conditions:
        cells = [found.cell(row.name, label) for label in found.labels]
        words = [_figure(cell) for cell in cells]
        words += [_ahead(found.cell(row.name, frog), found.cell(row.name, other)) for other in (base, static)]
        lines.append("| " + " | ".join([row.name, *words]) + " |")
        for label, cell in zip(found.labels, cells, strict=True):
            failures += [f"- {row.name}, {label}, {sentence}" for sentence in cell.failures]
    intro = (
        "PSNR of the held-out images in dB: median over seeds, their standard deviation, their number. Images of "
        "less light are compared after brightening both by as much.\n\n![what each condition costs](stability.png)\n\n"
    )
    end = "\n".join(failures) or "None."
    return f"# Stability\n\n{intro}" + "\n".join(lines) + f"\n\n## Failed runs\n\n{end}\n"


def _figure(cell: Cell) -> str:
    if cell.median is None:
        return "-"
    spread = "" if cell.deviation is None else f" ± {cell.deviation:.2f}"
    return f"{cell.median:.2f}{spread} ({len(cell.psnr)})"


def _ahead(first: Cell, second: Cell) -> str:
    """Mean difference over the seeds that both have."""
    both = [first.psnr[seed] - second.psnr[seed] for seed in first.psnr if seed in second.psnr]
    return f"{sum(both) / len(both):+.2f}" if both else "-"
