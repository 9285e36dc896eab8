"""How the outputs of a deformation network are laid out: one place for training, playback and the native library.

The C++ side has the same offsets in ``native/src/deformation/types.h``.
"""

from __future__ import annotations

_FIXED = {"means": 3, "log_scales": 3, "quaternions": 4, "opacity_logits": 1}


def output_sizes(deformed_sh: int) -> dict[str, int]:
    """Outputs by attribute, in their order.

    Args:
        deformed_sh: SH coefficients a channel that the network changes; 0 leaves ``sh`` out.
    """
    return _FIXED | ({"sh": 3 * deformed_sh} if deformed_sh else {})


def num_outputs(deformed_sh: int) -> int:
    """Numbers that a network gives for each Gaussian."""
    return sum(output_sizes(deformed_sh).values())


def num_heads(deformed_sh: int) -> int:
    """Attributes that a network changes."""
    return len(output_sizes(deformed_sh))


def column_outputs(deformed_sh: int) -> dict[str, slice]:
    """The outputs that reach each column of a frame (see playback.frame_delta)."""
    base = 11
    columns = {"means": slice(0, 3), "scales": slice(3, 6), "quaternions": slice(6, 10), "base": slice(10, base + 3)}
    return columns | {f"sh_{k}": slice(base + 3 * k, base + 3 * k + 3) for k in range(1, deformed_sh)}
