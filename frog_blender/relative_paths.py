"""Rewrites FRoG's paths when a .blend is saved: they become relative at the first save, if the user prefers that, and
relative paths stay valid when the .blend is saved to another folder.

Blender does this for its own paths, but not for those of add-ons. The path of a scene file is kept in a data-block of
Blender's (see capture_files); this module handles all others, and captures without such a data-block.
"""

import os
from collections.abc import Iterator
from contextlib import contextmanager
from functools import reduce
from pathlib import Path
from typing import Any

import bpy

from . import addon_state

_OBJECT_PATHS = ("filepath",)
_SCENE_PATHS = ("capture_folder", "output_path", "derived_output", "rig.folder")


class Rewriting:
    """A save in progress that rewrites paths.

    Attributes:
        is_writing: while settings are written that nothing is to follow yet.
        target: the folder that is saved into, if it is another one.
        before: blocks, session_uid, property and value before it was rewritten.
    """

    def __init__(self) -> None:
        self.is_writing = False
        self.target: Path | None = None
        self.before: list[tuple[Any, int, str, str]] = []


def are_being_written() -> bool:
    """Whether settings are being written that nothing is to follow yet."""
    return addon_state.get(Rewriting).is_writing


@contextmanager
def being_written() -> Iterator[None]:
    """Around changes that nothing is to follow yet: of paths that must not be opened, of several edits at once."""
    rewriting = addon_state.get(Rewriting)
    before, rewriting.is_writing = rewriting.is_writing, True
    try:
        yield
    finally:
        rewriting.is_writing = before


def library_of(block: bpy.types.ID) -> bpy.types.Library | None:
    """The library whose folder a data-block's paths are relative to; None for this .blend. An override has the paths
    of its reference.
    """
    override = block.override_library
    return block.library if override is None or override.reference is None else override.reference.library


def absolute(block: bpy.types.ID, path: str) -> Path:
    """The absolute path of a data-block's path. Data that was linked and made local still has its library's path."""
    library = library_of(block)
    file = Path(os.path.normpath(bpy.path.abspath(path, library=library)))
    if library is None and path.startswith("//") and not file.exists():
        beside = (os.path.normpath(bpy.path.abspath(path, library=library)) for library in bpy.data.libraries)
        return next(filter(Path.exists, map(Path, beside)), file)
    return file


def _settle() -> None:
    """Rewrites the paths of objects that were made local. Output paths of scenes are left alone, as they need not
    exist.
    """
    for obj in bpy.data.objects:
        for name, value in _set_of(obj, _OBJECT_PATHS) if library_of(obj) is None else ():
            source = obj.frog.source
            path = str(absolute(source or obj, value))
            if path != os.path.normpath(bpy.path.abspath(value)) or (source is not None and source.library is not None):
                _write(obj, name, _seen_from_here(path))


def _kept() -> Iterator[tuple[Any, Any, str, str]]:
    """Collection, data-block, property and value of all paths in this .blend that Blender does not manage."""
    for blocks, names in ((bpy.data.objects, _OBJECT_PATHS), (bpy.data.scenes, _SCENE_PATHS)):
        for block in blocks:
            if library_of(block) is None:
                values = _set_of(block, names)
                yield from ((blocks, block, name, value) for name, value in values if not _is_blenders(block, name))


def _is_blenders(block: bpy.types.ID, name: str) -> bool:
    return name == "filepath" and block.frog.source is not None


def _set_of(block: bpy.types.ID, names: tuple[str, ...]) -> list[tuple[str, str]]:
    owners = [(name, *_owner_of(block, name)) for name in names]
    values = [(name, getattr(owner, own)) for name, owner, own in owners if owner.is_property_set(own)]
    return [(name, value) for name, value in values if value]


def _owner_of(block: bpy.types.ID, name: str) -> tuple[Any, str]:
    """What of a data-block's settings has a property, and the property's own name."""
    *groups, own = name.split(".")
    return reduce(getattr, groups, block.frog), own


def _write(block: bpy.types.ID, name: str, value: str) -> None:
    owner, own = _owner_of(block, name)
    with being_written():
        setattr(owner, own, value)


def seen_from(folder: Path, path: str) -> str:
    """An absolute path relative to a .blend in ``folder``, beginning with ``//``; unchanged if it is on another
    drive.
    """
    try:
        return str(bpy.path.relpath(path, start=str(folder)))
    except ValueError:
        return path


def _seen_from_here(path: str) -> str:
    """The same for the open .blend; unchanged while that was never saved."""
    return seen_from(Path(bpy.data.filepath).parent, path) if bpy.data.filepath else path


def on_save_pre(path: str = "", *_: Any) -> None:
    """Rewrites the paths if the .blend is saved to another folder or for the first time."""
    _settle()
    rewriting, here, there = addon_state.get(Rewriting), bpy.data.filepath, Path(path).parent
    rewriting.target = None
    rewriting.before.clear()
    if not path or (here and Path(here).parent == there):
        return
    rewriting.target = there
    becomes_relative = not here and bpy.context.preferences.filepaths.use_relative_paths
    for blocks, block, name, value in list(_kept()):
        is_relative = value.startswith("//")
        if is_relative if here else becomes_relative and os.path.isabs(value) and not is_relative:
            rewriting.before.append((blocks, block.session_uid, name, value))
            _write(block, name, seen_from(there, bpy.path.abspath(value)))


def on_save_post(*_: Any) -> None:
    """Restores the paths if the open .blend was not moved: a copy was saved, or saving failed."""
    rewriting = addon_state.get(Rewriting)
    if rewriting.target is not None and Path(bpy.data.filepath).parent != rewriting.target:
        for blocks, uid, name, value in rewriting.before:
            block = next((block for block in blocks if block.session_uid == uid), None)
            if block is not None:
                _write(block, name, value)
    rewriting.before.clear()


def on_import_post(context: bpy.types.Context, *_: Any) -> None:
    """Appended data has paths relative to its .blend; pasted data may have paths relative to this one."""
    for item in context.import_items:
        names = {"OBJECT": _OBJECT_PATHS, "SCENE": _SCENE_PATHS}.get(item.id_type)
        if not names or item.append_action not in {"MAKE_LOCAL", "COPY_LOCAL"} or item.source_library is None:
            continue
        for name, value in _set_of(item.id, names):
            if not value.startswith("//") or _is_blenders(item.id, name):
                continue
            path = bpy.path.abspath(value, library=item.source_library)
            if Path(path).exists() or not Path(bpy.path.abspath(value)).exists():
                _write(item.id, name, _seen_from_here(path))
