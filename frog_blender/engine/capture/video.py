"""Videos and images as players show them; errors of OpenCV, which decodes images, become FrogErrors."""

import os
import struct
import unicodedata
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from ..arrays import Float32s, Float64s, ImageArray
from ..errors import found_instead, in_words
from ..io.atomic_files import write_atomically
from ..io.regular_file import regular_file
from ..optional_imports import importing
from ..preloading import open_extension
from ..srgb import linear_to_srgb
from . import media
from .camera import MAX_SIDE
from .masking import over
from .media import EXR, UPRIGHT, FilmHeader, may_miss, opened_film, read_film_header, read_photograph, truncated
from .natural_order import natural
from .orientation import is_mirrored, oriented, quarter_turns, turned
from .tone_mapping import ToneMapping

_RAW_STREAMS = (".h264", ".264", ".avc", ".h265", ".265", ".hevc", ".m2v", ".mjpeg", ".mjpg")
_CONTAINERS = (".mp4", ".mov", ".m4v", ".qt", ".avi", ".mkv", ".webm", ".ogv", ".wmv", ".asf", ".flv", ".f4v")
_OF_CAMERAS = (".mts", ".m2ts", ".ts", ".mpg", ".mpeg", ".vob", ".mod", ".tod", ".mxf", ".dv", ".3gp", ".360", ".insv")
_PROXIES = (".lrv", ".lrf")  # small copies that cameras put beside a film
VIDEO_SUFFIXES = frozenset({*_CONTAINERS, *_OF_CAMERAS, *_RAW_STREAMS, *_PROXIES})
IMAGE_SUFFIXES = (".png", ".jpg", ".jpeg", ".webp", ".tif", ".tiff", ".bmp", EXR)
_RAW_PHOTOGRAPHS = (".dng", ".cr2", ".cr3", ".nef", ".arw", ".raf", ".orf", ".rw2", ".pef", ".srw")
_UNREAD = (".heic", ".heif", ".hif", ".avif", ".jxl", ".hdr", ".tga", ".psd", *_RAW_PHOTOGRAPHS)
READABLE = "PNG, JPEG, WebP, TIFF or EXR: convert them, with ImageMagick: magick mogrify -format png *"
"""What is said of images in another format."""
# Videos of fewer pixels than this are decoded once when opened, to count their frames for certain.
_COUNT_BY_DECODING = 1e8
_MAX_DECODED = 2**28  # pixels of an image: the largest cameras have half as many
_ALWAYS_DECODED, _PIXELS_OF_BYTE = 2**27, 64  # of any image, and more for each byte of one
_PNG_START = b"\x89PNG\r\n\x1a\n"


@dataclass(frozen=True, eq=False)
class VideoFacts:
    """One video, as players show it.

    Attributes:
        width, height: pixels, after its rotation flag.
        frame_count: frames that are shown; an edit list may hide others.
        frames_per_second: their mean rate as the file says it.
        timestamps: (frame_count,) float64 ascending seconds, from the file's start, at which they are shown.
        turn: degrees clockwise by which the stored frames are shown: 0, 90, 180 or 270.
        header: what else the file says; of images nothing.
    """

    width: int
    height: int
    frame_count: int
    frames_per_second: float
    timestamps: Float64s
    turn: int = 0
    header: FilmHeader = field(default_factory=FilmHeader)

    @property
    def stored(self) -> tuple[int, int]:
        """(width, height) of its pixels before they are made square."""
        if self.turn % 180:
            return self.width, round(self.height / self.header.aspect)
        return round(self.width / self.header.aspect), self.height


def load_opencv() -> Any:  # cv2 has no types that mypy follows
    """OpenCV with its log turned off.

    Raises:
        FrogError: if it is not installed, or cannot be loaded.
    """
    os.environ.setdefault("OPENCV_FFMPEG_LOGLEVEL", "-8")  # before the first video: FFmpeg reads it once
    open_extension("cv2")
    with importing("cv2", "Videos and images need OpenCV: pip install opencv-contrib-python-headless."):
        import cv2
    if hasattr(cv2, "setLogLevel"):
        cv2.setLogLevel(0)
    return cv2


