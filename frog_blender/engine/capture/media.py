"""What films and photographs say of themselves, by PyAV and Pillow; the images of films and EXR; of sound, the samples.

Both libraries are imported when a file is asked, so that whoever plays a scene needs neither. What they return was
written by strangers: it is taken with its kind and range checked, or not at all.
"""

import os
import warnings
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from datetime import datetime
from io import BytesIO
from itertools import chain
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..arrays import Float32s, Float64s, ImageArray
from ..errors import FrogError, found_instead, printable, reason
from ..io.regular_file import regular_file, utf8_name
from ..optional_imports import importing
from .capture import MAX_FRAMES
from .film_frames import decoded, filtered, seen, to_rgb

_LATEST = 1e8  # seconds: no film starts three years late
_USUAL_RATE, _SLOWEST, _FASTEST = 30.0, 0.1, 1000.0  # frames a second
_LONGEST_TAG, _MOST_TAGS = 200, 500
_TRANSFERS = {16: "pq", 18: "hlg"}  # ISO/IEC 23091-2
_PROGRESSIVE = 1  # of FFmpeg's field orders; 0 is unknown
_FIELD_ORDERS = ("auto", "auto", "tff", "bff", "bff", "tff")  # by FFmpeg's numbers, the field that is shown first
_SQUARE = 0.01  # encoders that round a film's size call its pixels narrower by less
_LONGEST_PIXEL = 4.0  # sides of a pixel; anamorphic lenses reach 2
_NO_TIMES, _ANY_START = 0x80, 0x200  # FFmpeg's marks of containers: without time stamps, or whose stamps start anywhere
_SEEK_MARGIN = 10.0  # seconds before what is heard, where decoding begins
_LISTS = (b"#EXTM3U", b"ffconcat", b"<", b"v=0")
"""How files begin in which FFmpeg finds the names of others: HLS, concatenations, DASH and IMF, sessions."""
_PIECE = 4096  # samples that are resampled at once
_MOST_SILENCE = 3600  # seconds before a track that starts later

EXR = ".exr"
UPRIGHT = 1
"""EXIF's orientation of an image that is shown as it is stored."""
_PHOTO_FORMATS = ("JPEG", "PNG", "WEBP")  # whose orientation is obeyed
_ORIENTATION, _MAKE, _MODEL, _DETAILS, _FOCAL_LENGTH_35MM = 0x0112, 0x010F, 0x0110, 0x8769, 0xA405
_TAKEN, _PART_OF_SECOND = 0x9003, 0x9291


@dataclass(frozen=True, eq=False)
class FilmHeader:
    """What a film's file says of its first film.

    Attributes:
        transfer: "hlg" or "pq" for high dynamic range; "" for every other curve and where nothing says it.
        fields: where each image is two fields, of different times, which of them is the first: "tff" (the top one),
            "bff" or "auto" (as each image says); "" for whole images, however they are marked.
        aspect: of its pixels, width over height.
        tracks: films in it; that of a camera with two lenses has two.
        rate: frames a second, their mean; 30 where nothing sensible says it.
        is_untimed: the file holds no times and no rate, as raw streams do.
        duration: seconds; 0 where nothing says it.
        tags: by lower-case name, the file's before its tracks': "make", "timecode", "creation_time".
        times: (N,) float64 ascending seconds, from the file's start, of the frames that a player shows; None where
            they were not asked for, or the file has no times.
    """

    transfer: str = ""
    fields: str = ""
    aspect: float = 1.0
    tracks: int = 1
    rate: float = _USUAL_RATE
    is_untimed: bool = False
    duration: float = 0.0
    tags: Mapping[str, str] = field(default_factory=dict)
    times: Float64s | None = None


@dataclass(frozen=True)
class Photograph:
    """What an image file says.

    Attributes:
        size: (width, height) as stored.
        orientation: EXIF's, 1 to 8.
        has_alpha: it has an alpha channel.
        camera: make, model and 35 mm equivalent of the focal length, those that are said.
        time: when it was taken, in seconds by the camera's clock; None where that is not said.
    """

    size: tuple[int, int]
    orientation: int = UPRIGHT
    has_alpha: bool = False
    camera: tuple[str, ...] = ()
    time: float | None = None


