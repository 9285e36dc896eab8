"""The .frog file of a capture as a data-block of Blender's own, so that Blender looks after it as after its own files.

Blender lets no add-on tell it of a file. But it makes the paths of its volumes relative and absolute, rewrites them
where a .blend is saved elsewhere, appended or made local, reports and finds missing ones, and packs and unpacks them,
without asking what they hold. So a capture names its file by a volume that nobody draws (``Object.frog.source``), and
``Object.frog.filepath`` reads and writes that volume's path. A capture from before has its path alone, until the .blend
is opened or saved.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

import bpy

from . import addon_state, point_cloud, relative_paths

_LONGEST_PATH = 1023  # bytes that a volume's path holds


class UnpackedFiles:
    """Copies of what is packed into the .blend.

    Attributes:
        paths: by a volume's session_uid, and the place and size of what it packs.
        folder: where they lie, once there are any.
        lock: of both; a render looks for files in its own thread.
    """

    def __init__(self) -> None:
        self.paths: dict[tuple[int, int, int], Path] = {}
        self.folder: tempfile.TemporaryDirectory[str] | None = None
        self.lock = threading.Lock()


def is_capture(obj: Any) -> bool:
    """Whether an object plays a .frog file."""
    if obj.type not in point_cloud.TYPES:
        return False
    settings = obj.frog
    return bool(settings.is_property_set("filepath") and settings.filepath)  # the first is fast, and false for most


def shown_path(settings: Any, stored: str) -> str:
    """What ``Object.frog.filepath`` reads, of a string that was stored there."""
    source = settings.source
    return stored if source is None else source.filepath


def point_at(settings: Any, path: str) -> None:
    """Makes ``path``, which may be relative, that of the capture's volume: its own one, if others share what it has."""
    source = settings.source
    if len(os.fsencode(path)) > _LONGEST_PATH:
        settings.source = None
        return
    is_local = source is not None and source.library is None and source.override_library is None
    if is_local and source.filepath == path:
        return
    if not is_local or source.users > 1 or source.packed_file is not None:
        source = settings.source = bpy.data.volumes.new("") if path else None
    if source is not None:
        source.name = bpy.path.basename(path) or source.name
        source.filepath = path


def adopt() -> None:
    """Gives the captures of this .blend that have a path alone a volume for it."""
    for obj in bpy.data.objects:
        if is_capture(obj) and obj.frog.source is None and relative_paths.library_of(obj) is None:
            point_at(obj.frog, obj.frog.filepath)


def named_file(obj: Any) -> Path:
    """The file that an object names, which need not be there where its content is packed into the .blend."""
    return relative_paths.absolute(obj.frog.source or obj, obj.frog.filepath)


def file_of(obj: Any) -> Path:
    """The .frog file that an object plays: the one that it names, or a copy of what is packed into the .blend."""
    source = obj.frog.source
    if source is None or source.packed_file is None:
        return named_file(obj)
    return _copy_of_packed(source) or named_file(obj)


def packed_bytes(obj: Any) -> int:
    """How much of a .blend a capture's packed file takes; 0 where it is not packed."""
    source = obj.frog.source
    return source.packed_file.size if source is not None and source.packed_file is not None else 0


def _copy_of_packed(source: Any) -> Path | None:
    """A file with what a volume has packed, written once for each content; None where it cannot be written."""
    packed = source.packed_file
    key = source.session_uid, packed.as_pointer(), packed.size
    unpacked = addon_state.get(UnpackedFiles)
    with unpacked.lock:
        known = unpacked.paths.get(key)
        if known is not None and known.is_file():
            return known
        content = packed.data
        try:
            if unpacked.folder is None:
                unpacked.folder = tempfile.TemporaryDirectory(prefix="frog-packed-", ignore_cleanup_errors=True)
            stem = bpy.path.clean_name(Path(bpy.path.basename(source.filepath)).stem) or "scene"
            path = (
                Path(unpacked.folder.name) / hashlib.blake2b(content, digest_size=8).hexdigest() / f"{stem[:60]}.frog"
            )
            if not path.is_file():
                _write(path, content)
        except OSError as error:
            reason = error.strerror or error
            print(f"FRoG: {source.name}: its packed file could not be unpacked ({reason}).", file=sys.stderr)
            return None
        unpacked.paths[key] = path
        return path


def _write(path: Path, content: bytes) -> None:
    """All of it or nothing."""
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_suffix(".part")
    unfinished.write_bytes(content)
    unfinished.replace(path)


def forget() -> None:
    """Deletes the copies of packed files."""
    unpacked = addon_state.get(UnpackedFiles)
    with unpacked.lock:
        unpacked.paths.clear()
        if unpacked.folder is not None:
            unpacked.folder.cleanup()
        unpacked.folder = None
