"""Renders the capture `dim`: 12 synchronized videos of a dark cellar in the light of one small lamp that swings.

    python examples/make_dim.py OUT [--samples 8] [--threads 0] [--preview] [--keep-pictures] [--fly]

What it needs and how it works stands in capture_videos.py; the scene is in dim_scene.py.
"""

from __future__ import annotations

from capture_rig import Rig
from capture_videos import make
from dim_scene import Cellar

if __name__ == "__main__":
    # Dark images take few bits: the videos keep their grey steps with a lower rate factor than the room's.
    make(__doc__.splitlines()[0], Rig(256, 192, 240.0), Cellar, preview=[0, 8, 20], samples=8, quality=6)
