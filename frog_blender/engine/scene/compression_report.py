"""What a training took out of its model, in words: for the command line, the panel and ``frog info``. No torch."""

from enum import StrEnum

from ..io.plain_values import JsonMapping, JsonObject, UnfitValue, finite_entries


class StepKind(StrEnum):
    """What a compression step does. Values are the names on disk."""

    PRUNE = "pruned"
    FREEZE = "frozen"
    PACK = "packed"


_SAID = {
    StepKind.PRUNE: ("prune", "Gaussians"),
    StepKind.FREEZE: ("freeze", "dynamic Gaussians"),
    StepKind.PACK: ("quantize", "bytes"),
}
"""By kind: what was done in a word or two, and what the numbers before and after count."""


def summary(capacity: JsonMapping) -> str:
    """One line: what is left."""
    gaussians, dynamic = capacity["gaussians"], capacity["dynamic"]
    return f"{gaussians:,} Gaussians, {dynamic:,} of them dynamic; SH degree {capacity['sh_degree']:d}"


def lines(capacity: JsonMapping) -> list[str]:
    """A line for each reduction: what it did, saved and cost."""
    return [reduction_line(reduction) for reduction in capacity.get("reductions", ())]


def readable_report(value: object) -> JsonObject:
    """What a file or another program says was taken out; UnfitValue for a report that nobody could read out."""
    capacity = finite_entries(value, "capacity")
    if capacity:
        try:
            summary(capacity)
            lines(capacity)
        except (KeyError, TypeError, ValueError, AttributeError, OverflowError) as error:
            raise UnfitValue(f"a capacity report that cannot be read out ({error!r})", "one of a training") from error
    return capacity


def reduction_line(reduction: JsonMapping) -> str:
    """``at 85 %, freeze: 20,704 -> 5,927 dynamic Gaussians; saves 1.9 MB; costs 0.005 dB``; ``costs 0.065 dB, which a
    limit forces`` where that is more than is allowed otherwise."""
    what = reduction["what"]
    label, unit = _SAID.get(what, (what, ""))
    counts = f"{reduction['before']:,} -> {reduction['after']:,} {unit}"
    parts = [f"at {100 * reduction['progress']:.0f} %, {label}: {counts}"]
    if reduction.get("bytes", 0) > 0:
        parts.append(f"saves {reduction['bytes'] / 1e6:.2f} MB")
    if reduction.get("loss") is not None:
        forced = ", which a limit forces" if reduction.get("is_forced") else ""
        parts.append(f"costs {max(0.0, reduction['loss']):.3f} dB{forced}")
    return "; ".join(part.rstrip() for part in parts)
