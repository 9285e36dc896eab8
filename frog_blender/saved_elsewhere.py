"""Paths that begin with ``//``, at the .blend's folder, when it is saved into another one: they go on meaning the same.

Blender does so with its own paths, but not with those that add-ons keep.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent

_OF_OBJECTS = ("filepath", "bake_folder")
_OF_SCENES = ("capture_folder", "output_path", "derived_output")

moving = False
"""While paths are written that lead nowhere yet: nobody is to follow them."""

_target: Path | None = None  # the folder that is saved into, if it is another one
_before: list[tuple[Any, int, str, str]] = []  # blocks, session_uid, property, value


def _relative() -> Iterator[tuple[Any, Any, str, str]]:
    """Blocks, block, property and value of all such paths of this .blend."""
    for blocks, names in ((bpy.data.objects, _OF_OBJECTS), (bpy.data.scenes, _OF_SCENES)):
        for block in blocks:
            for name in names if block.library is None else ():
                value = getattr(block.frog, name)
                if value.startswith("//"):
                    yield blocks, block, name, value


def _write(block: Any, name: str, value: str) -> None:
    global moving
    moving = True
    try:
        setattr(block.frog, name, value)
    finally:
        moving = False


def seen_from(folder: Path, path: str) -> str:
    """An absolute path as a .blend in ``folder`` keeps it, which begins with ``//`` unless it is on another drive."""
    try:
        return str(bpy.path.relpath(path, start=str(folder)))
    except ValueError:
        return path


@persistent
def on_save_pre(path: str = "", *_: Any) -> None:
    """Rewrites the paths, where the .blend goes into another folder."""
    global _target
    _target, here, there = None, bpy.data.filepath, Path(path).parent
    _before.clear()
    if not path or not here or Path(here).parent == there:
        return
    _target = there
    for blocks, block, name, value in list(_relative()):
        _before.append((blocks, block.session_uid, name, value))
        _write(block, name, seen_from(there, bpy.path.abspath(value)))


@persistent
def on_save_post(*_: Any) -> None:
    """Of a copy, or where nothing could be saved, the open .blend stays where it was: so do its paths."""
    if _target is not None and Path(bpy.data.filepath).parent != _target:
        for blocks, uid, name, value in _before:
            block = next((block for block in blocks if block.session_uid == uid), None)
            if block is not None:
                _write(block, name, value)
    _before.clear()
