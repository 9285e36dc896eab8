"""What a viewport shows, and its last image."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from .hiding import Surfaces
from .pace import Pace

if TYPE_CHECKING:
    from ..timeline.playback_cache import SceneTime
    from .order import Order


@dataclass(eq=False)
class Shown:
    """A capture in a viewport: an object, what it shows, and where; ``uid`` is the object's, None for a source's."""

    name: str
    time: SceneTime
    matrix: np.ndarray
    uid: int | None = None


@dataclass(eq=False)
class Picture:
    """The last image of one viewport.

    Attributes:
        key: what determined it.
        order: of the splats in it, and ``order_texture`` on the graphics card.
        step: pixels a side that one of its pixels stands for.
        is_final: nothing about it can become better.
        looked_at: what determined which captures it shows, and ``shown``, these.
        too_many: objects whose splats have no room in it.
        canvas: on the graphics card, ``size`` pixels large.
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
    size: tuple[int, int] = (0, 0)
    depth: np.ndarray | None = None
    checked_at: float = 0.0
    surfaces: Surfaces = field(default_factory=Surfaces)
    looked_at: Any = None
    shown: list[Shown] = field(default_factory=list)
    too_many: frozenset[Hashable] = frozenset()
