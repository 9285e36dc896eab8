"""What the rasterizer benchmark makes of its measurements: shares of the machine's peak, a table, a chart.

Arithmetic of one blended (Gaussian, pixel) pair, in floating-point operations: a fused multiply-add counts 2; a
reciprocal 1; tests, minima, roundings and shifts of the exponent nothing; nor does what is shared by the Gaussian's
pixels in a row or column of a tile, nor a pair that is tried and not blended:

    power = constant[row] - (along dx [column] + shift[row])^2               3
    alpha = 2^power: reduction 1, polynomial of degree 5                     11
    weight = T alpha, T = T - T alpha                                        2
    red, green, blue += weight colour                                        6     forward: 22

    power, alpha, T = T / (1 - alpha), weight = T alpha                      18
    own = weight (g.colour), rest += own                                     7
    dL/dlog alpha = own - rest alpha / (1 - alpha)                           3
    gradient of the colour += weight g                                       6
    moments down a column: dL/dlog alpha times 1, dy, dy^2                   5     backward: 39
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

FORWARD_FLOPS = 3 + 11 + 2 + 6
BACKWARD_FLOPS = 18 + 7 + 3 + 6 + 5
QUIET = 0.97  # of a core: what one thread gets where nothing else wants it
COLORS = {"avx512": "#1b6ca8", "avx2": "#2a9d8f", "baseline": "#8d99ae", "cuda": "#c44536", "gsplat": "#e9a23b"}
_HEADINGS = (
    *("scene", "Gaussians", "M pairs", "kernels", "threads", "forward ms", "backward ms", "peak MB"),
    *("forward rate", "backward rate", "forward of peak", "backward of peak"),
)

Record = dict[str, Any]


def kernels(record: Record) -> str:
    """What drew: the instruction set on the CPU, else the backend."""
    return record["isa"] or record["backend"]


def add_rates(record: Record, core_gflops: float | None) -> None:
    """Adds ``{forward, backward}_gpairs_per_core`` and ``_share`` (of the peak of what it ran on; None: unknown).

    A GPU counts as one core.
    """
    cores = record["threads"] or 1
    peak = cores * core_gflops if core_gflops else None
    if record["threads"] is None:
        peak = record.get("device_peak_gflops")
    for name, flops in (("forward", FORWARD_FLOPS), ("backward", BACKWARD_FLOPS)):
        if record["pairs"] is None:  # nobody counted them
            record[f"{name}_gpairs_per_core"] = record[f"{name}_share"] = None
            continue
        rate = record["pairs"] / record[f"{name}_s"] * 1e-9
        record[f"{name}_gpairs_per_core"] = rate / cores
        record[f"{name}_share"] = rate * flops / peak if peak else None


def table(records: list[Record]) -> str:
    """One row a run, as Markdown."""
    rows = [_HEADINGS, ("---", *("---:" for _ in _HEADINGS[1:])), *map(_row, records)]
    return "\n".join(f"| {' | '.join(row)} |" for row in rows)


def _row(record: Record) -> list[str]:
    shares = [record[f"{name}_share"] for name in ("forward", "backward")]
    rates = [record[f"{name}_gpairs_per_core"] for name in ("forward", "backward")]
    return [
        record["scene"],
        str(record["gaussians_in_scene"]),
        "?" if record["pairs"] is None else f"{record['pairs'] / 1e6:.1f}",
        kernels(record),
        str(record["threads"] or "GPU"),
        *(f"{1e3 * record[f'{name}_s']:.2f}" for name in ("forward", "backward")),
        "?" if record["peak_rss_mb"] is None else f"{record['peak_rss_mb']:.0f}",
        *("?" if rate is None else f"{rate:.3f}" for rate in rates),
        *("?" if share is None else f"{100 * share:.0f} %" for share in shares),
    ]


def remarks(records: list[Record]) -> list[str]:
    """Sentences below the table: units, scaling over threads for every scene, how straight time is against pairs."""
    lines = ["Rates are 10^9 blended (Gaussian, pixel) pairs a second and core, or a second where it is a GPU."]
    cpu = {(r["scene"], r["isa"], r["threads"]): r for r in records if r["backend"] == "cpu"}
    for (scene, isa, threads), run in cpu.items():
        single = cpu.get((scene, isa, 1))
        if threads > 1 and single:
            gains = [single[f"{name}_s"] / run[f"{name}_s"] for name in ("forward", "backward")]
            gain = f"forward {gains[0]:.2f} x, backward {gains[1]:.2f} x, on {run['cores_used']:.1f} cores"
            lines.append(f"{scene}, {isa}: {threads} threads for 1 make {gain}.")
    for kernel in COLORS:
        for label, names in (("forward", ["forward_s"]), ("forward and backward", ["forward_s", "backward_s"])):
            pairs, seconds = _points([r for r in _sweep(records) if kernels(r) == kernel], names)
            if len(pairs) > 2:
                slope, offset = np.polyfit(np.log(pairs), np.log(seconds), 1)
                farthest = np.exp(np.abs(np.log(seconds) - slope * np.log(pairs) - offset).max()) - 1
                line = f"exponent {slope:.2f}, at most {100 * farthest:.0f} % from the straight line"
                span = f"{pairs[0] / 1e6:.0f} to {pairs[-1] / 1e6:.0f} million pairs"
                lines.append(f"{kernel}, {label}, against {span}: {line}.")
    least = min((r["cores_used"] for r in records if r["threads"] == 1), default=1)
    if least < QUIET:
        lines.append(f"The machine was not quiet: a single thread got only {100 * least:.0f} % of a core.")
    return lines


def _sweep(records: list[Record]) -> list[Record]:
    return [record for record in records if record["scene"].startswith("sweep")]


def _points(records: list[Record], names: list[str]) -> tuple[np.ndarray, np.ndarray]:
    """Pairs and the sum of the named seconds, by pairs."""
    points = sorted((record["pairs"], sum(record[name] for name in names)) for record in records if record["pairs"])
    pairs, seconds = np.array(points, float).reshape(-1, 2).T
    return pairs, seconds


def chart(records: list[Record], path: Path) -> None:
    """Time against blended pairs (lines: the sweep; open marks: the other scenes), and pairs per second and core."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot

    records = [r for r in records if r["pairs"] is not None]
    most = max((r["threads"] or 1 for r in records), default=1)
    drawn = [
        r for r in records if r["backend"] != "reference" and r["scene"] != "tiny" and r["threads"] in (most, None)
    ]
    present = [kernel for kernel in COLORS if any(kernels(r) == kernel for r in drawn)]
    figure, (times, rates) = pyplot.subplots(1, 2, figsize=(11, 4.4), width_ratios=(3, 2), layout="constrained")
    for kernel in present:
        own = [r for r in drawn if kernels(r) == kernel]
        lines, others = _sweep(own), [r for r in own if r not in _sweep(own)]
        for names, style, label in ((["forward_s"], "-", ""), (["forward_s", "backward_s"], "--", " + backward")):
            kernel_style = {"color": COLORS[kernel], "label": f"{kernel}, forward{label}"}
            if lines:
                times.loglog(*_points(lines, names), "o", linestyle=style, markersize=4, **kernel_style)
                kernel_style["label"] = None
            times.loglog(*_points(others, names), "s" if label else "o", markerfacecolor="none", **kernel_style)
    if _sweep(drawn):
        times.plot([], [], "o", color="#777777", markerfacecolor="none", label="other scenes")
        pairs, seconds = _points(_sweep(drawn), ["forward_s"])
        times.loglog(pairs, 0.5 * seconds.min() * pairs / pairs[0], color="#bbbbbb", label="proportional to pairs")
    threads = f"{most} thread{'s' if most > 1 else ''}"
    times.set(xlabel="blended (Gaussian, pixel) pairs", ylabel="seconds", title=f"Time against work, {threads}")
    times.grid(True, which="major", alpha=0.3)
    times.legend(fontsize=8)

    scene = _busiest(drawn)
    bars = [r for r in drawn if r["scene"] == scene and kernels(r) in present]
    bars.sort(key=lambda record: present.index(kernels(record)))
    at = np.arange(len(bars))
    for shift, name, shade in ((-0.2, "forward", 1.0), (0.2, "backward", 0.55)):
        heights = [r[f"{name}_gpairs_per_core"] for r in bars]
        rates.bar(at + shift, heights, 0.38, color=[COLORS[kernels(r)] for r in bars], alpha=shade)
        for x, record, height in zip(at + shift, bars, heights, strict=True):
            share = record[f"{name}_share"]
            text = f"{name}\n{height:.2f}" + ("" if share is None else f"\n{100 * share:.0f} %")
            rates.annotate(text, (x, height), ha="center", va="bottom", fontsize=7)
    rates.set_xticks(at, [kernels(r) for r in bars])
    if any(r["threads"] is None for r in bars):
        rates.set_yscale("log")
    rates.set(ylabel="G pairs / s / core (GPU: whole)", title=f"Rate and share of the peak, {scene}, {threads}")
    rates.margins(y=0.25)
    figure.savefig(path, dpi=150)
    pyplot.close(figure)


def _busiest(records: list[Record]) -> str:
    """The scene of most pairs, the sweep's only where there is no other."""
    others = [record for record in records if record not in _sweep(records)]
    return max(others or records, key=lambda record: record["pairs"])["scene"] if records else ""
