"""What happens besides a training's steps: hooks, and what they see of the training."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ...capture.capture import Capture
from ...frames.store import FrameStore
from ...gaussians import TorchGaussians
from ...io.plain_values import JsonObject
from ...model.interface import ScheduleState
from ...recipes import Recipe
from .gaussian_state import GaussianState
from .stateful import Stateful, Tensors, Values


class Training(Stateful, Protocol):
    """A training as everything outside this room sees it; a ``Trainer`` is one.

    Attributes:
        hooks: in the order in which they are called.
        gaussians: everything that is kept by Gaussian.
        capture: with its cameras as they are known now.
    """

    hooks: list[Hook]

    @property
    def gaussians(self) -> GaussianState: ...
    @property
    def capture(self) -> Capture: ...
    @property
    def store(self) -> FrameStore: ...
    @property
    def recipe(self) -> Recipe: ...
    @property
    def step_count(self) -> int: ...
    @property
    def progress(self) -> float: ...
    @property
    def description(self) -> JsonObject:
        """What has to be the same for a checkpoint to be this training's, by name."""
        ...

    def schedule_state(self) -> ScheduleState:
        """The schedules inside the model as they stand."""
        ...

    def deform(self, time: float) -> tuple[TorchGaussians, Tensors]:
        """Gaussians and changes at a time in [0, 1], as training stands."""
        ...

    def render_image(self, shot_index: int) -> NDArray[np.float32]:
        """(H, W, 3) float32 what a shot looks like as training stands."""
        ...

    def limit_gaussians(self, count: int) -> None:
        """Allows no more than ``count`` Gaussians from now on; those that there are stay."""
        ...

    def check(self) -> None:
        """TrainingDiverged when the loss or a parameter is not finite."""
        ...

    def before_milestone(self) -> None:
        """A hook is about to change the model in a way that may fail."""
        ...


class Hook:
    """Something that a training does besides its steps; this one does nothing."""

    def begin(self, training: Training) -> None:
        """Called once, before the first step and before a checkpoint is loaded."""

    def after_step(self, training: Training, before: float, now: float) -> None:
        """Called after the step that led from the progress ``before`` to ``now``."""

    def before_milestone(self, training: Training) -> None:
        """Called before a hook changes the model in a way that may fail."""

    def allows_growth(self, progress: float) -> bool:
        """Whether Gaussians may be added at ``progress``."""
        return True

    def validation_at(self, progress: float) -> tuple[int, ...]:
        """Training shots that are for validation, and not to be learned from, at ``progress``."""
        return ()

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        return {}, {}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
