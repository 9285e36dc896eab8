"""Renders the capture `fast`: 12 synchronized videos of fast things in a plain hall, one of which appears halfway.

    python examples/make_fast.py OUT [--samples 8] [--threads 0] [--preview] [--keep-pictures] [--fly]

What it needs and how it works stands in capture_videos.py; the scene is in fast_scene.py.
"""

from __future__ import annotations

from capture_rig import Rig
from capture_videos import make
from fast_scene import Hall

if __name__ == "__main__":
    make(__doc__.splitlines()[0], Rig(256, 192, 240.0), Hall, preview=[2, 10, 15, 17, 26], samples=8)
