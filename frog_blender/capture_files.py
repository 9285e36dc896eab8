"""Keeps the path of a capture's .frog file in a data-block that Blender manages like its own files.

Add-ons cannot register files with Blender. But Blender makes the paths of volumes relative and absolute, rewrites them
when a .blend is saved elsewhere, appended or made local, reports and finds missing ones, and packs and unpacks them,
whatever they contain. So a capture refers to its file by a volume that is never drawn (``Object.frog.source``), and
``Object.frog.filepath`` reads and writes that volume's path. A capture whose path is too
long for a volume has none.
"""

import hashlib
import os
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any

import bpy

from . import addon_state, point_cloud, relative_paths
from .engine.errors import FrogError
from .engine.io.atomic_files import write_atomically

_LONGEST_PATH = 1023  # bytes that a volume's path holds


class UnpackedFiles:
    """Temporary copies of files that are packed into the .blend.

    Attributes:
        paths: by a volume's session_uid, and the place and size of what it packs.
        folder: where they lie, once there are any.
        lock: of both; a render looks for files in its own thread.
    """

    def __init__(self) -> None:
        self.paths: dict[tuple[int, int, int], Path] = {}
        self.folder: tempfile.TemporaryDirectory[str] | None = None
        self.lock = threading.Lock()


def is_capture(obj: bpy.types.Object) -> bool:
    """Whether an object plays a .frog file."""
    if obj.type not in point_cloud.TYPES:
        return False
    settings = obj.frog
    # The first check is fast, and false for most objects.
    return bool(settings.is_property_set("filepath") and settings.filepath)


def shown_path(settings: Any, stored: str) -> str:
    """The value of ``Object.frog.filepath``, given the string stored there."""
    source = settings.source
    return stored if source is None else source.filepath


def point_at(settings: Any, path: str) -> None:
    """Sets the path, which may be relative, of the capture's volume. A volume that is shared gets a copy first."""
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
    """Creates the volume for captures of this .blend that only have a path."""
    for obj in bpy.data.objects:
        if is_capture(obj) and obj.frog.source is None and relative_paths.library_of(obj) is None:
            point_at(obj.frog, obj.frog.filepath)


def named_file(obj: bpy.types.Object) -> Path:
    """The file that an object refers to. It need not exist if its content is packed into the .blend."""
    return relative_paths.absolute(obj.frog.source or obj, obj.frog.filepath)


def file_of(obj: bpy.types.Object) -> Path:
    """The .frog file that an object plays: the file it refers to, or a copy of what is packed into the .blend."""
    source = obj.frog.source
    if source is None or source.packed_file is None:
        return named_file(obj)
    return _copy_of_packed(source) or named_file(obj)


def packed_bytes(obj: bpy.types.Object) -> int:
    """Size in bytes of a capture's packed file in the .blend; 0 if it is not packed."""
    source = obj.frog.source
    return source.packed_file.size if source is not None and source.packed_file is not None else 0


def _copy_of_packed(source: bpy.types.Volume) -> Path | None:
    """A file with the packed content of a volume, written once for each content; None if it cannot be written."""
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
            mark = hashlib.blake2b(content, digest_size=8).hexdigest()
            path = Path(unpacked.folder.name) / mark / f"{stem[:60]}.frog"
            if not path.is_file():
                write_atomically(path, content)
        except (FrogError, OSError) as error:
            print(f"FRoG: {source.name}: its packed file could not be unpacked ({error}).", file=sys.stderr)
            return None
        unpacked.paths[key] = path
        return path


def forget() -> None:
    """Deletes the copies of packed files."""
    unpacked = addon_state.get(UnpackedFiles)
    with unpacked.lock:
        unpacked.paths.clear()
        if unpacked.folder is not None:
            unpacked.folder.cleanup()
        unpacked.folder = None
