"""Scenes within a budget of Gaussians or bytes: recipes that train them, and what is removed in the end."""

import math
from collections.abc import Callable
from dataclasses import replace

from ...errors import FrogError
from ...options import JobOptions
from ...recipes import Recipe
from ...registry import METHODS
from ...scene.compression_report import StepKind
from ...scene.quantization import BITS
from ..optimize.gaussian_state import mask_excluding
from .context import Compression

_DYNAMIC_SHARE = 0.35  # of the Gaussians; what a training really freezes is known only at its end
_BYTES_AT_LEAST = 60.0  # of a Gaussian in a file, more than it takes: the first guess
_LEAST_GROWN = 1000  # Gaussians, whatever the budget: too many are removed by what they add
_REST_OF_FILE = 50_000  # bytes of header, network and temporal table, in the usual recipes
_GENERATOR = 3  # after those of the milestones


def with_budget(recipe: Recipe, count: int, method: str) -> Recipe:
    """A recipe whose scenes have ``count`` Gaussians at most.

    With automatic capacity a training grows as it would without a budget, to twice as many at most, and prunes what
    adds least. That is better than never having had them (docs/experiments).
    """
    if METHODS[method].adapted(recipe).capacity != "auto":
        return replace(recipe, max_gaussians=count)
    return replace(recipe, kept_gaussians=count, max_gaussians=max(count, min(recipe.max_gaussians, 2 * count)))


def gaussians_within(size: int, recipe: Recipe) -> int:
    """Gaussians of a packed file of about ``size`` bytes, for a training to grow to; what is too much in the end is
    removed then (``fit_within``)."""
    static = 3 * (BITS["means"] + BITS["log_scales"]) + 4 * BITS["quaternions"] + BITS["opacity_logits"]
    static += 3 * (recipe.sh_degree + 1) ** 2 * BITS["sh"]
    of_each = (static + _DYNAMIC_SHARE * recipe.embedding_size * BITS["embeddings"]) / 8
    return max(_LEAST_GROWN, int((size - _REST_OF_FILE) / of_each))


def recipe_within(recipe: Recipe, options: JobOptions) -> Recipe:
    """A recipe whose scenes have ``max_gaussians`` of the options at most, and whose files about ``max_bytes``."""
    if options.max_gaussians:
        recipe = with_budget(recipe, options.max_gaussians, options.method)
    if options.max_bytes:
        recipe = replace(recipe, max_gaussians=min(recipe.max_gaussians, gaussians_within(options.max_bytes, recipe)))
    return recipe


def keep_within(context: Compression, most: int) -> None:
    """Removes what adds least until there are at most ``most`` Gaussians."""
    gaussians = context.training.gaussians
    _remove(context, lambda: gaussians.count - most)


def fit_within(context: Compression, size_of: Callable[[], int], most: int) -> None:
    """Removes what adds least until ``size_of()``, the bytes of the scene's file, is at most ``most``.

    FrogError when a file of a single Gaussian would be larger.
    """
    gaussians = context.training.gaussians
    before, sizes = gaussians.count, list[int]()

    def num_excess() -> int:
        sizes.append(size_of())
        saved, removed = sizes[0] - sizes[-1], before - gaussians.count
        of_each = max(1.0, saved / removed) if saved > 0 else _BYTES_AT_LEAST
        excess = math.ceil((sizes[-1] - most) / of_each)
        if excess > 0 and gaussians.count == 1:
            raise FrogError(
                f"The budget of {most} bytes is too small: a single Gaussian takes {sizes[-1]}. The training is kept: "
                "resume it with a larger budget."
            )
        return min(excess, (gaussians.count + 1) // 2)  # what many have in common is not saved by each of them

    _remove(context, num_excess, lambda: sizes[0] - sizes[-1])


def _remove(context: Compression, num_excess: Callable[[], int], saved: Callable[[], int] = lambda: 0) -> None:
    """Removes what all images together would miss least, until there are not ``num_excess()`` too many.

    Args:
        saved: bytes, in the end.
    """
    gaussians, settings = context.training.gaussians, context.settings
    generator = context.generator(_GENERATOR)
    before, excess = gaussians.count, num_excess()
    if excess <= 0:
        return
    psnr = context.evaluator().now
    while excess > 0:
        measured = context.measure(context.sample_views(generator, settings.num_budget_views), generator)
        removed = measured.energy.argsort()[:excess]
        if not len(removed):
            break
        gaussians.keep(mask_excluding(removed, gaussians.count).nonzero().squeeze(1))
        excess = num_excess()
    loss = psnr - context.evaluator().now
    context.add_step(StepKind.PRUNE, before, loss, saved(), is_forced=True)
