"""Any other program's file as a scene that plays: which reader takes it, and where the scene goes.

No network is trained: frames are stored as they are (see scene.scene_file). They are gone through twice, first to see
what changes and then to write it, and one or two of them are held at a time, however many there are.

What a library reads that trusts its files, USD's own and OpenCV, is read in a process of its own with a limit to its
memory.
"""

import math
import tempfile
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..capture.video import load_opencv
from ..errors import FrogError, UsageError, found_instead
from ..field.names import CURVES, SEQUENCE
from ..io import child_process
from ..io.atomic_files import remove_partial_files
from ..io.child_process import run_in_child
from ..io.regular_file import regular_file
from ..io.tensor_files import write_rows
from ..optional_imports import needed_package
from ..playback.frame_delta import canonical_arrays, column_names, column_of
from ..scene.header import SceneHeader, check_readable
from ..scene.quantization import morton_order
from ..scene.scene_file import FRAMES, RowLayout, SceneFile, packed_metadata, read_scene, settings_json, write_scene
from . import gltf, sog, splat, spz
from .frame_source import FrameSource, StillSource, Survey, filled, survey
from .ply import moves, read_splats
from .ply_sequence import PlySequence
from .splatv import read_splatv
from .stills import Part, decoding, gathered

_MOST_GROWN, _ROOM = 10_000, 4 << 30
"""Bytes of frames for each byte that they were made of, and for any file: Gaussians that a small file says to move
evenly for minutes become many frames, but what becomes far more is damaged or made to fill the disk."""
_OTHER_ROWS = (
    "Its frames are not the same Gaussians in the same order: they play, without anything between two of them, and can "
    "be edited by place alone."
)


Progress = Callable[[int, int], None]
"""Told how many of how many steps are done."""


@dataclass(frozen=True)
class Imported:
    """Attributes:
    path: of the ``.frog`` that was written.
    gaussians: how many are in it; the most of any frame.
    frames: how many there are.
    keeps_identity: whether the same row is the same Gaussian in all frames.
    warning: sentences about what was left out, taken off, or looks otherwise than in the program that wrote it.
    """

    path: Path
    gaussians: int
    frames: int
    keeps_identity: bool
    warning: str


def write_source(
    source: FrameSource, file: Path, target: Path, *, compact: bool = False, progress: Progress = lambda *_: None
) -> Imported:
    """Writes a scene of a source's frames; FrogError when it cannot, and nothing is changed then.

    Args:
        file: what the source was read from, for the header.
        compact: half floats but for places, and static Gaussians packed (see scene.quantization).
        progress: told how many of how many steps are done.
    """
    steps = 2 * source.frame_count
    seen = survey(source, lambda done: progress(done, steps))
    dynamic = int(seen.moves.sum())
    order = morton_order(seen.first.means) if compact else np.arange(seen.count)  # neighbours are packed well
    order = order[np.argsort(~seen.moves[order], kind="stable")]
    arrays = source.arrays or canonical_arrays(seen.first)
    if compact or dynamic:
        arrays = {name: array[order] for name, array in arrays.items()}
    columns = tuple(name for name in column_names(seen.first.sh.shape[1]) if name in seen.columns)
    layout = RowLayout(dynamic, columns, seen.keeps_identity, compact)
    header = SceneHeader(
        method=SEQUENCE if dynamic else "static",
        recipe={"name": "imported"},
        model=settings_json(layout) if dynamic else {},
        cameras=source.cameras,
        camera_shots=(tuple(range(source.frame_count)),) * len(source.cameras),
        test_cameras=(),
        test_frames=(),
        frame_count=source.frame_count,
        frames_per_second=source.rate,
        background=(0.0, 0.0, 0.0),
        capture_path=str(file.resolve()),
        capture_format=source.origin,
        scale=1.0,
        world=source.world,
        low_pass=float(np.max(seen.first.low_pass)),
    )
    check_readable(file, header)
    if dynamic and CURVES not in arrays:
        _check_size(file, header, layout)
        stored, metadata = packed_metadata(header, arrays, compact=compact)
        rows = _moving_rows(source, seen, order[:dynamic], layout, lambda done: progress(done, steps))
        for _ in write_rows(target, stored, metadata, (FRAMES, "U8", (source.frame_count, layout.size)), rows):
            pass
    else:
        write_scene(target, SceneFile(header, arrays), compact=compact)
    said = list(source.notes)
    if source.left_out:
        said.append(f"{source.left_out:,} Gaussians were left out: their numbers are not finite or too large.")
    if not source.world.is_plain:
        said.append(f"The file's coordinates need more than single precision; they are {source.world}.")
    if not seen.keeps_identity:
        said.append(_OTHER_ROWS)
    return Imported(target, seen.count, source.frame_count, seen.keeps_identity, " ".join(said))


