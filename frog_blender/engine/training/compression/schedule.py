"""Model no more than a scene needs: with ``capacity="auto"`` a training prunes and freezes at milestones.

A few training images are not learned from for a while: they are for validation. Each milestone measures what every
Gaussian adds to images and how much of its motion can be seen, and takes as much as the validation images allow:
Gaussians while steps can make up for them, motion mostly at the end.
"""

from __future__ import annotations

import torch

from ...capture.capture import Capture
from ...recipes import Recipe
from ...registry import METHODS
from ...scene.compression_report import StepKind
from ..optimize.hooks import Hook, Training
from ..optimize.stateful import Tensors, Values
from .context import CompressionContext, CompressionRecord
from .passes import freeze_motion, freeze_static_regions, is_static_capture, prune, prune_unmissed
from .settings import DEFAULT, CompressionSettings, Milestone


class CompressionFailed(Exception):
    """A milestone ended in an error, which is its cause: the state that it left is of no use."""

    @property
    def error(self) -> Exception:
        """The cause."""
        assert isinstance(self.__cause__, Exception)
        return self.__cause__


class CompressionSchedule(Hook):
    """The milestones of one training.

    Args:
        capture: what is trained on.
        seed: the training's.
        settings: thresholds.

    Attributes:
        record: what was done.
        settings: the same.
    """

    def __init__(self, capture: Capture, seed: int, settings: CompressionSettings = DEFAULT) -> None:
        self.settings, self.record = settings, CompressionRecord(capture, seed, settings)

    def begin(self, training: Training) -> None:
        """Makes everything static from the start where the images show no motion."""
        gaussians = training.gaussians
        self._gaussians = gaussians
        gaussians.register(self.record)
        if is_static_capture(training.capture, training.store):
            gaussians.reindex(torch.arange(gaussians.count, device=gaussians.device), 0)
            self._context(training).add_step(StepKind.FREEZE, gaussians.count, 0)

    def allows_growth(self, progress: float) -> bool:
        """Not once Gaussians are pruned: new ones would have no time to learn, in places that were just cleared (the
        papers' recipes grow until 95 %)."""
        return progress < self.settings.prune_at

    def validation_at(self, progress: float) -> tuple[int, ...]:
        """The validation shots, for a while."""
        validates = self.settings.validate_from <= progress < self.settings.prune_at
        return self.record.validation if validates else ()

    def after_step(self, training: Training, before: float, now: float) -> None:
        """Runs the milestones that lie in (before, now]; CompressionFailed where one fails."""
        if self.allows_growth(now):
            self.record.motion = None  # of a training that was resumed for more steps: Gaussians come and go again
        for index, (at, milestone) in enumerate(self.settings.milestones.items()):
            if before < at <= now:
                training.before_milestone()
                try:
                    self._run(self._context(training), milestone, self.record.generator(index))
                except Exception as error:
                    raise CompressionFailed(milestone.name) from error
                finally:
                    self.record.mean_state = {}

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        return self.record.state()

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
        self.record.load_state(tensors, values, self._gaussians.num_dynamic, self._gaussians.device)

    def _context(self, training: Training) -> CompressionContext:
        return CompressionContext(training, self.record, self.settings)

    def _run(self, context: CompressionContext, milestone: Milestone, generator: torch.Generator) -> None:
        match milestone:
            case Milestone.FREEZE_STATIC_REGIONS:
                evaluator = context.evaluator()
                context.compress(evaluator, freeze_static_regions(context, evaluator, generator))
            case Milestone.PRUNE:
                self._prune(context, generator)
            case Milestone.FINISH:
                self._finish(context, generator)

    def _prune(self, context: CompressionContext, generator: torch.Generator) -> None:
        settings, evaluator = self.settings, context.evaluator()
        budget = context.training.recipe.kept_gaussians
        views = context.sample_views(generator, settings.num_budget_views if budget else None)
        measured = context.measure(views, generator)
        self.record.motion, self.record.mean_state = measured.motion, measured.state
        context.compress(evaluator, prune(context, evaluator, measured))
        if _freezes_before_the_end(context):
            context.compress(evaluator, freeze_motion(context, evaluator, settings.max_freeze_loss))

    def _finish(self, context: CompressionContext, generator: torch.Generator) -> None:
        views, evaluator = context.sample_views(generator), context.evaluator()
        measured = context.measure(views, generator)
        self.record.motion = self.record.motion or measured.motion
        context.compress(evaluator, prune_unmissed(context, evaluator, measured))
        if context.num_dynamic and not _freezes_before_the_end(context):
            self.record.mean_state = context.mean_dynamic_state(views)
            context.compress(evaluator, freeze_motion(context, evaluator, self.settings.max_final_freeze_loss))


def _freezes_before_the_end(context: CompressionContext) -> bool:
    """Where some are static already; and where a share is forced, for which steps have to make up."""
    return context.num_dynamic < context.training.gaussians.count or context.training.recipe.dynamic_share > 0


def compression_hooks(
    recipe: Recipe, method: str, capture: Capture, seed: int, settings: CompressionSettings = DEFAULT
) -> list[Hook]:
    """What a trainer of ``recipe`` needs: nothing, where the recipe as ``method`` adapts it has a fixed capacity."""
    adapted = METHODS[method].adapted(recipe)
    return [CompressionSchedule(capture, seed, settings)] if adapted.capacity == "auto" else []


def compression_of(training: Training) -> CompressionContext | None:
    """What compresses a training, if anything does."""
    for hook in training.hooks:
        if isinstance(hook, CompressionSchedule):
            return CompressionContext(training, hook.record, hook.settings)
    return None
