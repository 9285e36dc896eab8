"""The processes of a training agree, before each step, that they are at the same place and go on."""

from __future__ import annotations

from .. import passive_threads  # noqa: F401

# isort: split
import hashlib
from contextlib import suppress

from ..optimize.peers import PeerLost
from ..optimize.trainer import Trainer
from .checkpoint import checkpoint_bytes, restore, state_in, state_of

_COMPARED_EVERY = 100  # steps between two comparisons of all parameters
_GOES_ON, _STOPS, _WENT_BACK, _ENDED = range(4)


class RollCall:
    """What a process tells its peers, and hears from them. Every process calls the same number of times.

    Where one went back to an earlier state, or its training is not as the first one's, all take over that of the first.

    Args:
        trainer: this process's.
    """

    def __init__(self, trainer: Trainer) -> None:
        self._trainer, self._peers = trainer, trainer.peers
        self._went_back, self._stopped = False, False
        self.ended = False

    def went_back(self) -> None:
        """The training was restored to an earlier state."""
        self._went_back = True

    def goes_on(self, wanted: bool) -> bool:
        """Whether all want to go on, this one among them."""
        if self._peers.size == 1:
            return wanted
        self._call(_WENT_BACK if self._went_back else _GOES_ON if wanted else _STOPS)
        return not self._stopped and not self.ended

    def end(self) -> None:
        """The first process has written everything: the others may end, and nothing is lost where one has."""
        if self._peers.size > 1:
            with suppress(PeerLost):
                self._call(_ENDED)

    def _call(self, word: int) -> None:
        trainer = self._trainer
        step, digest = trainer.step_count, 0
        if step % _COMPARED_EVERY == 0:
            digest = _digest(trainer)
        rows = self._peers.gather([word, step, trainer.count, digest])
        self._went_back, self.ended = False, rows[0][0] == _ENDED
        self._stopped = any(row[0] == _STOPS for row in rows)
        if not self.ended and any(row[0] == _WENT_BACK or row[1:] != rows[0][1:] for row in rows):
            is_first = self._peers.rank == 0
            content = self._peers.from_first(checkpoint_bytes(state_of(trainer)) if is_first else b"")
            if not is_first:
                restore(trainer, state_in(content))


def _digest(trainer: Trainer) -> int:
    """Of all parameters, 63 bits."""
    found = hashlib.blake2b(digest_size=8)
    for parameter in trainer.model.state_dict().values():
        found.update(parameter.detach().cpu().contiguous().numpy().tobytes())
    return int.from_bytes(found.digest(), "little") >> 1