def _load_av() -> Any:  # its types need numpy's and FFmpeg's own
    """PyAV with its log turned off; FrogError where it is not installed or cannot be loaded."""
    with importing("av", "Films and sound need PyAV: pip install av."):
        import av
        import av.logging
    av.logging.set_level(None)
    return av


def _film_path(path: Path) -> str:
    """A film's whole path as FFmpeg takes it.

    Raises:
        FrogError: if it is no file, an empty one, or one whose name is not UTF-8.
    """
    regular_file(path, "a video")
    if path.stat().st_size == 0:
        raise found_instead(path, "an empty file", "a video")
    with suppress(OSError), path.open("rb") as file:  # FFmpeg says what is wrong with a file that cannot be read
        if file.read(9).startswith(_LISTS):
            raise found_instead(path, "a list of other files, which may lie on other computers", "a video")
    # From the root, or what stands before a colon in a name is taken for a protocol.
    return utf8_name(os.path.abspath(path))


@contextmanager
def _opened(path: Path, expected: str, **how: Any) -> Iterator[Any]:  # an av.container.InputContainer
    """A file whose errors become FrogErrors, and which reaches no other file; ``how`` is for ``av.open``."""
    av = _load_av()
    how["options"] = {**how.get("options", {}), "protocol_whitelist": "file"}
    # Before version 19, which replaces them by itself, letters of a tag that are not UTF-8 were an error.
    lenient = {} if int(av.__version__.split(".")[0]) >= 19 else {"metadata_errors": "replace"}
    try:
        with av.open(f"file:{_film_path(path)}", **how, **lenient) as container:
            yield container
    except (av.error.FFmpegError, ValueError, MemoryError) as error:
        found = f"a file that cannot be decoded ({getattr(error, 'strerror', None) or reason(error)})"
        raise found_instead(path, found, f"{expected} (is it damaged or cut off?)") from error


def read_film_header(path: Path, *, with_times: bool = False) -> FilmHeader:
    """Its header; ``with_times`` reads the file through. A few images are decoded where fields are marked.

    Raises:
        FrogError: if the file is missing or no film, PyAV is, or it ends long before its header says.
    """
    av = _load_av()
    with _opened(path, "a complete video") as container:
        stream = next(iter(container.streams.video), None)
        if stream is None or stream.codec_context is None:
            raise found_instead(path, "a file that cannot be decoded", "a complete video (is it damaged or cut off?)")
        codec = stream.codec_context
        return FilmHeader(
            transfer=_TRANSFERS.get(codec.color_trc, ""),
            fields="" if codec.field_order == _PROGRESSIVE else _fields(path),
            aspect=_aspect(stream),
            rate=rate if _SLOWEST <= (rate := float(stream.guessed_rate or 0)) <= _FASTEST else _USUAL_RATE,
            tracks=sum(not other.disposition & other.disposition.attached_pic for other in container.streams.video),
            is_untimed=bool(container.format.flags & _NO_TIMES),
            duration=(container.duration or 0) / av.time_base,
            tags=_tags(container),
            times=_times(path, container, stream) if with_times else None,
        )


def _aspect(stream: Any) -> float:
    """Of its pixels, as players obey it; 1 where it is absurd or nothing but rounding."""
    aspect = float(stream.sample_aspect_ratio or 1)
    return aspect if 1 / _LONGEST_PIXEL <= aspect <= _LONGEST_PIXEL and abs(aspect - 1) > _SQUARE else 1.0


def _fields(path: Path) -> str:
    """``FilmHeader.fields``: as the images show where they are marked, and as they are marked where nothing moves."""
    with _opened(path, "a complete video") as container:
        stream = container.streams.video[0]
        marked = stream.codec_context.field_order
        first = next(decoded(container, stream), None)
        if first is None or not first.interlaced_frame:
            return ""
    shown = watch(path)[0]
    return _FIELD_ORDERS[marked] if shown == "unknown" else shown