def read_facts(path: Path) -> VideoFacts:
    """Facts about a video; the first frame is really decoded. Small videos are decoded whole, and those whose file has
    no times.

    Raises:
        FrogError: if the file is missing, empty or cannot be decoded, or ends long before its header says.
    """
    header = read_film_header(path, with_times=True)
    planned = header.times
    with opened_film(path, replace(header, fields="")) as (frames, image_of):
        first = next(frames, None)
        if first is None:
            raise found_instead(path, "a video of which no frame can be decoded", "a complete video")
        height, width = _shown(image_of(first), header.aspect, first.rotation).shape[:2]
        # Two fields may be two packets of the file.
        if planned is None or header.fields or len(planned) * width * height < _COUNT_BY_DECODING:
            times = _times(path, [first.time, *(frame.time for frame in frames)], planned, header.rate)
        else:
            times = planned
    header, turn = replace(header, times=None), 90 * _turns(first.rotation)
    return VideoFacts(width, height, len(times), header.rate, times, turn, header)


def _times(path: Path, stamps: Sequence[float], planned: Float64s | None, rate: float) -> Float64s:
    """(N,) seconds of decoded frames.

    Args:
        stamps: seconds as the decoder says them, None where it has none.
        planned: what the file says of all frames that are shown, seconds; None where it has no times.
    """
    if planned is not None and len(planned) == len(stamps):
        return planned
    if planned is not None and len(stamps) < len(planned) - may_miss(len(planned)):
        raise truncated(path, len(stamps), len(planned))
    times: Float64s = np.array(stamps, np.float64)
    if not np.isfinite(times).all() or (np.diff(times) <= 0).any():  # some containers have no times
        times = np.arange(len(stamps)) / rate
    times += (0.0 if planned is None else planned[0]) - times[0]
    return times


def decode(path: Path, indices: Iterable[int]) -> Iterator[ImageArray]:
    """The frames of a video with the given ascending indices, each (H, W, 3) uint8 RGB, as players show them.

    Turned by the rotation flag, of square pixels, the first field alone of two, and tone-mapped where the film's
    dynamic range is high. Where a large video, whose frames nobody counted, ends a frame before its header says (or
    1 %), the last one stays.

    Raises:
        FrogError: if the file cannot be decoded or ends too early.
    """
    frames_asked = list(indices)
    header = read_film_header(path)
    toned = ToneMapping(header.transfer) if header.transfer else None
    position, last = 0, None
    with opened_film(path, header) as (frames, image_of):
        for index in frames_asked:
            frame = None
            while position <= index and (frame := next(frames, None)) is not None:
                position += 1
            if frame is not None:
                last = _shown(image_of(frame), header.aspect, frame.rotation)
                last = last if toned is None else toned.apply(last)
            elif last is None or frames_asked[-1] + 1 - position > may_miss(frames_asked[-1] + 1) // 2:
                raise truncated(path, position, frames_asked[-1] + 1)
            yield last


def _shown(image: ImageArray, aspect: float, rotation: int) -> ImageArray:
    """A stored frame with square pixels and upright.

    Args:
        rotation: degrees against the clock by which it is shown.
    """
    if aspect != 1:
        cv2 = load_opencv()
        size = (max(1, round(image.shape[1] * aspect)), image.shape[0])
        image = cv2.resize(image, size, interpolation=cv2.INTER_CUBIC if aspect > 1 else cv2.INTER_AREA)
    return turned(image, _turns(rotation))


def _turns(rotation: int) -> int:
    """Quarter turns clockwise."""
    return round(-rotation / 90) % 4


def read_image(path: Path, background: tuple[float, float, float] = (0.0, 0.0, 0.0)) -> ImageArray:
    """An image file as (H, W, 3) uint8 RGB, turned as its EXIF says; transparent pixels lie over ``background``.

    Raises:
        FrogError: if the file is missing or no image, or one too large to be decoded.
    """
    with _as_frog_error(path):
        image, alpha = _stored(path)
        return image if alpha is None else over(image, alpha, background)


