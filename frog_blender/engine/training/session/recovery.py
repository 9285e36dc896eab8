"""Rollback of a training that diverges, with smaller steps, or that runs out of memory, with fewer Gaussians."""

import gc

import torch

from ...errors import FrogError, reason
from ...io.plain_values import JsonObject
from ..compression.schedule import CompressionFailed
from ..optimize.training import Hook, Training, TrainingDiverged
from .checkpoint import State, restore, state_of

_ATTEMPTS = 3
_SLOWER = 0.5
_KEPT_GAUSSIANS = 0.75  # of those there were when memory ran out


class Recovery(Hook):
    """The last good state of a training, in memory. As a hook it takes a snapshot before each milestone.

    Attributes:
        last_state: as ``restore`` takes it.

    Args:
        training: at its first step, or resumed.
        settings: of the job, see ``state_of``.
    """

    def __init__(self, training: Training, settings: JsonObject | None = None) -> None:
        self._training, self._left, self._settings = training, _ATTEMPTS, settings
        self.snapshot()

    def snapshot(self) -> None:
        """Call it now and then, and before a state is written. Raises TrainingDiverged for a non-finite state."""
        self._training.check()
        self.last_state: State = state_of(self._training, self._settings)

    def before_milestone(self) -> None:
        """See Hook."""
        self.snapshot()

    def rollback(self, error: Exception) -> str:
        """Restores the snapshot, lowers the step size or the limit of Gaussians, and says so.

        Raises ``error`` where neither helps, and after several times; a FrogError where memory stays short.
        """
        short = is_out_of_memory(error)
        if not (short or isinstance(error, TrainingDiverged)):
            raise error
        if not self._left:
            raise FrogError("Not enough memory for this training: try a smaller scale.") if short else error
        self._left -= 1
        count = self._training.count
        error.__traceback__ = None  # it holds on to what the step had allocated
        restore(self._training, self.last_state)
        return self._with_fewer(count) if short else self._with_smaller_steps(error)

    def without_milestone(self, failed: CompressionFailed) -> str:
        """Restores the snapshot from before a milestone that failed, and says so. Where memory ran out in the middle of
        a training, see ``rollback``: its steps will need as much."""
        error = failed.error
        if is_out_of_memory(error) and self._training.progress < 1:
            return self.rollback(error)
        error.__traceback__ = failed.__traceback__ = None
        restore(self._training, self.last_state)
        gc.collect()
        return f"Compression at {100 * self._training.progress:.0f} % failed ({reason(error)}). Continuing without it."

    def _with_smaller_steps(self, error: Exception) -> str:
        self._training.gaussians.optimizer.rate_factor *= _SLOWER
        self.last_state = state_of(self._training, self._settings)
        return f"{error} Continuing from step {self._training.step_count:,} with steps of half the size."

    def _with_fewer(self, count: int) -> str:
        """After running out of memory with ``count`` Gaussians: keeps the most opaque ones and lowers the limit."""
        limit = max(1, int(_KEPT_GAUSSIANS * count))
        self._training.limit_gaussians(limit)
        gaussians = self._training.gaussians
        if gaussians.count > limit:
            gaussians.keep(gaussians.canonical.opacity_logits.detach().topk(limit).indices.sort().values)
        gc.collect()
        if gaussians.device.type == "cuda":
            torch.cuda.empty_cache()
        if self._settings is not None:
            self._settings["recipe"]["max_gaussians"] = limit
        self.last_state = state_of(self._training, self._settings)
        return (
            f"Out of memory at {count:,} Gaussians. "
            f"Continuing from step {self._training.step_count:,} with at most {limit:,}."
        )


def is_out_of_memory(error: BaseException) -> bool:
    """Python's, torch's of a GPU, or what torch says on the CPU and the driver elsewhere."""
    if isinstance(error, MemoryError | torch.OutOfMemoryError):
        return True
    said = str(error).lower()
    return isinstance(error, RuntimeError) and ("can't allocate memory" in said or "out of memory" in said)
