"""What a training took out of its model, in words: for the command line, the panel and ``frog info``. No torch."""

from __future__ import annotations

from typing import Any


def summary(capacity: dict[str, Any]) -> str:
    """One line: what is left."""
    heads = ", ".join(capacity.get("heads", ())) or "none"
    return (
        f"{capacity['gaussians']:,} Gaussians, {capacity['dynamic']:,} of them move; "
        f"heads: {heads}; SH degree {capacity['sh_degree']}"
    )


def lines(capacity: dict[str, Any]) -> list[str]:
    """A line for each reduction: what it did, saved and cost."""
    return [reduction_line(reduction) for reduction in capacity.get("reductions", ())]


def reduction_line(reduction: dict[str, Any]) -> str:
    """``at 45 %, put to rest: 20,704 -> 5,927 moving Gaussians; saves 1.9 MB, 1.2 ms a frame; 0.005 dB``."""
    unit = _UNITS.get(reduction["what"], "")
    text = f"at {100 * reduction['progress']:.0f} %, {reduction['what']}: {reduction['before']:,} -> "
    text += f"{reduction['after']:,} {unit}".rstrip()
    saved = []
    if reduction.get("bytes", 0) > 0:
        saved.append(f"{reduction['bytes'] / 1e6:.2f} MB")
    if reduction.get("milliseconds", 0.0) >= 0.05:
        saved.append(f"{reduction['milliseconds']:.1f} ms a frame")
    if saved:
        text += f"; saves {', '.join(saved)}"
    return f"{text}; costs {max(0.0, reduction['loss']):.3f} dB"


_UNITS = {
    "pruned": "Gaussians",
    "put to rest": "moving Gaussians",
    "woken": "moving Gaussians",
    "head removed": "heads",
    "packed": "bytes",
}
