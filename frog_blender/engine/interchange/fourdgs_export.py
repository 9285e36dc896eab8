"""``.4dgs`` files (4dgs.dev): keyframes, and between them what changed, by the ``fourdgs`` package.

Its own writer of sequences knows neither spherical harmonics nor cameras and sound, and holds every frame at once. So
the records are put together here, of its encoders: two frames are held. The format's limits: colours along no direction
are cut to [0, 1], further harmonics to [-4, 4] in 8 bits, and these do not change between two keyframes.
"""

from __future__ import annotations

from collections.abc import Generator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

import numpy as np

from ..arrays import Array
from ..capture.camera import Camera
from ..errors import FrogError
from ..gaussians import NumpyGaussians
from ..io.atomic_files import atomic_file
from ..playback.transform import quaternion_of, transform
from ..spherical_harmonics import SH_DC
from .take import Take, TakeFrame, duration_of
from .take_sound import encoded

if TYPE_CHECKING:
    from fourdgs.keyframe_delta_file import Grids
    from fourdgs.quantization import Steps

COLOR_SPACE = "srgb-rec709-display"
_LIBRARY = "frog_blender"
_PROFILE = "fine"
_KEYFRAMES_EACH = 1.0  # seconds: as long as a player may have to read after a jump
_CUTOFF = 0.05
_MOST_BINS = 2**30  # of a position's axis: streams hold 32 bits
_SH_LOW, _SH_SPAN = -4.0, 8.0
_BANDS = {1: slice(1, 4), 2: slice(4, 9), 3: slice(9, 16)}


def write_fourdgs(path: Path, take: Take) -> Generator[int, None, None]:
    """Writes a take as a ``.4dgs`` file; yields how many frames are done. The file appears when all are.

    The frames are gone through twice: the grid on which places lie is that of all of them.

    Raises:
        FrogError: for another ending, Gaussians that cannot be placed, sound that cannot be read, or a file that cannot
            be written.
        ImportError: where there is no ``fourdgs``.
    """
    import fourdgs  # noqa: F401

    if path.suffix.lower() != ".4dgs":
        raise FrogError(f"{path}: found the ending {path.suffix!r}, expected .4dgs.")
    survey = None
    for frame in take.frames():
        survey = _Survey.of(_placed(frame), survey)
        yield 0
    assert survey is not None
    sound = None if take.sound is None else encoded(take.sound, duration_of(take))
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        with atomic_file(path) as file:
            writer = _Writer(file, take, survey)
            writer.begin(sound)
            for done, frame in enumerate(take.frames(), 1):
                writer.add(frame, _placed(frame))
                yield done
            writer.end()
    except OSError as error:
        raise FrogError(f"{path}: could not be written ({error.strerror or error}); nothing was changed.") from error


def _placed(frame: TakeFrame) -> NumpyGaussians:
    return frame.gaussians if frame.placement is None else transform(frame.gaussians, frame.placement)


@dataclass(frozen=True)
class _Survey:
    """Of all frames.

    Attributes:
        low, high: (3,) the box around all means.
        median_scale: of the first frame.
        count, degree: Gaussians, and degree of their colours.
    """

    low: Array
    high: Array
    median_scale: float
    count: int
    degree: int

    @classmethod
    def of(cls, gaussians: NumpyGaussians, before: _Survey | None) -> _Survey:
        low, high = (bound.astype(np.float64) for bound in (gaussians.means.min(0), gaussians.means.max(0)))
        if before is None:
            return cls(low, high, float(np.median(gaussians.scales)), len(gaussians), gaussians.sh_degree)
        low, high = np.minimum(low, before.low), np.maximum(high, before.high)
        return cls(low, high, before.median_scale, before.count, before.degree)


