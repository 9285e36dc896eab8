"""Recipes for scenes of so many Gaussians, and about how many of them a file of a given size holds."""

from __future__ import annotations

from dataclasses import replace

from ..packing import BITS
from .methods import method_named
from .recipe import Recipe

_MOVING_SHARE = 0.35  # of the Gaussians; what a training really puts to rest is known only at its end
_REST_OF_FILE = 50_000  # bytes of header, network and temporal table, in the usual recipes


def with_budget(recipe: Recipe, count: int, method: str) -> Recipe:
    """A recipe whose scenes have ``count`` Gaussians at most.

    With automatic capacity a training grows as it would without a budget, to twice as many at most, and leaves out what
    adds least when it settles (``reductions.prune``). That is better than never having had them (docs/parsimony.md).
    """
    if method_named(method).adapt(recipe).capacity != "auto":
        return replace(recipe, max_gaussians=count)
    return replace(recipe, kept_gaussians=count, max_gaussians=max(count, min(recipe.max_gaussians, 2 * count)))


def gaussians_within(size: int, recipe: Recipe) -> int:
    """Gaussians of a packed file of about ``size`` bytes, for a training to grow to; what is too much in the end is
    left out then (``Parsimony.fit``)."""
    still = 3 * (BITS["means"] + BITS["log_scales"]) + 4 * BITS["quaternions"] + BITS["opacity_logits"]
    still += 3 * (recipe.sh_degree + 1) ** 2 * BITS["sh"]
    of_each = (still + _MOVING_SHARE * recipe.embedding_size * BITS["embeddings"]) / 8
    return max(100, int((size - _REST_OF_FILE) / of_each))