def write_image(path: Path, image: ImageArray) -> None:
    """Writes an image (H, W, 3 or 4) uint8 RGB or RGBA as its ending says, PNG or JPEG; FrogError where none can be
    written."""
    cv2 = load_opencv()
    order = cv2.COLOR_RGB2BGR if image.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
    _, content = cv2.imencode(path.suffix.lower(), cv2.cvtColor(image, order))
    write_atomically(path, content.tobytes())


def shrunk(image: ImageArray, longest: int) -> ImageArray:
    """An image (H, W) or (H, W, 3) at most ``longest`` pixels a side."""
    cv2 = load_opencv()
    height, width = image.shape[:2]
    scale = longest / max(height, width)
    if scale >= 1:
        return image
    size = max(1, round(width * scale)), max(1, round(height * scale))
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA))


def read_gray(path: Path) -> ImageArray:
    """An image file as (H, W) uint8 brightness; errors as of ``read_image``."""
    cv2 = load_opencv()
    return np.asarray(cv2.cvtColor(read_image(path), cv2.COLOR_RGB2GRAY))


def read_mask(path: Path) -> ImageArray:
    """An image file as (H, W) uint8, the brightest channel of each pixel; errors as of ``read_image``."""
    return np.ascontiguousarray(read_image(path).max(axis=2))


def read_alpha(path: Path) -> ImageArray:
    """The alpha channel of an image file as (H, W) uint8, 255 where it has none; errors as of ``read_image``."""
    with _as_frog_error(path):
        image, alpha = _stored(path)
        return np.full(image.shape[:2], 255, np.uint8) if alpha is None else np.ascontiguousarray(alpha)


def _stored(path: Path) -> tuple[ImageArray, ImageArray | None]:
    """(H, W, 3) RGB of an image file at 8 bits, and its alpha (H, W) where it has one."""
    if path.suffix.lower() == EXR:
        image = _displayed(media.read_exr(regular_file(path, "an image"), _MAX_DECODED))
    else:
        image = _decoded(path)
        if not np.issubdtype(image.dtype, np.unsignedinteger):
            raise found_instead(path, f"an image of {image.dtype} values", "8 or 16 bits a channel")
        if shift := 8 * (image.dtype.itemsize - 1):
            image = (image >> shift).astype(np.uint8)
        cv2 = load_opencv()
        kinds = {1: cv2.COLOR_GRAY2RGB, 3: cv2.COLOR_BGR2RGB}
        image = cv2.cvtColor(image, kinds.get(image[0, 0].size, cv2.COLOR_BGRA2RGBA))
    return image[..., :3], image[..., 3] if image.shape[2] == 4 else None


def _displayed(light: Float32s) -> ImageArray:
    """(H, W, 3 or 4) uint8 sRGB of linear light, which is multiplied by its alpha as renderers do."""
    colors, alpha = light[..., :3], light[..., 3:]
    if alpha.size:
        colors = np.divide(colors, alpha, out=np.zeros_like(colors), where=alpha > 0)
    shown = linear_to_srgb(np.nan_to_num(colors).clip(0, 1))
    channels: Float32s = np.concatenate([shown, np.nan_to_num(alpha).clip(0, 1)], axis=2) * 255 + 0.5
    return channels.astype(np.uint8)


def image_size(path: Path) -> tuple[int, int]:
    """(width, height) as ``read_image`` decodes them; PNG, JPEG and WebP are not decoded for it.

    Raises:
        FrogError: if the file is missing or no image, or one too large to be decoded.
    """
    photograph = read_photograph(path)
    if photograph is None:
        height, width = read_image(path).shape[:2]
        return width, height
    _check_image_size(path, photograph.size)
    return photograph.size[::-1] if quarter_turns(photograph.orientation) % 2 else photograph.size


def image_facts(path: Path, times: Float64s, rate: float) -> VideoFacts:
    """The same of images that were taken at ``times`` (N,), ``rate`` a second, by the first of them.

    Its turn is 0 where it is mirrored, too. Errors as of ``image_size``.
    """
    width, height = image_size(path)
    photograph = read_photograph(path)
    orientation = UPRIGHT if photograph is None else photograph.orientation
    turns = 0 if is_mirrored(orientation) else quarter_turns(orientation)
    return VideoFacts(width, height, len(times), rate, times, 90 * turns)


