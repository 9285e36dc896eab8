"""Files whose libraries trust what they read, imported in a process of its own with a limit to its memory.

``python -m ...interchange.import_process SOURCE TARGET COMPACT`` writes lines of JSON: ``{"done": 3, "of": 60}``, and
at the end what was imported, or ``{"error": sentence}``. It ends when the process that started it does.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import threading
from collections.abc import Callable, Iterable
from pathlib import Path

from ..capture.video import load_opencv
from ..errors import FrogError, brief, how_it_ended
from ..optional_imports import is_missing, not_loaded
from .frame_source import FrameSource, Imported, write_source

ROOM = 512 << 20
"""Bytes that a reader may take besides twice the file."""
USD_SUFFIXES = (".usd", ".usda", ".usdc", ".usdz")
SUFFIXES = (*USD_SUFFIXES, ".4dgs", ".sog")
_PACKAGE = Path(__file__).parents[2]  # of frog_blender, or of an extension that holds it
_LAST_LINES = 3


def import_foreign(
    source: Path, target: Path, *, compact: bool = False, progress: Callable[[int, int], None] = lambda done, of: None
) -> Imported:
    """Writes a scene of a USD, ``.4dgs`` or ``.sog`` file; FrogError when it cannot, and nothing is changed then.

    Args:
        compact, progress: see ``write_source``.
    """
    module = ".".join([_PACKAGE.name, *Path(__file__).with_suffix("").relative_to(_PACKAGE).parts])
    command = [sys.executable, "-P", "-m", module, str(source), str(target), "compact" if compact else "plain"]
    environment = os.environ | {
        "PYTHONPATH": os.pathsep.join([str(_PACKAGE.parent), *filter(None, sys.path)]),
        "PYTHONIOENCODING": "utf-8",
        "OPENBLAS_NUM_THREADS": "1",  # threads reserve memory, which is limited here
        "PXR_WORK_THREAD_LIMIT": "1",
    }
    with subprocess.Popen(
        command,
        env=environment,
        stdin=subprocess.PIPE,  # closed when this process ends, which ends the child
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        encoding="utf-8",
        errors="replace",
    ) as process:
        said: list[str] = []
        listener = threading.Thread(target=lambda: said.extend(process.stderr or ()), daemon=True)
        listener.start()
        answer = _followed(process.stdout or (), progress)
        code = process.wait()
        listener.join()
    if "error" in answer:
        raise FrogError(answer["error"])
    if code or "gaussians" not in answer:
        last = brief(" ".join(line.strip() for line in said[-_LAST_LINES:])) or "it said nothing"
        how = how_it_ended(code)
        raise FrogError(f"{source}: the program that reads it {how} ({last}): the file is damaged or too large.")
    return Imported(
        target,
        int(answer["gaussians"]),
        int(answer["left_out"]),
        frames=int(answer["frames"]),
        keeps_identity=bool(answer["keeps_identity"]),
        left_out_sound=answer["sound"],
    )


def _followed(lines: Iterable[str], progress: Callable[[int, int], None]) -> dict[str, str]:
    """The child's last word; what it says before is progress."""
    answer: dict[str, str] = {}
    for line in lines:
        try:
            told = json.loads(line)
        except ValueError:
            continue  # a library's own
        if isinstance(told, dict) and "of" in told:
            progress(int(told["done"]), int(told["of"]))
        elif isinstance(told, dict):
            answer = told
    return answer


def open_source(path: Path) -> FrameSource:
    """The frames of a USD, ``.4dgs`` or ``.sog`` file, read in this process."""
    if path.suffix.lower() in USD_SUFFIXES:
        from .usd_source import UsdSource

        return UsdSource(path)
    if path.suffix.lower() == ".sog":
        from .sog import open_sog

        return open_sog(path)
    from .fourdgs_source import open_fourdgs

    return open_fourdgs(path)


def answered(source: Path, target: Path, *, compact: bool) -> dict[str, object]:
    """What the child says in the end."""
    try:
        preload(source)
        limit_memory(source)
        done = write_source(open_source(source), source, target, compact=compact, progress=_tell)
        left_out_sound = _kept_sound(source, target)
    except FrogError as error:
        return {"error": str(error)}
    except MemoryError:
        return {"error": f"{source}: found a file that needs more memory than its size allows for."}
    except ImportError as error:
        package = {"pxr": "usd-core", "fourdgs": "fourdgs"}.get(str(error.name).split(".")[0], str(error.name))
        if not is_missing(error):
            return {"error": f"{source}: {not_loaded(error)}."}
        return {"error": f"{source}: the Python package {package!r}, which reads such files, is not installed."}
    return {
        "gaussians": done.gaussians,
        "left_out": done.left_out,
        "frames": done.frames,
        "keeps_identity": done.keeps_identity,
        "sound": left_out_sound,
    }


def _kept_sound(source: Path, target: Path) -> str:
    """Keeps the sound of a file that has one beside the scene; what of it was left out."""
    if source.suffix.lower() != ".4dgs":
        return ""
    from .fourdgs_sound import keep_sound

    return keep_sound(source, target)


def preload(source: Path) -> None:
    """Loads what reads the file, before the memory is limited."""
    if source.suffix.lower() in USD_SUFFIXES:
        from pxr import Usd, UsdGeom, UsdUtils  # noqa: F401
    elif source.suffix.lower() == ".sog":
        load_opencv()
    else:
        import fourdgs  # noqa: F401


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


def _tell(done: int, of: int) -> None:
    print(json.dumps({"done": done, "of": of}), flush=True)


def _end_with_parent() -> None:
    """Standard input ends when the parent does, however that ended."""
    sys.stdin.read()
    os._exit(1)


def main(arguments: list[str]) -> int:
    """Imports the file that the arguments name; anything but a FrogError ends the process as it is."""
    source, target, form = arguments
    threading.Thread(target=_end_with_parent, daemon=True).start()
    print(json.dumps(answered(Path(source), Path(target), compact=form == "compact")), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
