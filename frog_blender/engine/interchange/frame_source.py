"""Frames that another program made, and how they become a ``.frog`` that plays.

No network is trained: the frames are stored (see scene.frame_rows). They are gone through twice, first to see what
changes and then to write it, and one or two of them are held at a time, however many there are.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from ..arrays import Array, Bools, SceneArrays
from ..capture.camera import Camera
from ..capture.world import FILES_OWN, World
from ..errors import FrogError, found_instead
from ..field.names import SEQUENCE
from ..gaussians import GaussianArrays, NumpyGaussians
from ..io.plain_values import UnfitValue
from ..io.tensor_files import LONGEST_HEADER, write_rows
from ..playback.frame_delta import column_names, column_of
from ..scene.frame_rows import FRAMES, RowLayout
from ..scene.header import MAX_FRAMES, SceneHeader
from ..scene.quantization import morton_order
from ..scene.scene_file import SceneFile, packed_metadata, write_scene

_MOST_SHOTS = LONGEST_HEADER // 12  # of all cameras; in the header each is up to nine characters
_MOST_GROWN, _ROOM = 10_000, 4 << 30
"""Bytes of frames for each byte that they were made of, and for any file: Gaussians that a small file says to move
evenly for minutes become many frames, but what becomes far more is damaged or made to fill the disk."""
_NOWHERE = 1e-6  # size of the rows that fill a frame with fewer Gaussians than another has
_MOST_CERTAIN, _THINNEST = 1 - 2.0**-26, 1e-30
STILL_RATE = 24.0
"""Frames a second of a scene of one frame."""
_OTHER_ROWS = (
    "Its frames are not the same Gaussians in the same order: they play, without anything between two of them, and can "
    "be edited by place alone."
)
_SAMPLED = 4096  # Gaussians whose steps are looked at
_STEP = 0.1  # of the distance between two of them: a Gaussian that goes farther in a frame is another one


Progress = Callable[[int, int], None]
"""Told how many of how many steps are done."""


def unheard(_done: int, _of: int) -> None:
    """Progress that nobody is told."""


class FrameSource(Protocol):
    """Frames that can be read in any order, any number of times.

    Attributes:
        frame_count: at least one.
        rate: frames a second.
        keeps_identity: whether the same row is the same Gaussian in all frames; None where the file does not say.
        cameras: of the capture, where the file has any.
        origin: the file's format, for the scene's header.
        left_out: rows that could not be drawn and are in no frame, so far.
    """

    frame_count: int
    rate: float
    keeps_identity: bool | None
    cameras: tuple[Camera, ...]
    origin: str
    left_out: int

    def at(self, frame: int) -> NumpyGaussians:
        """A frame, counted from 0: finite numbers, unit quaternions, at least one Gaussian; FrogError for others."""
        ...


@dataclass
class StillSource:
    """A source of one frame.

    Attributes:
        gaussians: the frame.
        origin, left_out: see ``FrameSource``.
    """

    gaussians: NumpyGaussians
    origin: str
    left_out: int
    frame_count: int = 1
    rate: float = STILL_RATE
    keeps_identity: bool | None = True
    cameras: tuple[Camera, ...] = ()

    def at(self, _frame: int) -> NumpyGaussians:
        """The frame."""
        return self.gaussians


@dataclass(frozen=True)
class Imported:
    """Attributes:
    path: of the ``.frog`` that was written.
    gaussians: how many are in it; the most of any frame.
    left_out: rows whose numbers are not finite or too large.
    world: what was taken off its coordinates.
    frames: how many there are.
    keeps_identity: whether the same row is the same Gaussian in all frames.
    """

    path: Path
    gaussians: int
    left_out: int
    world: World = FILES_OWN
    frames: int = 1
    keeps_identity: bool = True

    @property
    def warning(self) -> str:
        """Sentences about what was left out, and taken off; "" for nothing."""
        sentences = []
        if self.left_out:
            sentences.append(f"{self.left_out:,} Gaussians were left out: their numbers are not finite or too large.")
        if not self.world.is_plain:
            sentences.append(f"The file's coordinates need more than single precision; they are {self.world}.")
        if not self.keeps_identity:
            sentences.append(_OTHER_ROWS)
        return " ".join(sentences)


def write_source(
    source: FrameSource, file: Path, target: Path, *, compact: bool = False, progress: Progress = unheard
) -> Imported:
    """Writes a scene of a source's frames; FrogError when it cannot, and nothing is changed then.

    Args:
        file: what the source was read from, for the header.
        compact: half floats but for places, and static Gaussians packed (see scene.quantization).
        progress: told how many of how many steps are done.
    """
    check_ending(target)
    if source.frame_count > MAX_FRAMES:
        raise FrogError(f"{file}: found {source.frame_count:,} frames, expected at most {MAX_FRAMES:,}.")
    steps = 2 * source.frame_count
    seen = _survey(source, lambda done: progress(done, steps))
    order = np.concatenate([np.flatnonzero(seen.moves), np.flatnonzero(~seen.moves)])
    if compact:
        rank = np.empty(seen.count, np.int64)
        rank[morton_order(seen.first.means)] = np.arange(seen.count)
        order = np.lexsort((rank, ~seen.moves))
    dynamic = int(seen.moves.sum())
    arrays = _canonical(seen.first.part(order))
    columns = tuple(name for name in column_names(seen.first.sh.shape[1]) if name in seen.columns)
    layout = RowLayout(columns, dynamic, compact, seen.keeps_identity)
    moves = bool(dynamic and columns)
    header = replace(
        imported_header(file, source.origin),
        method=SEQUENCE if moves else "static",
        model=layout.model() if moves else {},
        cameras=source.cameras,
        camera_shots=(tuple(range(source.frame_count)),) * len(source.cameras),
        frame_count=source.frame_count,
        frames_per_second=source.rate,
    )
    check_readable(file, header)
    if moves:
        _check_room(file, target, header, layout)
        stored, metadata = packed_metadata(header, arrays, compact=compact)
        rows = _moving_rows(source, seen, order[:dynamic], layout, lambda done: progress(done, steps))
        for _ in write_rows(target, stored, metadata, (FRAMES, "U8", (source.frame_count, layout.size)), rows):
            pass
    else:
        write_scene(target, SceneFile(header, arrays), compact=compact)
    return Imported(target, seen.count, source.left_out, frames=source.frame_count, keeps_identity=seen.keeps_identity)


def check_ending(target: Path) -> None:
    """FrogError for a path that is no scene's."""
    if target.suffix != ".frog":
        raise FrogError(f"{target}: found the ending {target.suffix!r}, expected a file that ends in .frog.")


