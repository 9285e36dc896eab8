"""FRoG's paths when a .blend is saved: relative from the first save on, where the user wants that, and meaning the same
when they begin with ``//``, at the .blend's folder, and that becomes another one.

Blender does so with its own paths, but not with those that add-ons keep. That of a scene file becomes one of Blender's
own (see capture_files); here are the others, and that of a capture which has none of Blender's yet.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy
from bpy.app.handlers import persistent

from . import addon_state

_OF_OBJECTS = ("filepath", "bake_folder")
_OF_SCENES = ("capture_folder", "output_path", "derived_output")


class Rewriting:
    """A save that rewrites paths.

    Attributes:
        is_writing: while paths are written that lead nowhere yet.
        target: the folder that is saved into, if it is another one.
        before: blocks, session_uid, property and value before it was rewritten.
    """

    def __init__(self) -> None:
        self.is_writing = False
        self.target: Path | None = None
        self.before: list[tuple[Any, int, str, str]] = []


def _rewriting() -> Rewriting:
    return addon_state.get(Rewriting)


def are_being_written() -> bool:
    """True while paths are written that lead nowhere yet: nobody is to follow them."""
    return _rewriting().is_writing


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
        for name, value in _set_of(obj, _OF_OBJECTS) if library_of(obj) is None else ():
            source = obj.frog.source if name == "filepath" else None
            path = str(absolute(source or obj, value))
            if path != os.path.normpath(bpy.path.abspath(value)) or (source is not None and source.library is not None):
                _write(obj, name, _seen_from_here(path))


def _kept() -> Iterator[tuple[Any, Any, str, str]]:
    """Blocks, block, property and value of all paths of this .blend that Blender does not look after."""
    for blocks, names in ((bpy.data.objects, _OF_OBJECTS), (bpy.data.scenes, _OF_SCENES)):
        for block in blocks:
            if library_of(block) is None:
                values = _set_of(block, names)
                yield from ((blocks, block, name, value) for name, value in values if not _is_blenders(block, name))


def _is_blenders(block: Any, name: str) -> bool:
    return name == "filepath" and block.frog.source is not None


def _set_of(block: Any, names: tuple[str, ...]) -> list[tuple[str, str]]:
    values = [(name, getattr(block.frog, name)) for name in names if block.frog.is_property_set(name)]
    return [(name, value) for name, value in values if value]


def _write(block: Any, name: str, value: str) -> None:
    rewriting = _rewriting()
    rewriting.is_writing = True
    try:
        setattr(block.frog, name, value)
    finally:
        rewriting.is_writing = False


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
    """Rewrites the paths, where the .blend goes into another folder or into its first one."""
    _settle()
    rewriting, here, there = _rewriting(), bpy.data.filepath, Path(path).parent
    rewriting.target = None
    rewriting.before.clear()
    if not path or (here and Path(here).parent == there):
        return
    rewriting.target = there
    becomes_relative = not here and bpy.context.preferences.filepaths.use_relative_paths
    for blocks, block, name, value in list(_kept()):
        is_relative = value.startswith("//")
        if here and is_relative:
            _rewrite(blocks, block, name, value, seen_from(there, bpy.path.abspath(value)))
        elif becomes_relative and os.path.isabs(value) and not is_relative:
            _rewrite(blocks, block, name, value, seen_from(there, value))


def _rewrite(blocks: Any, block: Any, name: str, before: str, value: str) -> None:
    _rewriting().before.append((blocks, block.session_uid, name, before))
    _write(block, name, value)


@persistent
def on_save_post(*_: Any) -> None:
    """Of a copy, or where nothing could be saved, the open .blend stays where it was: so do its paths."""
    rewriting = _rewriting()
    if rewriting.target is not None and Path(bpy.data.filepath).parent != rewriting.target:
        for blocks, uid, name, value in rewriting.before:
            block = next((block for block in blocks if block.session_uid == uid), None)
            if block is not None:
                _write(block, name, value)
    rewriting.before.clear()


@persistent
def on_import_post(context: Any, *_: Any) -> None:
    """What was appended has its paths from the .blend where it was; what was pasted may have them from here."""
    for item in context.import_items:
        names = {"OBJECT": _OF_OBJECTS, "SCENE": _OF_SCENES}.get(item.id_type)
        if not names or item.append_action not in {"MAKE_LOCAL", "COPY_LOCAL"} or item.source_library is None:
            continue
        for name, value in _set_of(item.id, names):
            if not value.startswith("//") or _is_blenders(item.id, name):
                continue
            path = bpy.path.abspath(value, library=item.source_library)
            if Path(path).exists() or not Path(bpy.path.abspath(value)).exists():
                _write(item.id, name, _seen_from_here(path))
