"""A training that comes to numbers that are none goes back to where all was well, and on with smaller steps."""

from __future__ import annotations

import torch

from .checkpoint import State, restore, state_of
from .running_loss import Unstable
from .trainer import Trainer

_ATTEMPTS = 3
_SLOWER = 0.5


class Recovery:
    """The last good state of a training, in memory.

    Args:
        trainer: at its first step, or resumed.
    """

    def __init__(self, trainer: Trainer) -> None:
        self._left = _ATTEMPTS
        self._state: State = state_of(trainer)

    def remember(self, trainer: Trainer) -> None:
        """Call it now and then. Unstable when the model itself is not finite: then there is nothing to remember."""
        trainer.check()
        for name, parameter in trainer.model.named_parameters():
            if not bool(torch.isfinite(parameter).all()):
                raise Unstable(f"Training became unstable at step {trainer.step_count} ({name} is not finite).")
        self._state = state_of(trainer)

    def go_back(self, trainer: Trainer, error: Unstable) -> str:
        """Restores the remembered state with smaller steps and says so; raises ``error`` after several times."""
        if not self._left:
            raise error
        self._left -= 1
        restore(trainer, self._state)
        trainer.optimizer.rate_factor *= _SLOWER
        self._state[1]["rate_factor"] = trainer.optimizer.rate_factor
        return f"{error} It goes on from step {trainer.step_count} with steps of half the size."