def _check_image_size(path: Path, size: tuple[int, int]) -> None:
    """FrogError for an image size (width, height) that would exhaust the memory when decoded."""
    width, height = size
    most = min(_MAX_DECODED, max(_ALWAYS_DECODED, _PIXELS_OF_BYTE * path.stat().st_size))
    if max(size) > MAX_SIDE or width * height > most:
        found = f"an image of {width} x {height} pixels"
        raise found_instead(path, found, f"at most {MAX_SIDE:,} a side and {most:,} in a file of its size")


def _decoded(path: Path) -> ImageArray:
    """An image as OpenCV decodes it, then turned by its EXIF; raises OpenCV's own errors too."""
    regular_file(path, "an image")
    # Through memory: OpenCV cannot open paths outside the system's code page on Windows.
    with in_words(f"{path}: found a file that cannot be read", ", expected an image."):
        content = path.read_bytes()
    if not content:
        raise found_instead(path, "an empty file", "an image")
    photograph = read_photograph(path, content)
    if photograph is not None:
        _check_image_size(path, photograph.size)
    elif unread := unread_format([path]):
        raise found_instead(path, f"an image in {unread}", READABLE)
    if _is_cut_png(content):
        raise found_instead(path, "a PNG that is cut off or damaged", "a whole one")
    cv2 = load_opencv()
    image: ImageArray | None = cv2.imdecode(np.frombuffer(content, dtype=np.uint8), cv2.IMREAD_UNCHANGED)
    if image is None:
        raise found_instead(path, "a file that cannot be decoded", "an image")
    return image if photograph is None else oriented(image, photograph.orientation)


def _is_cut_png(content: bytes) -> bool:
    """Whether a PNG has a chunk that says it is longer than the file: OpenCV makes room for as much as it says."""
    if not content.startswith(_PNG_START):
        return False
    begin = len(_PNG_START)
    while begin + 8 <= len(content):
        length, kind = struct.unpack_from(">I4s", content, begin)
        if kind == b"IEND":
            return False
        begin += 12 + length  # with the sum that follows
        if begin > len(content):
            return True
    return False


@contextmanager
def _as_frog_error(path: Path) -> Iterator[None]:
    """Turns OpenCV's errors and a MemoryError into a FrogError."""
    try:
        yield
    except (load_opencv().error, MemoryError) as error:
        raise found_instead(path, f"a file that cannot be decoded ({error})", "an image") from error


def find_videos(folder: Path) -> list[Path]:
    """Video files of a folder in natural order, none where there is no folder; hidden files do not count, nor cameras'
    small copies of their films."""
    return _files(folder, VIDEO_SUFFIXES - set(_PROXIES)) or _files(folder, _PROXIES)


def find_images(folder: Path) -> list[Path]:
    """Image files of a folder in natural order, none where there is no folder; hidden files (macOS writes
    ``._NAME.png``) do not count, nor does EXR beside others."""
    return _files(folder, IMAGE_SUFFIXES[:-1]) or _files(folder, (EXR,))


def unread_format(files: Iterable[Path]) -> str:
    """The format, as ``HEIC``, of the first of these files that is an image which is not read; "" for none."""
    return next((path.suffix[1:].upper() for path in files if path.suffix.lower() in _UNREAD), "")


def _files(folder: Path, suffixes: Collection[str]) -> list[Path]:
    entries = folder.iterdir() if folder.is_dir() else ()
    files = (path for path in entries if path.suffix.lower() in suffixes and not path.name.startswith("."))
    return sorted(files, key=lambda path: (natural(path.name), path.name))


def with_ending(path: Path) -> Path | None:
    """The image file whose path without its ending is ``path``; None where there is none."""
    endings = (ending for suffix in IMAGE_SUFFIXES for ending in (suffix, suffix.upper()))
    candidates = (Path(f"{path}{ending}") for ending in endings)
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def composed(name: str) -> str:
    """A name in Unicode's composed form; macOS decomposes the accents of file names."""
    return unicodedata.normalize("NFC", name)
