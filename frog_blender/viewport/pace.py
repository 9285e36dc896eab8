"""How finely a viewport is drawn while one moves, and when it is to be drawn sharply again."""

from __future__ import annotations

from dataclasses import dataclass

STILL_AFTER = 0.2  # seconds without a change
_COARSEST = 4  # pixels a side that one stands for at most
_SLOW, _QUICK = 0.07, 0.025  # seconds from one image to the next
_PAUSE = 1.0  # seconds: longer ones are no movement


@dataclass
class Pace:
    """The pace of one viewport.

    Attributes:
        step: pixels a side that one stands for while things move.
        changed_at, drawn_at: seconds of the last change, and of the beginning of the last image.
        ended_at: when the last image was drawn, as far as the processor is concerned.
    """

    step: int = 1
    changed_at: float = -1e9
    drawn_at: float = -1e9
    ended_at: float = -1e9

    def changed(self, now: float) -> int:
        """The pixel size of an image of something new: coarser after slow ones, finer after quick ones."""
        since, self.drawn_at = now - self.drawn_at, now
        pause = now - max(self.changed_at, self.ended_at)
        is_moving = pause < max(_PAUSE, (self.ended_at - self.changed_at) / 2)  # after a slow one all is slow
        self.changed_at = now
        if is_moving and since > _SLOW:
            self.step = min(_COARSEST, self.step * 2)
        elif is_moving and since < _QUICK:
            self.step = max(1, self.step // 2)
        return self.step if is_moving else 1

    def is_still(self, now: float) -> bool:
        """Whether nothing has changed for a while."""
        return now - max(self.changed_at, self.ended_at) >= STILL_AFTER
