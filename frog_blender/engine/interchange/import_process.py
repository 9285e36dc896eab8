"""Files whose libraries trust what they read, imported in a process of its own with a limit to its memory."""

from __future__ import annotations

import json
import tempfile
from collections.abc import Callable
from pathlib import Path

from ..capture.video import load_opencv
from ..errors import FrogError
from ..io.child_process import REQUEST, Progress, Task
from ..io.plain_values import JsonObject
from ..optional_imports import is_missing, not_loaded
from .frame_source import FrameSource, Imported, write_source

ROOM = 512 << 20
"""Bytes that a reader may take besides twice the file."""
USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
SUFFIXES = (*USD_SUFFIXES, ".sog")


def import_foreign(
    source: Path, target: Path, *, compact: bool = False, progress: Callable[[int, int], None] = lambda done, of: None
) -> Imported:
    """Writes a scene of a USD or ``.sog`` file; FrogError when it cannot, and nothing is changed then.

    Args:
        compact, progress: see ``write_source``.
    """

    def failure(end: str) -> str:
        return f"{source}: the program that reads it {end}: the file is damaged or too large."

    request = {"source": str(source), "target": str(target), "compact": compact}
    with tempfile.TemporaryDirectory(prefix="frog-import-", ignore_cleanup_errors=True) as name:
        folder = Path(name)
        (folder / REQUEST).write_text(json.dumps(request), encoding="utf-8")
        task = Task("interchange.import_process:convert", failure)
        done = task.run(folder, lambda _stage, done, total: progress(done, total))
    return Imported(
        target,
        int(done["gaussians"]),
        int(done["left_out"]),
        frames=int(done["frames"]),
        keeps_identity=bool(done["keeps_identity"]),
    )


def open_source(path: Path) -> FrameSource:
    """The frames of a USD or ``.sog`` file, read in this process."""
    if path.suffix.lower() in USD_SUFFIXES:
        from .usd_source import UsdSource

        return UsdSource(path)
    from .sog import open_sog

    return open_sog(path)


def convert(request: JsonObject, tell: Progress) -> JsonObject:
    """The child's task: writes the scene, and returns what was imported."""
    source, target = Path(request["source"]), Path(request["target"])

    def progress(done: int, of: int) -> None:
        tell("importing", done, of)

    try:
        preload(source)
        limit_memory(source)
        done = write_source(open_source(source), source, target, compact=bool(request["compact"]), progress=progress)
    except MemoryError as error:
        raise FrogError(f"{source}: found a file that needs more memory than its size allows for.") from error
    except ImportError as error:
        package = {"pxr": "usd-core"}.get(str(error.name).split(".")[0], str(error.name))
        if not is_missing(error):
            raise FrogError(f"{source}: {not_loaded(error)}.") from error
        missing = f"the Python package {package!r}, which reads such files, is not installed"
        raise FrogError(f"{source}: {missing}.") from error
    return {
        "gaussians": done.gaussians,
        "left_out": done.left_out,
        "frames": done.frames,
        "keeps_identity": done.keeps_identity,
    }


def preload(source: Path) -> None:
    """Loads what reads the file, before the memory is limited."""
    if source.suffix.lower() in USD_SUFFIXES:
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
