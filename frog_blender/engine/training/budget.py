"""About how many Gaussians a file of a given size holds."""

from __future__ import annotations

from ..packing import BITS
from .recipe import Recipe

_MOVING_SHARE = 0.35  # of the Gaussians; what a training really puts to rest is known only at its end
_REST_OF_FILE = 50_000  # bytes of header, network and temporal table, in the usual recipes


def gaussians_within(size: int, recipe: Recipe) -> int:
    """Gaussians of a packed file of about ``size`` bytes, for a training to grow to; what is too much in the end is
    left out then (``Parsimony.fit``)."""
    still = 3 * (BITS["means"] + BITS["log_scales"]) + 4 * BITS["quaternions"] + BITS["opacity_logits"]
    still += 3 * (recipe.sh_degree + 1) ** 2 * BITS["sh"]
    of_each = (still + _MOVING_SHARE * recipe.embedding_size * BITS["embeddings"]) / 8
    return max(100, int((size - _REST_OF_FILE) / of_each))