def imported_header(file: Path, origin: str) -> SceneHeader:
    """The header of a static scene without cameras that a file of a format becomes."""
    return SceneHeader(
        method="static",
        recipe={"name": "imported"},
        model={},
        cameras=(),
        camera_shots=(),
        test_cameras=(),
        test_frames=(),
        frame_count=1,
        frames_per_second=STILL_RATE,
        background=(0.0, 0.0, 0.0),
        capture_path=str(file.resolve()),
        capture_format=origin,
        scale=1.0,
    )


def check_readable(file: Path, header: SceneHeader) -> None:
    """FrogError for a header that could be written but not read again."""
    try:
        shots = sum(map(len, header.camera_shots))
        if shots > _MOST_SHOTS:
            raise UnfitValue(f"{shots:,} frames of all cameras", f"at most {_MOST_SHOTS:,}")
        content = header.to_json()
        if len(json.dumps(content)) > LONGEST_HEADER * 3 // 4:  # the rest is for how the arrays are packed
            raise UnfitValue(f"cameras that take {len(content):,} bytes", "fewer, or shorter names")
        SceneHeader.from_json(content)
    except ValueError as error:
        raise FrogError(f"{file}: no scene of it could be opened: found {error}.") from error


def _check_room(file: Path, target: Path, header: SceneHeader, layout: RowLayout) -> None:
    """FrogError for frames that the disk has no room for, or that are far more than what they were made of."""
    needed = header.frame_count * layout.size
    what = f"{header.frame_count:,} frames of {layout.num_dynamic:,} Gaussians, {needed / 1e6:,.0f} MB"
    most = max(_ROOM, _MOST_GROWN * _size_of(file))
    if needed > most:
        raise found_instead(file, what, f"at most {most / 1e6:,.0f} MB of a file of its size")
    folder = next((parent for parent in target.absolute().parents if parent.is_dir()), None)
    free = shutil.disk_usage(folder).free if folder else needed
    if needed > free:
        raise found_instead(file, what, f"at most the {free / 1e6:,.0f} MB that are free for {target}")


