"""Model no more than a scene needs: with ``capacity="auto"`` a training prunes and freezes at milestones.

A few training images are not learned from for a while: they are for validation. Each milestone measures what every
Gaussian adds to images and how much of its motion can be seen, and takes as much as the validation images allow:
Gaussians while steps can make up for them, motion mostly at the end.
"""

import torch

from ...scene.compression_report import StepKind
from ..optimize.training import Training
from .context import Compression
from .passes import freeze_motion, is_static_capture, prune, prune_unmissed


class CompressionFailed(Exception):
    """A milestone ended in an ``error``: the state that it left is of no use."""

    def __init__(self, error: Exception) -> None:
        super().__init__(str(error))
        self.error = error


class CompressionSchedule(Compression):
    """The milestones of one training."""

    def begin(self, training: Training) -> None:
        """Makes everything static from the start where the images show no motion."""
        super().begin(training)
        gaussians = training.gaussians
        if is_static_capture(training.capture, training.store):
            gaussians.reindex(torch.arange(gaussians.count, device=gaussians.device), 0)
            self.add_step(StepKind.FREEZE, gaussians.count)

    def allows_growth(self, progress: float) -> bool:
        """Not once Gaussians are pruned: new ones would have no time to learn, in places that were just cleared (the
        papers' recipes grow until the end)."""
        return progress < self.settings.prune_at

    def validation_at(self, progress: float) -> tuple[int, ...]:
        """The validation shots, for a while."""
        validates = self.settings.validate_from <= progress < self.settings.prune_at
        return self.validation if validates else ()

    def after_step(self, training: Training, before: float, now: float) -> None:
        """Runs the milestones that lie in (before, now]; CompressionFailed where one fails."""
        if self.allows_growth(now):
            self.motion = None  # of a training that was resumed for more steps: Gaussians come and go again
        for index, (at, run) in enumerate([(self.settings.prune_at, self._prune), (1.0, self._finish)], start=1):
            if before < at <= now:
                training.before_milestone()
                try:
                    run(self.generator(index))
                except Exception as error:
                    raise CompressionFailed(error) from error
                finally:
                    self.mean_state = {}

    def _prune(self, generator: torch.Generator) -> None:
        settings, evaluator = self.settings, self.evaluator()
        budget = self.training.recipe.kept_gaussians
        views = self.sample_views(generator, settings.num_budget_views if budget else None)
        measured = self.measure(views, generator)
        self.motion, self.mean_state = measured.motion, measured.state
        self.compress(evaluator, prune(self, evaluator, measured))
        if self._freezes_before_the_end:
            self.compress(evaluator, freeze_motion(self, evaluator, settings.max_freeze_loss))

    def _finish(self, generator: torch.Generator) -> None:
        views, evaluator = self.sample_views(generator), self.evaluator()
        measured = self.measure(views, generator)
        self.motion = self.motion or measured.motion
        self.compress(evaluator, prune_unmissed(self, evaluator, measured))
        if self.num_dynamic and not self._freezes_before_the_end:
            self.mean_state = self.mean_dynamic_state(views)
            self.compress(evaluator, freeze_motion(self, evaluator, self.settings.max_final_freeze_loss))

    @property
    def _freezes_before_the_end(self) -> bool:
        """Where some are static already; and where a share is forced, for which steps have to make up."""
        return self.num_dynamic < self.training.gaussians.count or self.training.recipe.dynamic_share > 0
