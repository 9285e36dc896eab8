"""Renders a capture in which nothing moves: the room of `room` at one time, with a camera's noise.

    python examples/make_still.py OUT [--samples 16] [--keep-pictures] [--fly]

What it needs and how it works stands in capture_videos.py. What a training makes of it shows whether it models motion
that is not there.
"""

from __future__ import annotations

from capture_rig import Rig
from capture_videos import make
from room_scene import Room

_TIME = 0.4  # of the room's video
_NOISE = 1.5  # standard deviation, of 255


class StillRoom(Room):
    def pose(self, time: float) -> None:
        super().pose(_TIME)


if __name__ == "__main__":
    make(__doc__.splitlines()[0], Rig(320, 240, 300.0), StillRoom, preview=[0], still_noise=_NOISE)
