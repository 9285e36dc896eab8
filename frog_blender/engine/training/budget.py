"""How many Gaussians a file of a given size holds."""

from __future__ import annotations

from ..errors import FrogError
from ..packing import BITS
from .recipe import Recipe

_MOVING_SHARE = 0.35  # of the Gaussians, when none of them was put to rest that might have been
_REST_OF_FILE = 50_000  # bytes: header, network, temporal table


def gaussians_within(size: int, recipe: Recipe) -> int:
    """Gaussians that a packed file of ``size`` bytes surely does not exceed in number; FrogError when none fits."""
    still = 3 * (BITS["means"] + BITS["log_scales"]) + 4 * BITS["quaternions"] + BITS["opacity_logits"]
    still += 3 * (recipe.sh_degree + 1) ** 2 * BITS["sh"]
    of_each = (still + _MOVING_SHARE * recipe.embedding_size * BITS["embeddings"]) / 8
    count = int((size - _REST_OF_FILE) / of_each)
    if count < 1:
        least = _REST_OF_FILE + int(of_each) + 1
        raise FrogError(f"The budget of {size} bytes is too small: expected at least {least}.")
    return count
