"""Renders a long capture, 7 videos of 300 frames: the room of `room`, its frog, banner and ball each at its own pace.

    python examples/make_long.py OUT [--samples 4] [--threads 0] [--preview] [--keep-pictures] [--fly]

What it needs and how it works stands in capture_videos.py. `frog stability --long OUT` takes shorter and faster videos
out of it.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from capture_rig import DIRECTIONS, Rig
from capture_videos import make
from room_scene import Room

_PACES = {"banner": 0.87, "ball": 1.21}  # loops of each while the frog does one: nothing is seen twice


class LongRoom(Room):
    def build(self) -> None:
        super().build()
        self.moving = [(thing, _paced(shape, _PACES.get(thing.name, 1.0))) for thing, shape in self.moving]


def _paced(shape: Callable[[float], np.ndarray], pace: float) -> Callable[[float], np.ndarray]:
    return lambda phase: shape(phase * pace)


if __name__ == "__main__":
    rig = Rig(160, 120, 150.0, directions=tuple(DIRECTIONS[index] for index in (0, 2, 3, 5, 8, 9, 11)))
    make(__doc__.splitlines()[0], rig, LongRoom, preview=[0, 100, 299], samples=4, length=300)
