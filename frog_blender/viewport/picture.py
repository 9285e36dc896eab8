"""What a viewport shows, its last image, and how finely that is drawn while one moves."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ..timeline.playback_cache import SceneTime
from .hiding import Surfaces
from .order import Order

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


@dataclass(frozen=True, eq=False)
class Shown:
    """What a viewport shows of a capture, and where."""

    time: SceneTime
    matrix: np.ndarray


@dataclass(eq=False)
class Picture:
    """The last image of one viewport.

    Attributes:
        key: what determined it.
        order: of the splats in it, and ``order_texture`` on the graphics card.
        step: pixels a side that one of its pixels stands for.
        is_final: nothing about it can become better.
        looked_at: what determined which captures it shows, and ``shown``, these.
        canvas: on the graphics card.
        depth: of what the viewport has drawn that hides splats, None for nothing, and when it was looked at.
        surfaces: that hide splats where the viewport draws no depth.
    """

    pace: Pace = field(default_factory=Pace)
    key: Any = None
    order: Order | None = None
    order_texture: Any = None
    step: int = 1
    is_final: bool = False
    canvas: Any = None
    depth: np.ndarray | None = None
    checked_at: float = 0.0
    surfaces: Surfaces = field(default_factory=Surfaces)
    looked_at: Any = None
    shown: list[Shown] = field(default_factory=list)
