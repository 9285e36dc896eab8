"""What operators for other programs' formats have in common."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from importlib.util import find_spec

import bpy

from ..engine.errors import FrogError


def expose_usd() -> None:
    """Lets Blender's own USD library, if it has one, be imported as ``pxr``."""
    bpy.utils.expose_bundled_modules()


def require_usd() -> None:
    """As ``expose_usd``; FrogError where there is none, as in Blenders that Linux distributions build."""
    expose_usd()
    if find_spec("pxr") is None:
        raise FrogError("This Blender's Python has no USD library (pxr); Blender from blender.org has one.")


@contextmanager
def told_progress(context: bpy.types.Context) -> Iterator[Callable[[int, int], None]]:
    """Yields ``progress(done, of)``, which the cursor shows while Blender waits."""
    manager = context.window_manager
    manager.progress_begin(0, 1000)

    def tell(done: int, of: int) -> None:
        manager.progress_update(round(1000 * done / max(of, 1)))

    try:
        yield tell
    finally:
        manager.progress_end()