class _Writer:
    """Puts the records of a file one after the other."""

    def __init__(self, file: BinaryIO, take: Take, survey: _Survey) -> None:
        from fourdgs.keyframe_delta_file import Grids
        from fourdgs.quantization import Bounds, Steps

        self._file, self._take, self._survey, self._at = file, take, survey, 0
        self._duration = duration_of(take)
        bounds = Bounds.for_profile(_PROFILE, median_scale=max(survey.median_scale, 1e-9))
        bounds.pos = max(bounds.pos, float((survey.high - survey.low).max()) / _MOST_BINS)
        self._steps: Steps = Steps.of(bounds)
        windows = [(0.0, self._duration)]
        self._grids: Grids = Grids(self._steps, bounds, survey.low, windows, _CUTOFF)
        self._index: list[Any] = []  # Any: records of fourdgs, which has no types
        self._before: dict[int, Array] = {}
        self._keyframe = self._last = self._depth = 0
        self._number = 0

    def begin(self, sound: bytes | None) -> None:
        """Writes what comes before the Gaussians."""
        from fourdgs import records as rec
        from fourdgs.serialization import MAGIC

        survey, steps, bounds = self._survey, self._steps, self._grids.bounds
        self._put(MAGIC)
        self._put(
            rec.Header(
                duration_sec=self._duration,
                gaussian_count=survey.count,
                aabb=[*survey.low.tolist(), *survey.high.tolist()],
                profile="",
                library=_LIBRARY,
                temporal_model="keyframe-delta",
                cutoff=_CUTOFF,
                sh_degree=survey.degree,
                flags=rec.FLAG_HAS_AUDIO if sound is not None else 0,
                attributes={"color_space": COLOR_SPACE, "coordinate_system": "z-up-right-handed"},
            ).encode()
        )
        self._put(
            rec.Quantization(
                scheme="uniform-v1",
                pos_origin=survey.low.tolist(),
                step_pos=steps.pos,
                step_scale_log=steps.scale_log,
                step_rot=steps.rot,
                step_rgb=steps.rgb,
                step_alpha=steps.alpha,
                step_motion=steps.motion,
                step_time=steps.time,
                step_sigma_log=steps.sigma_log,
                step_sh=steps.sh,
                bounds=bounds.as_strings(),
            ).encode()
        )
        self._put(rec.WindowTable(windows=list(self._grids.windows)).encode())
        if sound is not None:
            self._put_sound(sound)
        self._put_cameras()

    def _put_sound(self, sound: bytes) -> None:
        from fourdgs import records as rec

        source = rec.AudioSource(
            source_id=0,
            name="sound",
            codec="opus",
            channel_layout="stereo",
            data_length=len(sound),
            start_sec=0.0,
            duration_sec=self._duration,
            gain=1.0,
            flags=0,  # heard from everywhere alike, once
            position=[0.0, 0.0, 0.0],
            rotation=[0.0, 0.0, 0.0, 1.0],
            keyframes=[],
            interpolation="linear",
        )
        self._put(source.encode())
        self._put(rec.AudioData(source_id=0, data=sound).encode())

    def _put_cameras(self) -> None:
        """The capture's cameras as sensors, where they stand still: provenance, not a way to look."""
        from fourdgs import records as rec

        header = self._take.header
        frame = rec.CoordinateFrame(name="scene", handedness=1, up_axis=2, forward_axis=1)
        frame.check()
        self._put(frame.encode())
        if not header.is_moving:
            taken: set[str] = set()
            for camera in header.cameras:
                name, number = camera.name, 1
                while name in taken:
                    number += 1
                    name = f"{camera.name}_{number}"
                taken.add(name)
                sensor = _sensor(camera, name)
                sensor.check()
                self._put(sensor.encode())

    def add(self, frame: TakeFrame, gaussians: NumpyGaussians) -> None:
        """Writes a frame: all of it where a keyframe is due, else what changed since the frame before."""
        from fourdgs import records as rec

        numbers, rate = self._take.numbers, self._take.rate
        start = float((frame.number - numbers[0]) / rate)
        self._number += 1
        end = float((numbers[self._number] - numbers[0]) / rate) if self._number < len(numbers) else self._duration
        bins = self._bins(gaussians, start)
        due = not self._index or start - self._index[self._keyframe_entry].t0 >= _KEYFRAMES_EACH - 0.5 / rate
        entry = self._keyframe_chunk(bins, start, end) if due else self._delta_chunk(bins, start, end)
        if due:
            self._keyframe_entry = len(self._index)
            entry.bands = self._put_bands(gaussians)
        assert isinstance(entry, rec.ChunkIndexEntry)
        self._index.append(entry)

    _keyframe_entry = 0

    def _keyframe_chunk(self, bins: dict[int, Array], start: float, end: float) -> Any:  # of fourdgs, without types
        from fourdgs import opcode as op
        from fourdgs import records as rec
        from fourdgs.keyframe_delta_writer import encode_delta_streams
        from fourdgs.serialization import CODEC_DEFLATE

        ids, count = np.arange(self._survey.count), self._survey.count
        streams = encode_delta_streams(
            ids, {name: bins[name] for name in op.REQUIRED_ATTRIBUTES}, codec=CODEC_DEFLATE, level=6
        )
        blob = rec.encode_chunk(start, end, 0, count, streams)
        at = self._keyframe = self._last = self._put(blob)
        self._depth, self._before = 0, bins
        return rec.ChunkIndexEntry(
            t0=start,
            t1=end,
            chunk_offset=at,
            chunk_length=len(blob),
            gaussian_count=count,
            extended=True,
            kind=0,
            keyframe_offset=at,
            live_count=count,
        )

    def _delta_chunk(self, bins: dict[int, Array], start: float, end: float) -> Any:  # of fourdgs, without types
        from fourdgs import opcode as op
        from fourdgs import records as rec
        from fourdgs.keyframe_delta_writer import delta_groups, encode_delta_streams
        from fourdgs.serialization import CODEC_DEFLATE

        ids = np.arange(self._survey.count)
        bins = bins | {op.A_MU_T: self._before[op.A_MU_T]}  # nothing moves within a frame: where it starts is no matter
        updated, changes, *_ = delta_groups(ids, self._before, ids, bins)
        updates = encode_delta_streams(updated, changes, codec=CODEC_DEFLATE, level=6)
        self._depth += 1
        blob = rec.encode_delta_chunk(
            start,
            end,
            level=0,
            delta_mode=rec.DELTA_MODE_CHAINED,
            reference_offset=self._last,
            keyframe_offset=self._keyframe,
            depth=self._depth,
            updates=updates,
            births=b"",
            deaths=b"",
            counts=(len(updated), 0, 0),
        )
        reference, at = self._last, self._put(blob)
        self._last, self._before = at, bins
        return rec.ChunkIndexEntry(
            t0=start,
            t1=end,
            chunk_offset=at,
            chunk_length=len(blob),
            gaussian_count=len(updated),
            extended=True,
            kind=1,
            delta_mode=rec.DELTA_MODE_CHAINED,
            reference_offset=reference,
            keyframe_offset=self._keyframe,
            depth=self._depth,
            live_count=self._survey.count,
        )

    def _put_bands(self, gaussians: NumpyGaussians) -> list[tuple[int, int, int]]:
        """Harmonics of each degree from 1 on, all of red, then green, then blue."""
        from fourdgs import opcode as op
        from fourdgs.serialization import CODEC_DEFLATE, encode_stream, put_record, put_u8

        bands = []
        for band in range(1, self._survey.degree + 1):
            part = gaussians.sh[:, _BANDS[band]].transpose(0, 2, 1).reshape(len(gaussians), -1)
            codes = np.rint((part.astype(np.float64) - _SH_LOW) * (255 / _SH_SPAN)).clip(0, 255).astype(np.int64)
            stream = encode_stream(op.SH_BAND_STREAM, codes, channels=codes.shape[1], codec=CODEC_DEFLATE, level=6)
            blob = put_record(op.SH_BAND_STREAM, put_u8(band) + stream)
            bands.append((band, self._put(blob), len(blob)))
        return bands

    def _bins(self, gaussians: NumpyGaussians, start: float) -> dict[int, Array]:
        from fourdgs import opcode as op
        from fourdgs.quantization import quantize, quantize_rotation, rct_forward

        count, steps = len(gaussians), self._steps
        column = np.zeros((count, 1), np.int64)
        turns = np.roll(gaussians.quaternions, -1, axis=1)
        largest, rest = quantize_rotation(turns, steps.rot)
        rgb = (0.5 + SH_DC * gaussians.sh[:, 0].astype(np.float64)).clip(0, 1)
        scales = np.log(np.maximum(gaussians.scales.astype(np.float64), 1e-30))
        always = np.ones(count, bool)
        mu_step = self._grids.mu_step(column[:, 0], always)
        return {
            op.A_POSITION: quantize(gaussians.means, steps.pos, self._survey.low),
            op.A_SCALE: quantize(scales, steps.scale_log),
            op.A_ROTATION_INDEX: largest.reshape(-1, 1),
            op.A_ROTATION: rest,
            op.A_COLOR: rct_forward(quantize(rgb, steps.rgb)),
            op.A_OPACITY: quantize(gaussians.opacities.clip(0, 1), steps.alpha).reshape(-1, 1),
            op.A_MOTION: np.zeros((count, 3), np.int64),
            op.A_MU_T: np.rint(start / mu_step).astype(np.int64).reshape(-1, 1),
            op.A_SIGMA_T: column,
            op.A_FLAGS: np.full((count, 1), op.FLAG_NEVER_FADES, np.int64),
            op.A_WINDOW_INDEX: column,
        }

    def end(self) -> None:
        """Writes the index, and what says where it begins."""
        from fourdgs import records as rec
        from fourdgs.serialization import MAGIC, crc32

        survey = self._survey
        statistics = rec.Statistics(
            gaussian_count=survey.count,
            chunk_count=len(self._index),
            duration_sec=self._duration,
            aabb=[*survey.low.tolist(), *survey.high.tolist()],
        )
        summary = b"".join(entry.encode() for entry in self._index) + statistics.encode()
        start = self._put(summary)
        self._put(rec.Footer(summary_start=start, summary_offset_start=0, summary_crc=crc32(summary)).encode())
        self._put(MAGIC)

    def _put(self, blob: bytes) -> int:
        """Writes bytes; returns where they begin."""
        at, self._at = self._at, self._at + len(blob)
        self._file.write(blob)
        return at


def _sensor(camera: Camera, name: str) -> Any:  # of fourdgs, without types
    from fourdgs import records as rec

    k = camera.intrinsics
    w, x, y, z = quaternion_of(camera.rotation.T)
    return rec.SensorCalibration(
        name=name,
        modality="camera",
        camera_model=1,  # a pinhole
        width_px=camera.width,
        height_px=camera.height,
        fx=float(k[0, 0]),
        fy=float(k[1, 1]),
        cx=float(k[0, 2]),
        cy=float(k[1, 2]),
        rotation=[float(value) for value in (x, y, z, w)],
        translation=[float(value) for value in camera.center],
    )
