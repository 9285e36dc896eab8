"""Paths that begin with ``//``, at the .blend's folder, when that becomes another one: they go on meaning the same.

Blender does so with its own paths, but not with those that add-ons keep.
"""

from __future__ import annotations

import os
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


def library_of(block: Any) -> Any:
    """The .blend whose folder a data-block's paths begin at, where that is not this one: what is overridden here has
    the paths of what is linked."""
    override = block.override_library
    return block.library if override is None or override.reference is None else override.reference.library


def absolute(block: Any, path: str) -> Path:
    """What a data-block's path leads to. What was linked and made local still has its library's."""
    library = library_of(block)
    found = os.path.normpath(bpy.path.abspath(path, library=library))
    if library is None and path.startswith("//") and bpy.data.libraries and not Path(found).exists():
        beside = (os.path.normpath(bpy.path.abspath(path, library=each)) for each in bpy.data.libraries)
        found = next((each for each in beside if Path(each).exists()), found)
    return Path(found)


def _settle() -> None:
    """Writes the paths of objects that were made local; what a scene is to write need not be there yet."""
    for obj in bpy.data.objects:
        for name, value in _relative_of(obj, _OF_OBJECTS) if library_of(obj) is None else ():
            path = str(absolute(obj, value))
            if path != os.path.normpath(bpy.path.abspath(value)):
                _write(obj, name, _seen_from_here(path))


def _relative() -> Iterator[tuple[Any, Any, str, str]]:
    """Blocks, block, property and value of all such paths of this .blend."""
    for blocks, names in ((bpy.data.objects, _OF_OBJECTS), (bpy.data.scenes, _OF_SCENES)):
        for block in blocks:
            if library_of(block) is None:
                yield from ((blocks, block, name, value) for name, value in _relative_of(block, names))


def _relative_of(block: Any, names: tuple[str, ...]) -> list[tuple[str, str]]:
    values = [(name, getattr(block.frog, name)) for name in names]
    return [(name, value) for name, value in values if value.startswith("//")]


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


def _seen_from_here(path: str) -> str:
    """The same as the open .blend keeps it: as it is while that is in no folder."""
    return seen_from(Path(bpy.data.filepath).parent, path) if bpy.data.filepath else path


@persistent
def on_save_pre(path: str = "", *_: Any) -> None:
    """Rewrites the paths, where the .blend goes into another folder."""
    global _target
    _settle()
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


@persistent
def on_import_post(context: Any, *_: Any) -> None:
    """What was appended has its paths from the .blend where it was; what was pasted may have them from here."""
    for item in context.import_items:
        names = {"OBJECT": _OF_OBJECTS, "SCENE": _OF_SCENES}.get(item.id_type)
        if not names or item.append_action not in {"MAKE_LOCAL", "COPY_LOCAL"} or item.source_library is None:
            continue
        for name, value in _relative_of(item.id, names):
            path = bpy.path.abspath(value, library=item.source_library)
            if Path(path).exists() or not Path(bpy.path.abspath(value)).exists():
                _write(item.id, name, _seen_from_here(path))
