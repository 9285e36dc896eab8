"""What operators for other programs' formats have in common."""

from __future__ import annotations

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
