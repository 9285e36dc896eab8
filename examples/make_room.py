"""Renders the demo capture `room`: 12 synchronized videos of an inflatable frog, a banner and a ball in a room.

    python examples/make_room.py OUT [--samples 16] [--preview] [--keep-pictures] [--fly]

What it needs and how it works stands in capture_videos.py; the cameras are in capture_rig.py, the scene in
room_scene.py, what moves in room_motion.py, the textures in textures.py.
"""

from __future__ import annotations

from capture_rig import Rig
from capture_videos import make
from room_scene import Room

if __name__ == "__main__":
    make(__doc__.splitlines()[0], Rig(320, 240, 300.0), Room, preview=[3, 18])
