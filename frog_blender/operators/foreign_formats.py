"""What operators for other programs' formats have in common."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import bpy


def expose_usd() -> None:
    """Lets Blender's own USD library be imported as ``pxr``."""
    bpy.utils.expose_bundled_modules()


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