def _check_size(file: Path, header: SceneHeader, layout: RowLayout) -> None:
    """FrogError for frames that are far more than what they were made of."""
    needed, most = header.frame_count * layout.size, max(_ROOM, _MOST_GROWN * _bytes_of(file))
    if needed > most:
        frames = f"{header.frame_count:,} frames of {layout.dynamic:,} Gaussians, {needed / 1e6:,.0f} MB"
        raise found_instead(file, frames, f"at most {most / 1e6:,.0f} MB of a file of its size")


def _bytes_of(source: Path) -> int:
    """Of a file, or of those in a folder; 0 for what cannot be read."""
    folder = source.parent if source.name.lower() == META else source
    try:
        return sum(part.stat().st_size for part in (folder.iterdir() if folder.is_dir() else [source]))
    except OSError:
        return 0


def _moving_rows(
    source: FrameSource, seen: Survey, rows: Array, layout: RowLayout, done: Callable[[int], None]
) -> Iterator[Array]:
    for frame in range(source.frame_count):
        gaussians = filled(source.at(frame), seen.count, seen.first.sh.shape[1]).part(rows)
        yield layout.packed({name: column_of(gaussians, name) for name in layout.columns})
        done(source.frame_count + frame + 1)


Decoder = Callable[[Path, bytes], Iterable[Part]]
"""A still's file and its content to its Gaussians; UnfitValue for content of another kind."""
_STILLS: dict[str, tuple[str, Decoder]] = {
    ".spz": (spz.EXPECTED, spz.decode_spz),
    ".glb": (gltf.EXPECTED, gltf.decode_gltf),
    ".gltf": (gltf.EXPECTED, gltf.decode_gltf),
    ".splat": (splat.EXPECTED, splat.decode_splat),
    ".sog": (sog.EXPECTED, sog.decode_sog),
}
"""Formats of one time's Gaussians by their endings: what is expected, and what reads it."""
META = "meta.json"
"""Name of the description of a .sog that is a folder."""
_NETWORK = "deformation.pth"
_USD = (".usd", ".usda", ".usdc", ".usdz")
_BESIDE = (*_USD, ".sog")  # read in a process of its own
SUFFIXES = (".ply", ".splatv", ".zip", *_USD, *_STILLS)
"""Endings of the files that can be imported; folders of .ply files can be as well."""
_ORIGINS = {"plys", *(suffix.lstrip(".") for suffix in SUFFIXES)}
RATE = 30.0
"""Frames a second of a sequence that says nothing of it."""
ROOM, BYTES_OF_BYTE = 256 << 20, {".sog": 128}
"""Bytes that a reader in a process of its own may take for any file, and for each byte of one; 32 where not said, as
USD's reader of text takes 20."""
SECONDS, BYTES_A_SECOND = 10, 4 << 20
"""Of computing until such a file is open, for any file, and how many more bytes are given one more."""


def import_scene(
    source: Path, target: Path, *, compact: bool = False, rate: float = RATE, progress: Progress = lambda *_: None
) -> Imported:
    """Writes what another program's file holds as a scene; FrogError when it cannot, and nothing is changed then.

    Args:
        source: a file, or a folder of ``.ply`` files.
        compact: several times smaller, without a visible difference.
        rate: frames a second, of ``.ply`` files one a frame.
        progress: told how many of how many steps are done, where there are several.
    """
    if target.suffix != ".frog":
        raise UsageError(f"{target}: found the ending {target.suffix!r}, expected a file that ends in .frog.")
    remove_partial_files(target)
    if kind_of(source) in _BESIDE:
        return _import_beside(source, target, compact, progress)
    return write_source(open_source(source, rate), source, target, compact=compact, progress=progress)