def _size_of(file: Path) -> int:
    """Bytes of a file, or of those in a folder."""
    try:
        return sum(part.stat().st_size for part in (file.iterdir() if file.is_dir() else [file]))
    except OSError:
        return 0


@dataclass
class _Survey:
    """What was seen of all frames: the most Gaussians, which of them change, and in which columns."""

    first: NumpyGaussians
    count: int
    moves: Bools
    columns: set[str]
    keeps_identity: bool


def _survey(source: FrameSource, done: Callable[[int], None]) -> _Survey:
    first = source.at(0)
    counts, degree = {len(first)}, first.sh.shape[1]
    moves, columns = np.zeros(len(first), bool), set()
    before, is_same = first, source.keeps_identity
    done(1)
    for frame in range(1, source.frame_count):
        gaussians = source.at(frame)
        counts.add(len(gaussians))
        degree = max(degree, gaussians.sh.shape[1])
        if len(counts) == 1 and is_same is not False:
            if is_same is None and not _same_rows(before, gaussians):
                is_same = False
            gaussians = _filled(gaussians, len(first), max(gaussians.sh.shape[1], first.sh.shape[1]))
            for name in column_names(first.sh.shape[1]):
                changed = (column_of(gaussians, name) != column_of(first, name)).any(axis=1)
                if changed.any():
                    moves |= changed
                    columns.add(name)
        before = gaussians
        done(frame + 1)
    count = max(counts)
    if len(counts) > 1 or is_same is False or degree != first.sh.shape[1]:
        return _Survey(_filled(first, count, degree), count, np.ones(count, bool), set(column_names(degree)), False)
    return _Survey(first, count, moves, columns, True)


def _same_rows(before: NumpyGaussians, after: NumpyGaussians) -> bool:
    """Whether rows are likely the same Gaussians: they move little against the distance to another row."""
    chance = np.random.default_rng(0)
    rows = chance.permutation(len(before))[:_SAMPLED]
    if len(rows) < 2:
        return True
    step = np.median(np.linalg.norm(after.means[rows] - before.means[rows], axis=1))
    apart = np.median(np.linalg.norm(before.means[rows] - before.means[np.roll(rows, 1)], axis=1))
    return bool(step <= _STEP * apart)


def _filled(gaussians: NumpyGaussians, count: int, degree: int) -> NumpyGaussians:
    """With rows that cannot be seen up to ``count``, and SH coefficients of zero up to ``degree``."""
    more, g = count - len(gaussians), gaussians
    if not more and g.sh.shape[1] == degree:
        return g
    sh = np.zeros((count, degree, 3), np.float32)
    sh[: len(g), : g.sh.shape[1]] = g.sh
    return GaussianArrays(
        np.concatenate([g.means, np.repeat(g.means[:1], more, axis=0)]),
        np.concatenate([g.quaternions, np.repeat(g.quaternions[:1], more, axis=0)]),
        np.concatenate([g.scales, np.full((more, 3), _NOWHERE, np.float32)]),
        np.concatenate([g.opacities, np.zeros(more, np.float32)]),
        sh,
    )


def _canonical(g: NumpyGaussians) -> SceneArrays:
    opacities = np.clip(g.opacities.astype(np.float64), 1e-12, _MOST_CERTAIN)
    return {
        "means": np.ascontiguousarray(g.means, np.float32),
        "quaternions": np.ascontiguousarray(g.quaternions, np.float32),
        "log_scales": np.log(np.maximum(g.scales.astype(np.float64), _THINNEST)).astype(np.float32),
        "opacity_logits": (np.log(opacities) - np.log1p(-opacities)).astype(np.float32),
        "sh": np.ascontiguousarray(g.sh, np.float32),
    }


def _moving_rows(
    source: FrameSource, seen: _Survey, rows: Array, layout: RowLayout, done: Callable[[int], None]
) -> Iterator[bytes]:
    for frame in range(source.frame_count):
        gaussians = _filled(source.at(frame), seen.count, seen.first.sh.shape[1]).part(rows)
        yield layout.packed({name: column_of(gaussians, name) for name in layout.columns})
        done(source.frame_count + frame + 1)
