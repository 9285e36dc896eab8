"""Arguments that several commands take, and what they stand for."""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.capture.readers.footage import is_recording
from ..engine.distributed.cluster import LOCAL, Cluster
from ..engine.errors import FrogError, UsageError
from ..engine.options import OPTIONS, Option, PixelOffsets
from ..engine.setting import Choice, parsed

if TYPE_CHECKING:
    from ..engine.editing.edits import Timing
    from ..engine.playback.player import ScenePlayer


def positive(kind: Callable[[str], float], least: float = 0) -> Callable[[str], float]:
    """The argument type of positive numbers, ``int`` or ``float``, that are no smaller than ``least``."""

    def parse(text: str) -> float:
        with suppress(ValueError):
            if least <= (value := kind(text)) < float("inf") and value > 0:
                return value
        expected = f"a positive {'whole ' * (kind is int)}number{f' of at least {least:g}' * (least > 0)}"
        raise argparse.ArgumentTypeError(f"{text} is not {expected}")

    return parse


class Reads(argparse.Action):
    """Of a path that a command reads: ``check_there`` is asked about it before the command begins."""

    def __call__(self, _: argparse.ArgumentParser, options: argparse.Namespace, path: Any, __: object = None) -> None:
        setattr(options, self.dest, path)
        options.reads = [*getattr(options, "reads", ()), path]


def check_there(paths: Iterable[Path]) -> None:
    """UsageError for the first path where nothing is, and which names no recording; what cannot be read is left to who
    reads it."""
    for path in paths:
        try:
            path.stat()
        except (FileNotFoundError, NotADirectoryError):
            if not is_recording(path):
                raise UsageError(f"{path}: there is no such file or folder.") from None
        except (OSError, ValueError):
            continue


def add_options(parser: Any, *names: str) -> None:
    """Adds options of a training, as ``engine.options`` has them, to a parser or a group; see ``given_of``."""
    for name in names:
        option = OPTIONS[name]
        told: dict[str, Any] = {"dest": name, "default": argparse.SUPPRESS, "help": option.described.replace("%", "%%")}
        if option.is_switch:
            parser.add_argument(option.flag, action="store_true", **told)
        elif isinstance(option.plain_kind, PixelOffsets):
            parser.add_argument(option.flag, action="append", metavar=option.placeholder, **told)
        elif isinstance(option.plain_kind, Choice):
            parser.add_argument(option.flag, choices=option.plain_kind.values, **told)
        else:
            parser.add_argument(option.flag, type=_reader(option), metavar=option.placeholder, **told)


def _reader(option: Option) -> Callable[[str], object]:
    """The argument type of an option."""

    def read(text: str) -> object:
        try:
            return parsed(option.flag, text, option.plain_kind)
        except FrogError as error:
            raise argparse.ArgumentTypeError(str(error).rstrip(".")) from None

    return read


def given_of(options: argparse.Namespace) -> dict[str, Any]:
    """Those options of ``add_options`` that were given, by name; FrogError for malformed pixel offsets."""
    given = {name: value for name, value in vars(options).items() if name in OPTIONS}
    if texts := given.get("pixel_offsets"):
        given["pixel_offsets"] = {name: offset for text in texts for name, offset in _offset(text).items()}
    return given


def _offset(text: str) -> dict[str, tuple[float, ...]]:
    """One camera's offset; its name may have blanks in it."""
    option, offsets = OPTIONS["pixel_offsets"], PixelOffsets()
    with suppress(ValueError):
        offset = offsets.parse_all([text])
        if offsets.accepts(offset):
            return offset
    raise UsageError(f"{option.flag} {text}: expected {offsets.expected}.")


def add_scene_arguments(parser: argparse.ArgumentParser) -> None:
    """Adds the scene, ``--frames`` (see ``frames_of``) and ``--edits`` (see ``edited_scene``)."""
    parser.add_argument("scene", type=Path, action=Reads)
    parser.add_argument(
        "--frames", default=None, metavar="A:B", help="frames A to B - 1 (A-B: to B), counted from 0; default: all"
    )
    parser.add_argument(
        "--edits", type=Path, action=Reads, metavar="FILE", help="crops, grades, timing and so on, saved in Blender"
    )


def frames_of(text: str | None, count: int) -> range:
    """``A:B`` as the frames A to B - 1 of ``count``, ``A-B`` as A to B, either end optional; all of them for None.

    Raises:
        FrogError: for other text, no frame, or frames that the scene does not have.
    """
    matched = re.fullmatch(r"(\d{0,9})([:-])(\d{0,9})", text or ":")
    if matched is None:
        raise UsageError(f"--frames {text}: expected A:B, such as 0:30, or A-B, such as 0-29.")
    first, sign, last = matched.groups()
    frames = range(int(first or 0), int(last) + (sign == "-") if last else count)
    if not frames or frames[-1] >= count:
        raise UsageError(f"--frames {text}: expected frames between 0:{count}.")
    return frames


def edited_scene(scene: ScenePlayer, path: Path | None) -> tuple[ScenePlayer, Timing | None]:
    """A scene with the edits in a file, the scene itself without one, and how the file retimes it; warns of what was
    made for another scene.

    Raises:
        FrogError: for a file that holds no edits.
    """
    if path is None:
        return scene, None
    from ..engine.editing.edited_scene import edited
    from ..engine.editing.edits_file import load_edits

    edits = load_edits(path)
    played, dropped = edited(scene, edits)
    for sentence in dropped:
        print(f"warning: {path}: {sentence}", file=sys.stderr)
    return played, edits.timing


def add_scheduler_argument(command: argparse.ArgumentParser, jobs: str) -> None:
    """Adds ``--jobs`` and ``--scheduler``; see ``opened_cluster``."""
    command.add_argument("--jobs", type=positive(int), default=1, metavar="N", help=jobs)
    command.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help=f"give the work to the workers of a Dask cluster, such as tls://10.0.0.5:8786 (whoever reaches"
        f" a tcp:// address runs code as you); {LOCAL}: to --jobs workers of this machine, closed to its other users",
    )


@contextmanager
def opened_cluster(scheduler: str, workers: int) -> Iterator[Cluster]:
    """Yields the cluster; its tasks are asked to end, and a local one ends, with the block.

    Args:
        scheduler: the address of a Dask scheduler, or "local".
        workers: processes of a local cluster.

    Raises:
        FrogError: if no scheduler answers.
    """
    with Cluster(scheduler, workers) as cluster:
        print(
            "; ".join(filter(None, (f"Dask: {cluster.slots} at once", cluster.dashboard))), file=sys.stderr, flush=True
        )
        yield cluster


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """At most ``count`` threads each for the native library, torch and OpenCV inside the block; 0 changes nothing."""
    if not count:
        yield
        return
    import cv2

    from ..engine.native import binding
    from ..engine.training.optimize.device import torch_threads

    before = cv2.getNumThreads()
    cv2.setNumThreads(count)
    binding.set_thread_count(count)
    try:
        with torch_threads(count):
            yield
    finally:
        cv2.setNumThreads(before)
        binding.set_thread_count(0)