def open_source(path: Path, rate: float = RATE) -> FrameSource:
    """The frames of a file or a folder, read in this process."""
    suffix = kind_of(path)
    if suffix in ("", ".ply") and ((path if path.is_dir() else path.parent) / _NETWORK).is_file():
        found = f"what 4DGaussians trained, whose motion is a network in {_NETWORK}"
        raise found_instead(path, found, "the frames that its export_perframe_3DGS.py writes")
    if is_sequence(path):
        return PlySequence(path, rate)
    if suffix in (".ply", ".splatv"):
        source = read_splats(path) if suffix == ".ply" else read_splatv(path)
        if source.frame_count > 1:
            source.rate = rate
        return source
    if suffix in _USD:
        from .usd_source import UsdSource

        return UsdSource(path)
    if suffix in _STILLS:
        (expected, decode), file = _STILLS[suffix], path / META if path.is_dir() else path
        with decoding(file, expected):
            parts = list(decode(file, regular_file(file, expected).read_bytes()))
        notes = tuple(dict.fromkeys(note for part in parts for note in part.notes))
        return StillSource(*gathered(path, parts), suffix.lstrip("."), notes=notes)
    expected = f"one of {', '.join(SUFFIXES)} (SuperSplat and splat-transform write .ply files of others)"
    raise found_instead(path, f"the ending {path.suffix!r}", expected)


def _import_beside(source: Path, target: Path, compact: bool, progress: Progress) -> Imported:
    """In a process of its own."""
    with tempfile.TemporaryDirectory(prefix="frog-import-", ignore_cleanup_errors=True) as name:
        return run_in_child(
            *(convert, source, target, compact),
            folder=Path(name),
            progress=lambda _stage, *steps: progress(*steps),
            failure=lambda end: f"{source}: the program that reads it {end}: the file is damaged or too large.",
        )


def convert(source: Path, target: Path, compact: bool, tell: child_process.Progress) -> Imported:
    """The child's side: writes the scene."""
    try:
        preload(source)
        with limited(source):
            frames = open_source(source)
        return write_source(frames, source, target, compact=compact, progress=lambda *done: tell("importing", *done))
    except MemoryError as error:
        raise FrogError(f"{source}: found a file that needs more memory than its size allows for.") from error
    except ImportError as error:
        raise needed_package(source, error) from error


def preload(source: Path) -> None:
    """Loads what reads the file, before the memory is limited."""
    if kind_of(source) in _USD:
        from pxr import Usd, UsdGeom, UsdUtils  # noqa: F401
    else:
        load_opencv()


@contextmanager
def limited(source: Path) -> Iterator[None]:
    """No more memory than the file explains from now on, and no more computing in the block; where the system can be
    told so.

    Memory counts when it can be written to: USD's library reserves far more addresses than it ever uses.
    """
    try:
        import resource
    except ImportError:  # Windows
        yield
        return
    size = _bytes_of(source)
    with suppress(OSError, ValueError, IndexError):
        taken = int(Path("/proc/self/statm").read_text().split()[5]) * resource.getpagesize()
        most = taken + ROOM + BYTES_OF_BYTE.get(kind_of(source), 32) * size
        resource.setrlimit(resource.RLIMIT_DATA, (most, resource.getrlimit(resource.RLIMIT_DATA)[1]))
    before = resource.getrlimit(resource.RLIMIT_CPU)
    seconds = math.ceil(time.process_time()) + SECONDS + size // BYTES_A_SECOND
    with suppress(OSError, ValueError):  # less is allowed already
        resource.setrlimit(resource.RLIMIT_CPU, (seconds, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_CPU, before)


def kind_of(source: Path) -> str:
    """The ending that stands for its format: ".sog" for the parts of one in a folder, "" for any other folder."""
    if source.name.lower() == META or (source.is_dir() and (source / META).is_file()):
        return ".sog"
    return "" if source.is_dir() else source.suffix.lower()


def is_sequence(source: Path) -> bool:
    """Whether it holds a ``.ply`` file for each frame, and nothing that says how fast they follow each other."""
    return source.suffix.lower() == ".zip" or (source.is_dir() and not kind_of(source))


def says_no_rate(source: Path) -> bool:
    """Whether it moves, and nothing says how fast."""
    return is_sequence(source) or kind_of(source) == ".splatv" or (kind_of(source) == ".ply" and moves(source))


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
    names = [source.stem, f"{source.stem}_{kind}", *(f"{source.stem}_{kind}{count}" for count in range(2, 1000))]
    for name in names:
        path = source.with_name(f"{name}.frog")
        if not path.exists() or was_imported_from(source, path):
            return path
    raise FrogError(f"{source}: there are a thousand .frog files of that name beside it; name one to write.")


def was_imported_from(source: Path, path: Path) -> bool:
    """Whether a ``.frog`` is an earlier import of a file, and may be replaced by another one."""
    try:
        header = read_scene(path).header
    except FrogError:
        return False
    return header.capture_format in _ORIGINS and header.capture_path == str(source.resolve())
