"""Any other program's file as a scene: which reader takes it, and where the scene goes."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from ..errors import FrogError, found_instead
from ..gaussians import NumpyGaussians
from ..io.atomic_files import remove_partial_files
from ..scene.scene_file import read_scene
from . import import_process
from .frame_source import Imported, StillSource, write_source
from .gltf import read_gltf
from .ksplat import read_ksplat
from .ply_sequence import PlySequence
from .splat_file import read_splat_file
from .splats import FROM_PLY, import_splats
from .spz import read_spz

_STILLS: dict[str, Callable[[Path], tuple[NumpyGaussians, int]]] = {
    ".spz": read_spz,
    ".glb": read_gltf,
    ".gltf": read_gltf,
    ".splat": read_splat_file,
    ".ksplat": read_ksplat,
}
SUFFIXES = (".ply", ".zip", *import_process.SUFFIXES, *_STILLS)
"""Endings of the files that can be imported; folders of .ply files can be as well."""
_ORIGINS = {FROM_PLY, "plys", *(suffix.lstrip(".") for suffix in (*_STILLS, *import_process.SUFFIXES))}
RATE = 30.0
"""Frames a second of a sequence that says nothing of it."""


def import_scene(
    source: Path,
    target: Path,
    *,
    compact: bool = False,
    rate: float = RATE,
    progress: Callable[[int, int], None] = lambda done, of: None,
) -> Imported:
    """Writes what another program's file holds as a scene; FrogError when it cannot, and nothing is changed then.

    Args:
        source: a file, or a folder of ``.ply`` files.
        compact: several times smaller, without a visible difference.
        rate: frames a second, of ``.ply`` files one a frame.
        progress: told how many of how many steps are done, where there are several.
    """
    suffix = source.suffix.lower()
    remove_partial_files(target)
    if is_sequence(source):
        return write_source(PlySequence(source, rate), source, target, compact=compact, progress=progress)
    if suffix == ".ply":
        return import_splats(source, target, compact=compact, progress=progress)
    if suffix in import_process.SUFFIXES:
        return import_process.import_foreign(source, target, compact=compact, progress=progress)
    if suffix in _STILLS:
        gaussians, left_out = _STILLS[suffix](source)
        still = StillSource(gaussians, suffix.lstrip("."), left_out)
        return write_source(still, source, target, compact=compact, progress=progress)
    raise found_instead(source, f"the ending {source.suffix!r}", f"one of {', '.join(SUFFIXES)}")


def is_sequence(source: Path) -> bool:
    """Whether it holds a ``.ply`` file for each frame, and nothing that says how fast they follow each other."""
    return source.suffix.lower() == ".zip" or source.is_dir()


def says_what_is_up(source: Path) -> bool:
    """Whether a format says which way is up, so that its scenes have z up whatever the file has."""
    return source.suffix.lower() in (*import_process.USD_SUFFIXES, ".spz", ".glb", ".gltf")


def free_scene_path(source: Path) -> Path:
    """Where a file becomes a ``.frog`` when nobody says where: beside it, over nothing but an earlier import of it.

    It often lies beside the trained scene that it was exported from.
    """
    if source.name in ("", ".."):  # the folder where one is, or one above
        source = source.resolve()
    if not source.name:
        raise FrogError(f"{source}: found a folder without a name, expected the name of the .frog to write as well.")
    kind = source.suffix.lower().lstrip(".") or "frames"
    names = [source.stem, f"{source.stem}_{kind}", *(f"{source.stem}_{kind}{number}" for number in range(2, 1000))]
    for name in names:
        path = source.with_name(f"{name}.frog")
        if not path.exists() or _was_imported_from(source, path):
            return path
    raise FrogError(f"{source}: there are a thousand .frog files of that name beside it; name one to write.")


def _was_imported_from(source: Path, path: Path) -> bool:
    try:
        header = read_scene(path).header
    except FrogError:
        return False
    return header.capture_format in _ORIGINS and header.capture_path == str(source.resolve())