def watch(path: Path) -> tuple[str, float]:
    """What a film's first images show, see ``film_frames.seen``; FrogError if it cannot be decoded."""
    with _opened(path, "a complete video") as container:
        return seen(container, container.streams.video[0])


@contextmanager
def opened_film(path: Path, header: FilmHeader) -> Iterator[tuple[Iterator[Any], Callable[[Any], ImageArray]]]:
    """A film's frames (``av.VideoFrame``), of two fields each as it was at the time of its first field, and what makes
    (H, W, 3) uint8 RGB of one, in the colours that the file says.

    FrogError, in the block too, if it cannot be decoded.
    """
    with _opened(path, "a complete video") as container:
        stream = container.streams.video[0]
        stream.thread_type = "AUTO"
        options = f"mode=send_frame:parity={header.fields}"
        frames = filtered(container, stream, "bwdif", options) if header.fields else decoded(container, stream)
        yield frames, to_rgb(stream, "bt2020" if header.transfer else "auto")


def read_exr(path: Path, most: int) -> Float32s:
    """(H, W, 3 or 4) linear light of an EXR file, of at most so many pixels, with its alpha where it has one.

    Raises:
        FrogError: if it is none, has other channels, or more pixels.
    """
    limits = [{"max_pixels": str(most)}]
    with _opened(path, "an image", format="exr_pipe", stream_options=limits) as container:
        frame = next(decoded(container, container.streams.video[0]), None)
        if frame is None or not frame.format.name.startswith("gbr"):
            raise found_instead(path, "an EXR without the channels R, G and B", "an image of a single layer")
        kind = np.dtype("<f2" if "f16" in frame.format.name else "<f4")
        planes = [np.frombuffer(plane, kind).reshape(frame.height, -1)[:, : frame.width] for plane in frame.planes]
        return np.stack([planes[2], *planes[:2], *planes[3:]], axis=-1, dtype=np.float32)  # they lie as G, B, R and A


def _tags(container: Any) -> dict[str, str]:
    tags: dict[str, str] = {}
    for said in (container.metadata, *(stream.metadata for stream in container.streams)):
        for name, value in list(said.items())[:_MOST_TAGS]:
            tags.setdefault(printable(name)[:_LONGEST_TAG].lower(), printable(value)[:_LONGEST_TAG].strip())
    return tags


def _times(path: Path, container: Any, stream: Any) -> Float64s | None:
    """Seconds of the frames that the file's edit list shows, by the packets that hold them."""
    shown: list[tuple[int, int]] = []  # when, and where in the file
    packets = 0
    for packet in container.demux(stream):
        packets += packet.dts is not None or packet.size > 0  # AVI has empty ones for frames that were dropped
        if packets > MAX_FRAMES:
            raise found_instead(path, f"more than {MAX_FRAMES:,} frames", "fewer: cut the video")
        if packet.size and packet.pts is not None and not packet.is_discard:
            shown.append((packet.pts, packet.pos))
    if packets < stream.frames - may_miss(stream.frames):
        raise truncated(path, packets, stream.frames)
    if not shown:
        return None
    times: Float64s = np.array([stamp for stamp, _ in shown], np.float64) * float(stream.time_base)
    times.sort()
    if abs(times[0]) > _LATEST or abs(times[-1]) > _LATEST:
        raise found_instead(path, f"a frame at {abs(times).max():,.0f} seconds", "times of a film")
    if container.format.name == "avi":  # which has no start: FFmpeg counts from the first frame that is decoded
        times -= times[0]
    elif container.format.flags & _ANY_START:
        times -= _origin(container)
    elif len(times) > 1 and len(shown) < packets:
        late = _start(path, min(shown)[1]) - times[0]
        times += late if 0 < late < times[1] - times[0] else 0.0
    return times


def _origin(container: Any) -> float:
    """Seconds at which a container whose stamps start anywhere starts; 0 for all others."""
    start = container.start_time if container.format.flags & _ANY_START else None
    return (start or 0) / float(_load_av().time_base)


