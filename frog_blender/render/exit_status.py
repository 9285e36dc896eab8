"""The exit status of a Blender that was started to render frames: not 0 where an image has failed.

Blender ends with 0 whatever becomes of its images, so that a render farm would take a frame without its captures for a
result.
"""

from __future__ import annotations

import atexit
import os
import sys
from collections.abc import Sequence

import bpy

FAILED = 1
_RENDERING = {"-a", "--render-anim", "-f", "--render-frame"}


def note_failure() -> None:
    """Lets a Blender that renders what its command line asks for end with ``FAILED``; does nothing in another one."""
    if bpy.app.background and not bpy.app.module and is_render(sys.argv):
        atexit.unregister(_end)
        atexit.register(_end)  # at once would lose what Blender has still to write


def is_render(arguments: Sequence[str]) -> bool:
    """Whether Blender's command line asks for frames; what follows ``--`` is not Blender's."""
    own = arguments[: arguments.index("--")] if "--" in arguments else arguments
    return not _RENDERING.isdisjoint(own)


def _end() -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(FAILED)
