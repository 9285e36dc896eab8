"""A training that comes to numbers that are none, or to the end of the memory, goes back to where all was well: on with
smaller steps, or with fewer Gaussians."""

from __future__ import annotations

import gc
from typing import Any

import torch

from ...errors import FrogError, reason
from ..compression.schedule import CompressionFailed
from ..optimize.gaussian_order import arrange
from ..optimize.running_loss import TrainingDiverged
from ..optimize.trainer import Trainer
from .checkpoint import State, restore, state_of

_ATTEMPTS = 3
_SLOWER = 0.5
_KEPT_GAUSSIANS = 0.75  # of those there were when the memory ended


class Recovery:
    """The last good state of a training, in memory.

    Attributes:
        state: as ``restore`` takes it.

    Args:
        trainer: at its first step, or resumed.
        settings: of the job, see ``state_of``.
    """

    def __init__(self, trainer: Trainer, settings: dict[str, Any] | None = None) -> None:
        self._left, self._settings = _ATTEMPTS, settings
        self.remember(trainer)

    def remember(self, trainer: Trainer) -> None:
        """Call it now and then, and before a state is written. Raises TrainingDiverged for a non-finite state."""
        trainer.check()
        self.state: State = state_of(trainer, self._settings)

    def rollback(self, trainer: Trainer, error: Exception) -> str:
        """Restores the remembered state, mends what went wrong and says so.

        Raises ``error`` where nothing can be mended, and after several times; a FrogError where the memory stays short.
        """
        short = is_out_of_memory(error)
        if not (short or isinstance(error, TrainingDiverged)):
            raise error
        if not self._left:
            raise FrogError("The memory stays too short for this training: try a smaller scale.") if short else error
        self._left -= 1
        count = trainer.count
        error.__traceback__ = None  # it holds on to what the step had allocated
        restore(trainer, self.state)
        return self._with_fewer(trainer, count) if short else self._with_smaller_steps(trainer, error)

    def without_round(self, trainer: Trainer, failed: CompressionFailed) -> str:
        """Restores what was remembered before a round that failed (``remember`` is its trainer's ``before_round``) and
        says so. Where the memory ended in the middle of a training, see ``rollback``: its steps will need as much."""
        error = failed.error
        if is_out_of_memory(error) and not trainer.finished:
            return self.rollback(trainer, error)
        error.__traceback__ = failed.__traceback__ = None
        restore(trainer, self.state)
        gc.collect()
        return (
            f"Leaving out what the scene does not need failed ({reason(error)}): "
            f"nothing was left out at {100 * trainer.progress:.0f} %."
        )

    def _with_smaller_steps(self, trainer: Trainer, error: Exception) -> str:
        trainer.optimizer.rate_factor *= _SLOWER
        self.state[1]["rate_factor"] = trainer.optimizer.rate_factor
        return f"{error} It goes on from step {trainer.step_count} with steps of half the size."

    def _with_fewer(self, trainer: Trainer, count: int) -> str:
        """The most opaque Gaussians stay, and no more than these may come: the memory ended at ``count``."""
        limit = max(1, int(_KEPT_GAUSSIANS * count))
        trainer.limit_gaussians(limit)
        if trainer.count > limit:
            canonical = trainer.model.canonical
            kept = canonical.opacity_logits.detach().topk(limit).indices.sort().values
            arrange(trainer, kept, kept[kept < canonical.num_dynamic])
        gc.collect()
        if trainer.device.type == "cuda":
            torch.cuda.empty_cache()
        if self._settings is not None:
            self._settings["recipe"]["max_gaussians"] = limit
        self.state = state_of(trainer, self._settings)
        return (
            f"The memory did not suffice for {count:,} Gaussians. "
            f"It goes on from step {trainer.step_count} with at most {limit:,}."
        )


def is_out_of_memory(error: BaseException) -> bool:
    """Python's, torch's of a GPU, or what torch says on the CPU and the driver elsewhere."""
    if isinstance(error, MemoryError | torch.OutOfMemoryError):
        return True
    said = str(error).lower()
    return isinstance(error, RuntimeError) and ("can't allocate memory" in said or "out of memory" in said)