def _start(path: Path, position: int) -> float:
    """Seconds at which the frame at a position in the file is shown, as its edit list says.

    FFmpeg shows the first frame of an edit at its begin, even where that is a part of a frame earlier.
    """
    with _opened(path, "a complete video", options={"advanced_editlist": "0"}) as container:
        stream = container.streams.video[0]
        stamps = (packet.pts for packet in container.demux(stream) if packet.size and packet.pos == position)
        stamp = next(stamps, None)
        return float("nan") if stamp is None else float(stamp * stream.time_base)


def may_miss(frames: int) -> int:
    """By how many frames headers may be wrong, because of edit lists and codecs that drop the last frame."""
    return max(2, frames // 50)


def truncated(path: Path, decoded: int, expected: int) -> FrogError:
    """The error for a video that has fewer frames than its header says."""
    return FrogError(
        f"{path}: {decoded} frames could be decoded, expected {expected}: "
        "the video is cut off or damaged; copy it again or trim it."
    )


def has_sound(path: Path) -> bool:
    """Whether a film or a file of sound has a track of it; False for what is neither. FrogError without PyAV."""
    _load_av()
    try:
        with _opened(path, "a film") as container:
            return bool(container.streams.audio)
    except FrogError:
        return False


def read_sound(path: Path, rate: int, channels: int, start: float, seconds: float) -> NDArray[np.int16] | None:
    """A part of a film's sound; None where it has no track of it.

    Args:
        rate: samples a second.
        channels: 1 or 2, to which the track's own are mixed.
        start: second of the film, counted as its images' are, at which the part begins; not negative.
        seconds: its length at most.

    Returns:
        (S, channels), fewer samples than asked for where the film ends before, and none where it ends before ``start``.
        Where the track starts later, or has a gap, there is silence.

    Raises:
        FrogError: if the file cannot be read.
    """
    with _opened(path, "a film with sound") as container:
        if not container.streams.audio:
            return None
        if container.streams.best("audio") is None:
            raise found_instead(path, "sound that cannot be decoded", "a film with sound")
        return _samples(container, rate, channels, start, seconds)


def read_sound_file(content: bytes, rate: int, channels: int) -> NDArray[np.int16]:
    """(S, channels) of the content of a sound file that was made here."""
    with _load_av().open(BytesIO(content)) as container:
        return _samples(container, rate, channels, 0.0, float("inf"))


def encoded_sound(samples: NDArray[np.int16], rate: int, bits_a_second: int) -> bytes:
    """(S, 2) samples as Opus in Ogg, the same bytes whenever it is written."""
    av, content = _load_av(), BytesIO()
    with av.open(content, "w", format="ogg") as container:
        container.flags |= av.container.Flags.bitexact.value  # else each file has a serial number of its own
        stream = container.add_stream("libopus", rate=rate, layout="stereo", bit_rate=bits_a_second)
        given = samples if len(samples) else np.zeros((1, 2), np.int16)
        frame = av.AudioFrame.from_ndarray(np.ascontiguousarray(given).reshape(1, -1), "s16", "stereo")
        frame.sample_rate, frame.pts = rate, 0
        for part in (frame, None):
            container.mux(stream.encode(part))
    return content.getvalue()


def _samples(container: Any, rate: int, channels: int, start: float, seconds: float) -> NDArray[np.int16]:
    av, stream = _load_av(), container.streams.best("audio")
    start += _origin(container)
    if start > _SEEK_MARGIN:
        container.seek(int((start - _SEEK_MARGIN) * av.time_base))
    layout = {1: "mono", 2: "stereo"}[channels]
    steady = {"sample_rate": str(rate), "async": "1"}  # gaps in the track are filled, and samples that overlap dropped
    resampler = av.AudioResampler("s16p", layout, rate, frame_size=_PIECE, options=steady)
    pieces: list[NDArray[np.int16]] = [np.zeros((0, channels), np.int16)]
    count, most = 0, seconds * rate
    for frame in chain(decoded(container, stream), [None]):
        for piece in resampler.resample(frame):
            values = piece.to_ndarray().T
            if len(pieces) == 1:  # samples count from the film's time 0: silence before a track that starts later
                late = 0 if piece.pts is None else round(float(piece.pts * piece.time_base - start) * rate)
                pieces.append(np.zeros((min(max(late, 0), _MOST_SILENCE * rate), channels), np.int16))
                count = min(late, 0) + len(pieces[1])
            pieces.append(values[max(-count, 0) :])
            count += len(values)
        if count >= most:
            break
    whole = np.concatenate(pieces)
    return whole if count <= most else whole[: round(most)]


def _exr_header(path: Path) -> Photograph | None:
    with suppress(FrogError), _opened(path, "an image", format="exr_pipe") as container:
        codec = container.streams.video[0].codec_context
        if codec.width and codec.height:
            return Photograph((codec.width, codec.height), has_alpha=str(codec.pix_fmt).startswith("gbra"))
    return None


def read_photograph(path: Path, content: bytes | None = None) -> Photograph | None:
    """What a JPEG, PNG, WebP or EXR says; None for other formats, and for damaged headers.

    Args:
        content: of the file, where it has been read.

    Raises:
        FrogError: if Pillow is missing, the file is or cannot be read, or it claims more pixels than Pillow opens.
    """
    with importing("PIL", "Photographs need Pillow: pip install pillow."):
        from PIL import Image
    if path.suffix.lower() == EXR:
        return _exr_header(path)
    warnings.filterwarnings("ignore", module=r"PIL\.")  # for all threads, as catch_warnings is not
    try:
        file: BinaryIO = regular_file(path, "an image").open("rb") if content is None else BytesIO(content)
        with file:
            return _photograph(Image, file)
    except Image.DecompressionBombError as error:
        raise found_instead(path, f"an image that is too large ({reason(error)})", "one that can be decoded") from error
    except OSError as error:
        if error.errno is None:  # of Pillow, not of the system
            return None
        raise found_instead(path, f"a file that cannot be read ({error.strerror})", "an image") from error


def _photograph(pillow: Any, file: BinaryIO) -> Photograph | None:
    """The same of an open file."""
    try:
        image = pillow.open(file, formats=_PHOTO_FORMATS)
    except (SyntaxError, ValueError):
        return None
    width, height = image.size
    if width < 1 or height < 1:
        return None
    exif = pillow.Exif()
    details: Mapping[int, object] = {}
    try:  # not Image.getexif, which decodes a PNG in order to look behind its image
        exif.load(image.info.get("exif") or b"")
        details = exif.get_ifd(_DETAILS)
    except Exception:  # what is damaged says nothing, in however many ways it is
        pass
    said = (exif.get(_MAKE), exif.get(_MODEL), details.get(_FOCAL_LENGTH_35MM))
    turn = exif.get(_ORIENTATION)
    return Photograph(
        size=(width, height),
        orientation=turn if isinstance(turn, int) and 1 <= turn <= 8 else UPRIGHT,
        has_alpha=image.mode in ("RGBA", "LA"),
        camera=tuple(text for value in said if (text := _text(value))),
        time=_time(_text(details.get(_TAKEN)), _text(details.get(_PART_OF_SECOND))),
    )


def _time(taken: str, part: str) -> float | None:
    """Seconds of EXIF's ``2026:11:28 06:43:00``, and of the digits behind its point; None for anything else."""
    try:
        whole = datetime.strptime(taken, "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None
    seconds = (whole - datetime(1970, 1, 1)).total_seconds()
    return seconds + float(f"0.{part}") if part.isascii() and part.isdecimal() else seconds


def _text(value: object) -> str:
    """A tag that is a text or a whole number; "" for every other, and for what says nothing."""
    if isinstance(value, int):
        return str(value) if value else ""
    if not isinstance(value, str):
        return ""
    return "".join(letter for letter in value[:_LONGEST_TAG].split("\0")[0] if letter.isprintable()).strip()
