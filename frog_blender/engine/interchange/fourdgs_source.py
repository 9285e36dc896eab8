"""Frames of anybody's ``.4dgs`` file: keyframes with deltas, or Gaussians that are born, move evenly and fade.

The ``fourdgs`` package decodes; it runs in a process of its own with a limit to its memory (see import_process), for a
small file may declare much.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import Array
from ..capture.camera import MAX_SIDE, Camera
from ..errors import FrogError, brief, found_instead
from ..gaussians import GaussianArrays, NumpyGaussians
from ..io.regular_file import regular_file
from ..playback.transform import transform
from ..scene.header import MAX_FRAMES, MOST_STANDING
from ..spherical_harmonics import SH_DC
from .activated import usable
from .frame_source import FrameSource
from .usd_source import SPARSE, SPARSEST, Y_UP

if TYPE_CHECKING:
    from fourdgs.keyframe_delta import State

_EXPECTED = "a .4dgs file"
_FRAMES_A_SECOND = 30.0  # of a file whose Gaussians move evenly between their births and deaths
_ROUNDED = 0.15  # of a gap between two states: by so much it may differ from whole steps
_SHORTEST = 1e-3  # seconds of a file of one state
_CODES = 255 / 8.0  # of a harmonic in [-4, 4]
_LONGEST = 1e6  # seconds


@contextmanager
def reading(path: Path) -> Iterator[None]:
    """FrogError for whatever goes wrong in the package while it reads a file."""
    from fourdgs import FourdgsError

    try:
        yield
    except FrogError:
        raise
    except FourdgsError as error:
        raise found_instead(path, f"a file that is damaged or not understood ({brief(error)})", _EXPECTED) from error
    except (ValueError, LookupError, ArithmeticError, TypeError, struct.error, zlib.error) as error:
        raise found_instead(path, f"a damaged file ({brief(repr(error))})", _EXPECTED) from error


def open_fourdgs(path: Path) -> FrameSource:
    """The frames of a ``.4dgs`` file.

    Raises:
        FrogError: for a file that is none, or is damaged, or of a kind that is not understood.
        ImportError: where there is no ``fourdgs``.
    """
    from fourdgs import opcode as op
    from fourdgs import records as rec
    from fourdgs.serialization import MAGIC, check_magic, iter_records

    content = regular_file(path, _EXPECTED).read_bytes()
    with reading(path):
        check_magic(content)
        for record in iter_records(content, len(MAGIC)):
            if record.opcode == op.HEADER:
                header = rec.Header.parse(record.content)
                break
        else:
            raise found_instead(path, "no header", _EXPECTED)
        if not 0 <= header.duration_sec <= _LONGEST:
            raise found_instead(path, f"{header.duration_sec:g} seconds", f"at most {_LONGEST:g}")
        if header.temporal_model == "keyframe-delta":
            return _Keyframes(path, content, header)
        return _Births(path, content, header)


class _Fourdgs:
    """What both kinds of files have in common."""

    origin = "4dgs"
    frame_count: int
    rate: float
    keeps_identity: bool | None

    def __init__(self, path: Path, content: bytes, header: Any) -> None:  # Any: of fourdgs, which has no types
        self._path, self._content, self._header = path, content, header
        self.left_out = 0
        self._turned = _y_is_up(content, header)
        self.cameras = tuple(_cameras(content, self._turned))

    def _made(self, means: Array, turns: Array, scales: Array, rgba: tuple[Array, Array], sh: Array) -> NumpyGaussians:
        """Gaussians with z up.

        Args:
            turns: (N, 4) x, y, z, w.
            rgba: (N, 3) and (N,) in [0, 1].
            sh: (N, 3 K) codes of the harmonics above degree 0, all of red, then green, then blue.
        """
        further = (
            (sh.reshape(len(sh), 3, -1).transpose(0, 2, 1) / _CODES - 4.0) if sh.size else np.empty((len(means), 0, 3))
        )
        colors = np.concatenate([((rgba[0] - 0.5) / SH_DC)[:, None], further], axis=1)
        made = GaussianArrays(means, np.roll(turns, 1, axis=1), scales, rgba[1], colors)
        gaussians, left_out = usable(self._path, made, keep_rows=self.frame_count > 1)
        self.left_out = max(self.left_out, left_out)
        return transform(gaussians, Y_UP) if self._turned else gaussians


class _Keyframes(_Fourdgs):
    """Populations at some times, and what changes between them: a ``FrameSource``, quickest from front to back."""

    def __init__(self, path: Path, content: bytes, header: Any) -> None:  # Any: of fourdgs, which has no types
        from fourdgs import opcode as op

        super().__init__(path, content, header)
        self._grids = _grids(content, header)
        starts: list[float] = []
        ids: Array | None = None
        windows: set[int] = set()
        self.keeps_identity = True
        for start, state, _ in self._states():
            starts.append(start)
            # Outside its window a Gaussian is in no frame, so that those behind it move up.
            windows.update(np.unique(state.bins[op.A_WINDOW_INDEX]).tolist())
            self.keeps_identity &= len(windows) <= 1 and (ids is None or np.array_equal(ids, state.ids))
            ids = state.ids
            if len(starts) > MAX_FRAMES:
                raise found_instead(path, f"more than {MAX_FRAMES:,} frames", "fewer")
        if not starts:
            raise found_instead(path, "no Gaussians", _EXPECTED)
        self._starts = np.array(starts)
        self._times, self.rate = _frame_times(path, self._starts, header.duration_sec)
        self.frame_count = len(self._times)
        self._place, self._following = -1, self._states()
        self._current: tuple[float, State, Array] | None = None

    def at(self, frame: int) -> NumpyGaussians:
        """A frame, counted from 0."""
        time = float(self._times[frame])
        wanted = max(int(np.searchsorted(self._starts, time + 1e-6, "right")) - 1, 0)
        with reading(self._path):
            if wanted < self._place:
                self._place, self._following = -1, self._states()
            while self._place < wanted:
                self._current = next(self._following)
                self._place += 1
            assert self._current is not None
            _, state, sh = self._current
            return self._gaussians(state, sh, time)

    def _gaussians(self, state: State, sh: Array, time: float) -> NumpyGaussians:
        from fourdgs.keyframe_delta_file import reconstruct_at

        found = reconstruct_at(state, self._grids, time)
        order = np.argsort(state.ids, kind="stable")
        shown = np.isin(state.ids[order], found["ids"])
        if not len(found["ids"]):
            raise found_instead(self._path, f"no Gaussians at {time:g} seconds", "some at all times")
        color = found["rgb"], found["opacity"]
        return self._made(found["centers"], found["rotations"], found["scales"], color, sh[order][shown])

    def _states(self) -> Iterator[tuple[float, State, Array]]:
        """Start, population and harmonics of each state, in order of time."""
        from fourdgs.keyframe_delta_file import scan_streamed

        start = [0.0]
        known: Array = np.empty(0, np.int64)
        codes = np.empty((0, 3 * ((self._header.sh_degree + 1) ** 2 - 1)), np.float32)

        def begins(_offset: int, t0: float, _t1: float) -> None:
            start[0] = float(t0)

        for offset, kind, state in scan_streamed(self._content, on_state=begins):
            born = self._bands(offset)
            if kind == 0:
                codes = born
            elif len(born):
                codes = np.concatenate([codes, born])
                known = np.concatenate([known, np.setdiff1d(state.ids, known)])
            if kind == 0:
                known = state.ids
            elif len(known) != state.count or not np.array_equal(known, state.ids):
                rows = _rows_of(known, state.ids)
                known, codes = state.ids, codes[rows]
            if len(codes) != state.count:
                raise found_instead(self._path, f"harmonics of {len(codes):,} Gaussians", f"{state.count:,}")
            yield start[0], state, codes

    def _bands(self, offset: int) -> Array:
        """(N, 3 K) codes of the harmonics that follow a chunk, of those Gaussians that it brings."""
        from fourdgs import opcode as op
        from fourdgs.serialization import Cursor, decode_stream, iter_records

        parts: dict[int, Array] = {}
        for place, record in enumerate(iter_records(self._content, offset)):
            if place and record.opcode != op.SH_BAND_STREAM:
                break
            if place:
                band = Cursor(record.content)
                number = band.u8()
                values = decode_stream(band)[1]
                parts[number] = values.reshape(len(values), 3, -1)
        if not parts:
            return self._without_bands(offset)
        joined = np.concatenate([parts[number] for number in sorted(parts)], axis=2)
        return joined.reshape(len(joined), -1).astype(np.float32)

    def _without_bands(self, offset: int) -> Array:
        from fourdgs import opcode as op
        from fourdgs import records as rec
        from fourdgs.serialization import iter_records

        record = next(iter(iter_records(self._content, offset)))
        if record.opcode == op.CHUNK:
            count = int(rec.parse_chunk(record.content)[0].count)
        else:
            count = int(rec.parse_delta_chunk_block(record.content)[0].birth_count)
        # A file of degree 0 has no harmonics of any of its Gaussians.
        return np.empty((min(count, len(self._content) * 256), 0), np.float32)


def _frame_times(path: Path, starts: Array, duration: float) -> tuple[Array, float]:
    """Seconds of each frame, and frames a second.

    Where the states lie in equal steps, but for some that are left out and for what was rounded, their own times are
    frames. Else frames are as close as half of the states are, or thirty a second.

    Args:
        starts: (N,) seconds at which the states begin.
    """
    if not np.isfinite(starts).all() or (np.diff(starts) < 0).any() or abs(starts).max() > _LONGEST:
        raise found_instead(path, "states that are not in the order of their times", _EXPECTED)
    own = np.unique(starts)
    gaps, hold = np.diff(own), max(duration - float(own[-1]), 0.0)
    steps = _whole_steps(gaps)
    if steps is None:
        step = min(1 / _FRAMES_A_SECOND, float(np.median(gaps)))
        places = (own - own[0]) / step
        if places[-1] > SPARSEST * len(own):
            expected = f"at most {SPARSEST} for each of its {len(own):,} states"
            raise found_instead(path, f"{round(places[-1]):,} frames", expected)
    else:
        step = float(own[-1] - own[0]) / steps.sum() if len(gaps) else hold if hold > _SHORTEST else 1.0
        parts = max(math.ceil(step - 1e-6), 1)  # a frame each second at least: Gaussians move between states
        step /= parts
        places = np.append(0.0, np.cumsum(steps * parts))
    count = max(math.ceil(places[-1] - 1e-6) + (max(round(hold / step), 1) if hold else 0), 1)
    if count > MAX_FRAMES:
        raise found_instead(path, f"{count:,} frames", f"at most {MAX_FRAMES:,}")
    frames = np.arange(count)
    times: Array = np.interp(frames, places, own) + np.maximum(frames - places[-1], 0) * step
    return times, round(1 / step, 6)  # times are decimal fractions


def _whole_steps(gaps: Array) -> Array | None:
    """(N,) how many equal steps each gap is; None where they are none."""
    for step in (np.median(gaps), gaps.min()) if len(gaps) else ():
        steps: Array = np.rint(gaps / step)
        fit = steps.min() >= 1 and (np.abs(gaps - steps * step) <= _ROUNDED * gaps).all()
        if fit and steps.sum() <= SPARSE * (len(gaps) + 1):
            return steps
    return None if len(gaps) else gaps


def _rows_of(known: Array, wanted: Array) -> Array:
    """(N,) where each of ``wanted`` stands in ``known``; LookupError where one does not."""
    order = np.argsort(known, kind="stable")
    places = np.searchsorted(known[order], wanted).clip(0, max(len(known) - 1, 0))
    rows: Array = order[places]
    if not np.array_equal(known[rows], wanted):
        raise LookupError("Gaussians that no chunk brought")
    return rows


class _Births(_Fourdgs):
    """Gaussians with a birth, a velocity and a fading: a ``FrameSource`` in steps of a thirtieth of a second."""

    def __init__(self, path: Path, content: bytes, header: Any) -> None:  # Any: of fourdgs, which has no types
        super().__init__(path, content, header)
        from fourdgs import read

        self._set = read(content).gaussians
        if not self._set.count:
            raise found_instead(path, "no Gaussians", _EXPECTED)
        self.rate = _FRAMES_A_SECOND
        self.frame_count = max(1, round(header.duration_sec * self.rate))
        if self.frame_count > MAX_FRAMES:
            raise found_instead(path, f"{self.frame_count:,} frames", f"at most {MAX_FRAMES:,}")
        self.keeps_identity = True

    def at(self, frame: int) -> NumpyGaussians:
        """A frame, counted from 0."""
        time, g = frame / self.rate, self._set
        since = time - g.mu_t.astype(np.float64)
        sigma = np.maximum(g.sigma_t.astype(np.float64), 1e-30)
        with np.errstate(over="ignore", invalid="ignore"):
            share = np.where(np.isfinite(sigma), np.exp(-0.5 * np.square(since / sigma)), 1.0)
            means = g.positions.astype(np.float64) + g.motions.astype(np.float64) * since[:, None]
        lives = (g.win_lo <= time) & (time < g.win_hi) & (share >= self._header.cutoff)
        means = np.where(lives[:, None], means, g.positions)  # what is not there has no place to fly to
        opacities = np.where(lives, g.colors[:, 3] * share, 0)
        sh = np.empty((g.count, 0)) if g.sh is None else g.sh.astype(np.float32)
        with reading(self._path):
            return self._made(means, g.rotations, g.scales, (g.colors[:, :3], opacities), sh)


def _grids(content: bytes, header: Any) -> Any:  # Any: of fourdgs, which has no types
    from fourdgs import opcode as op
    from fourdgs import records as rec
    from fourdgs.keyframe_delta_file import Grids
    from fourdgs.serialization import MAGIC, iter_records
    from fourdgs.stream_reader import steps_from

    found: dict[int, Any] = {}
    for record in iter_records(content, len(MAGIC)):
        if record.opcode in (op.QUANTIZATION, op.WINDOW_TABLE):
            found[record.opcode] = record.content
        elif record.opcode in (op.CHUNK, op.DELTA_CHUNK):
            break
    if len(found) < 2:
        raise LookupError("no Quantization or Window Table record before the first chunk")
    quantization = rec.Quantization.parse(found[op.QUANTIZATION])
    windows = rec.WindowTable.parse(found[op.WINDOW_TABLE]).windows
    origin = np.asarray(quantization.pos_origin, np.float64)
    return Grids(steps_from(quantization), None, origin, list(windows), header.cutoff)


def _y_is_up(content: bytes, header: Any) -> bool:  # Any: of fourdgs, which has no types
    from fourdgs import opcode as op
    from fourdgs import records as rec
    from fourdgs.serialization import MAGIC, iter_records

    for record in iter_records(content, len(MAGIC)):
        if record.opcode == op.COORDINATE_FRAME:
            return bool(rec.CoordinateFrame.parse(record.content).up_axis == 1)
        if record.opcode in (op.CHUNK, op.DELTA_CHUNK):
            break
    return str(header.attributes.get("coordinate_system", "")).startswith("y-up")


def _cameras(content: bytes, turned: bool) -> Iterator[Camera]:
    """The pinhole cameras among the sensors, with z up."""
    from fourdgs import opcode as op
    from fourdgs import records as rec
    from fourdgs.serialization import MAGIC, iter_records

    found: list[Camera] = []
    for record in iter_records(content, len(MAGIC)):
        if record.opcode in (op.CHUNK, op.DELTA_CHUNK) or len(found) >= MOST_STANDING:
            break
        if record.opcode != op.SENSOR_CALIBRATION:
            continue
        sensor = rec.SensorCalibration.parse(record.content)
        fits = sensor.camera_model == 1 and sensor.pose_reference == rec.POSE_TO_SCENE
        fits &= 0 < sensor.width_px <= MAX_SIDE and 0 < sensor.height_px <= MAX_SIDE
        if fits and sensor.name not in {camera.name for camera in found}:
            found.append(_camera(sensor, turned))
    for camera in found:
        try:
            yield Camera.from_json(camera.to_json())
        except ValueError:  # numbers that no camera has
            continue


def _camera(sensor: Any, turned: bool) -> Camera:  # Any: of fourdgs, which has no types
    x, y, z, w = np.asarray(sensor.rotation, np.float64) / np.linalg.norm(sensor.rotation)
    to_scene = np.eye(4)
    to_scene[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    to_scene[:3, 3] = sensor.translation
    k = np.array([[sensor.fx, 0, sensor.cx], [0, sensor.fy, sensor.cy], [0, 0, 1.0]])
    camera = Camera(sensor.name, sensor.width_px, sensor.height_px, k, np.eye(4))
    return replace(camera, world_to_camera=np.linalg.inv(Y_UP @ to_scene if turned else to_scene))
