"""Any other program's file as a scene: which reader takes it, and where the scene goes.

What a library reads that trusts its files, USD's own and OpenCV, is read in a process of its own with a limit to its
memory.
"""

from __future__ import annotations

import json
import tempfile
import zipfile
import zlib
from collections.abc import Callable, Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..capture.video import load_opencv
from ..errors import FrogError, brief, found_instead
from ..io import child_process
from ..io.atomic_files import remove_partial_files
from ..io.plain_values import JsonObject, UnfitValue
from ..io.regular_file import regular_file
from ..optional_imports import needed_package
from ..scene.quantization import morton_order
from ..scene.scene_file import SceneFile, read_scene, write_scene
from . import gltf, packed_splats, spz
from .frame_source import (
    FrameSource,
    Imported,
    Progress,
    StillSource,
    check_ending,
    check_readable,
    imported_header,
    unheard,
    write_source,
)
from .ply import PlySequence, read_splats
from .stills import Part, gathered

Decoder = Callable[[Path, bytes], Iterable[Part]]
"""A still's file and its content to its Gaussians; UnfitValue for content of another kind."""
_STILLS: dict[str, tuple[str, Decoder]] = {
    ".spz": (spz.EXPECTED, spz.decode_spz),
    ".glb": (gltf.EXPECTED, gltf.decode_gltf),
    ".gltf": (gltf.EXPECTED, gltf.decode_gltf),
    ".splat": (packed_splats.SPLAT, packed_splats.decode_splat),
    ".ksplat": (packed_splats.KSPLAT, packed_splats.decode_ksplat),
    ".sog": (packed_splats.SOG, packed_splats.decode_sog),
}
"""Formats of one time's Gaussians by their endings: what is expected, and what reads it."""
_USD = (".usd", ".usda", ".usdc", ".usdz")
_BESIDE = (*_USD, ".sog")  # read in a process of its own
SUFFIXES = (".ply", ".zip", *_USD, *_STILLS)
"""Endings of the files that can be imported; folders of .ply files can be as well."""
_ORIGINS = {"plys", *(suffix.lstrip(".") for suffix in SUFFIXES)}
RATE = 30.0
"""Frames a second of a sequence that says nothing of it."""
ROOM = 512 << 20
"""Bytes that a reader in a process of its own may take besides twice the file."""


def import_scene(
    source: Path, target: Path, *, compact: bool = False, rate: float = RATE, progress: Progress = unheard
) -> Imported:
    """Writes what another program's file holds as a scene; FrogError when it cannot, and nothing is changed then.

    Args:
        source: a file, or a folder of ``.ply`` files.
        compact: several times smaller, without a visible difference.
        rate: frames a second, of ``.ply`` files one a frame.
        progress: told how many of how many steps are done, where there are several.
    """
    suffix = "" if source.is_dir() else source.suffix.lower()
    remove_partial_files(target)
    if suffix == ".ply":
        return _import_ply(source, target, compact, progress)
    if suffix in _BESIDE:
        return _import_beside(source, target, compact, progress)
    return write_source(open_source(source, rate), source, target, compact=compact, progress=progress)


def open_source(path: Path, rate: float = RATE) -> FrameSource:
    """The frames of a file or a folder, read in this process. A single ``.ply`` is no source: its numbers are kept."""
    suffix = path.suffix.lower()
    if is_sequence(path):
        return PlySequence(path, rate)
    if suffix in _USD:
        from .usd_source import UsdSource

        return UsdSource(path)
    if suffix in _STILLS:
        gaussians, left_out = gathered(path, _decoded(path, *_STILLS[suffix]))
        return StillSource(gaussians, suffix.lstrip("."), left_out)
    raise found_instead(path, f"the ending {path.suffix!r}", f"one of {', '.join(SUFFIXES)}")


def _decoded(path: Path, expected: str, decode: Decoder) -> list[Part]:
    content = regular_file(path, expected).read_bytes()
    try:
        with np.errstate(invalid="ignore", over="ignore"):  # numbers that are none are left out afterwards
            return list(decode(path, content))
    except UnfitValue as error:
        raise found_instead(path, error.found, error.expected) from error
    except ImportError as error:
        raise needed_package(path, error) from error
    except (zipfile.BadZipFile, zlib.error, OSError, LookupError, ValueError, RuntimeError, EOFError) as error:
        raise found_instead(path, f"a damaged or foreign file ({brief(error)})", expected) from error


def _import_ply(source: Path, target: Path, compact: bool, progress: Progress) -> Imported:
    """A 3DGS ``.ply``, number by number as it is."""
    check_ending(target)
    splats = read_splats(source)
    progress(1, 2)
    arrays = splats.arrays
    if compact:  # neighbours in the file are packed well if they are neighbours in the scene
        order = morton_order(arrays["means"])
        arrays = {name: array[order] for name, array in arrays.items()}
    header = replace(imported_header(source, "ply"), world=splats.world)
    check_readable(source, header)
    write_scene(target, SceneFile(header, arrays), compact=compact)
    return Imported(target, len(arrays["means"]), splats.left_out, splats.world)


def _import_beside(source: Path, target: Path, compact: bool, progress: Progress) -> Imported:
    """In a process of its own."""

    def failure(end: str) -> str:
        return f"{source}: the program that reads it {end}: the file is damaged or too large."

    request = {"source": str(source), "target": str(target), "compact": compact}
    with tempfile.TemporaryDirectory(prefix="frog-import-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        (folder / child_process.REQUEST).write_text(json.dumps(request), encoding="utf-8")
        task = child_process.Task("interchange.imports:convert", failure)
        done = task.run(folder, lambda _stage, done, total: progress(done, total))
    gaussians, left_out, frames = (int(done[name]) for name in ("gaussians", "left_out", "frames"))
    return Imported(target, gaussians, left_out, frames=frames, keeps_identity=bool(done["keeps_identity"]))


def convert(request: JsonObject, tell: child_process.Progress) -> JsonObject:
    """The child's task: writes the scene, and returns what was imported."""
    source, target, compact = Path(request["source"]), Path(request["target"]), bool(request["compact"])
    try:
        preload(source)
        limit_memory(source)
        done = write_source(
            open_source(source), source, target, compact=compact, progress=lambda *steps: tell("importing", *steps)
        )
    except MemoryError as error:
        raise FrogError(f"{source}: found a file that needs more memory than its size allows for.") from error
    except ImportError as error:
        raise needed_package(source, error) from error
    return {name: getattr(done, name) for name in ("gaussians", "left_out", "frames", "keeps_identity")}


def preload(source: Path) -> None:
    """Loads what reads the file, before the memory is limited."""
    if source.suffix.lower() in _USD:
        from pxr import Usd, UsdGeom, UsdUtils  # noqa: F401
    else:
        load_opencv()


def limit_memory(source: Path) -> None:
    """No more than ROOM and twice the file from now on, where the system can be told so."""
    try:
        import resource
    except ImportError:  # Windows
        return
    try:
        taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        limit = taken + ROOM + 2 * source.stat().st_size
        resource.setrlimit(resource.RLIMIT_AS, (limit, resource.getrlimit(resource.RLIMIT_AS)[1]))
    except (OSError, ValueError, IndexError):
        return


def is_sequence(source: Path) -> bool:
    """Whether it holds a ``.ply`` file for each frame, and nothing that says how fast they follow each other."""
    return source.suffix.lower() == ".zip" or source.is_dir()


def says_what_is_up(source: Path) -> bool:
    """Whether a format says which way is up, so that its scenes have z up whatever the file has."""
    return source.suffix.lower() in (*_USD, ".spz", ".glb", ".gltf")


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
