"""What a training took out of its model, in words: for the command line, the panel and ``frog info``. No torch."""

from __future__ import annotations

from enum import StrEnum

from ..io.plain_values import JsonMapping


class StepKind(StrEnum):
    """What a compression step does; the values are the names on disk."""

    PRUNE = "pruned"
    FREEZE = "put to rest"
    UNFREEZE = "woken"
    SH_DEGREE = "SH degree"
    NETWORK_WIDTH = "network width"
    # Heads of the network: of scenes and checkpoints of earlier versions alone.
    HEAD_MEANS = "head means"
    HEAD_LOG_SCALES = "head log_scales"
    HEAD_QUATERNIONS = "head quaternions"
    HEAD_OPACITIES = "head opacity_logits"
    HEAD_SH = "head sh"
    ONLY_FADE = "only fade"
    KEEP_SHAPE = "keep their shape"
    VISIBILITY = "unseen left out"
    PACK = "packed"

    @property
    def unit(self) -> str:
        """What the numbers before and after count; empty for a degree."""
        return _UNITS.get(self, "heads" if self.startswith("head ") else "")


_UNITS = {
    StepKind.PRUNE: "Gaussians",
    StepKind.FREEZE: "moving Gaussians",
    StepKind.UNFREEZE: "moving Gaussians",
    StepKind.NETWORK_WIDTH: "hidden units",
    StepKind.PACK: "bytes",
    StepKind.ONLY_FADE: "deformed Gaussians",
    StepKind.KEEP_SHAPE: "Gaussians that turn and grow",
    StepKind.VISIBILITY: "Gaussians deformed a frame",
}
_KNOWN = {kind.value: kind for kind in StepKind}


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
    unit = _KNOWN[what].unit if what in _KNOWN else ""  # a newer version's kind
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
