"""What a training took out of its model, in words: for the command line, the panel and ``frog info``. No torch."""

from __future__ import annotations

from ..io.plain_values import JsonMapping


def summary(capacity: JsonMapping) -> str:
    """One line: what is left."""
    heads = ", ".join(capacity.get("heads", ())) or "none"
    return (
        f"{capacity['gaussians']:,} Gaussians, {capacity['dynamic']:,} of them move; "
        f"heads: {heads}; SH degree {capacity['sh_degree']}"
    )


def lines(capacity: JsonMapping) -> list[str]:
    """A line for each reduction: what it did, saved and cost."""
    return [reduction_line(reduction) for reduction in capacity.get("reductions", ())]


def reduction_line(reduction: JsonMapping) -> str:
    """``at 85 %, put to rest: 20,704 -> 5,927 moving Gaussians; saves 1.9 MB, 1.2 ms a frame; costs 0.005 dB``."""
    what = reduction["what"]
    unit = "heads" if what.startswith("head ") else _UNITS.get(what, "")
    counts = f"{reduction['before']:,} -> {reduction['after']:,} {unit}"
    parts = [f"at {100 * reduction['progress']:.0f} %, {what}: {counts}"]
    saved = []
    if reduction.get("bytes", 0) > 0:
        saved.append(f"{reduction['bytes'] / 1e6:.2f} MB")
    if reduction.get("milliseconds", 0.0) >= 0.05:
        saved.append(f"{reduction['milliseconds']:.1f} ms a frame")
    if saved:
        parts.append(f"saves {', '.join(saved)}")
    if reduction.get("loss") is not None:
        parts.append(f"costs {max(0.0, reduction['loss']):.3f} dB")
    return "; ".join(part.rstrip() for part in parts)


_UNITS = {
    "pruned": "Gaussians",
    "put to rest": "moving Gaussians",
    "woken": "moving Gaussians",
    "network width": "hidden units",
    "packed": "bytes",
    "only fade": "deformed Gaussians",
    "keep their shape": "Gaussians that turn and grow",
    "unseen left out": "Gaussians deformed a frame",
}
