"""Films and photographs as cameras and phones write them: cut without encoding, turned, of varying rate, of HDR."""

from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from PIL import Image

_CLOCK = 15_360  # units of a second, of which a frame of every usual rate is a whole number
TRANSFERS = {"hlg": 18, "pq": 16}  # ISO/IEC 23091-2
INTERLACED = {"flags": "+ilme+ildct", "x264-params": "tff=1"}
"""Options of an encoder whose images are marked as two fields each."""
_BT2020 = 9


def encode(
    path: Path,
    images: Sequence[np.ndarray],
    *,
    times: Sequence[float] = (),
    rate: int = 30,
    key_every: int = 30,
    codec: str = "libx264",
    transfer: str = "",
    is_full_range: bool = False,
    matrix: int = 0,
    aspect: Fraction | None = None,
    sound: np.ndarray | None = None,
    sound_rate: int = 48_000,
    tags: dict[str, str] | None = None,
    **options: str,
) -> Path:
    """A film of images (H, W, 3) uint8 RGB of even sides.

    Args:
        times: of each image, seconds; by default ``rate`` a second.
        transfer: "hlg" or "pq": ten bits, whose signal the images are, tagged as of BT.2020.
        matrix: of its colours, ISO/IEC 23091-2, such as 1 for BT.709; 0 for BT.601's, of which the file says nothing.
        aspect: of its pixels, width over height.
        sound: (S, C) int16 of one or two channels.
        tags: of the file.
        options: of the encoder, such as ``bf="2"``.
    """
    with av.open(str(path), "w") as container:
        container.metadata.update(tags or {})
        stream: Any = container.add_stream(codec, rate=rate, options={"crf": "8", **options})
        stream.height, stream.width = images[0].shape[:2]
        stream.pix_fmt = "yuv420p10le" if transfer else "yuv420p"
        stream.gop_size = key_every
        if aspect:
            stream.sample_aspect_ratio = aspect
        unit = Fraction(1, _CLOCK if times else rate)
        stream.codec_context.time_base = unit
        space: dict[str, Any] = {"dst_color_range": "JPEG" if is_full_range else "MPEG"}
        stream.codec_context.color_range = 2 if is_full_range else 1
        if transfer:
            stream.codec_context.color_trc, stream.codec_context.color_primaries = TRANSFERS[transfer], _BT2020
            matrix = _BT2020
        if matrix:
            stream.codec_context.colorspace = space["dst_colorspace"] = matrix
        track: Any = None
        if sound is not None:
            layout = "mono" if sound.shape[1] == 1 else "stereo"
            track = container.add_stream("aac", rate=sound_rate, layout=layout)
        for index, image in enumerate(images):
            given = av.VideoFrame.from_ndarray(np.ascontiguousarray(image), "rgb24")
            frame = given.reformat(format=stream.pix_fmt, **space)
            frame.pts, frame.time_base = round((times[index] if times else index / rate) / unit), unit
            container.mux(stream.encode(frame))
        container.mux(stream.encode(None))
        if sound is not None:
            heard = av.AudioFrame.from_ndarray(np.ascontiguousarray(sound).reshape(1, -1), "s16", layout)
            heard.sample_rate, heard.pts = sound_rate, 0
            container.mux(track.encode(heard))
            container.mux(track.encode(None))
    return path


def copied(
    source: Path,
    path: Path,
    *,
    start: float = 0.0,
    delay: float = 0.0,
    sound_delay: float = 0.0,
    turn: int = 0,
    has_sound: bool = True,
    movflags: str = "",
    timecode: str = "",
) -> Path:
    """A film, not encoded again.

    Args:
        start: second from which on it is shown; what is before it, from a key frame on, is there and not shown.
        delay, sound_delay: seconds by which all is shown later, and its sound besides.
        turn: degrees against the clock by which it is shown turned.
        movflags: FFmpeg's for MP4, such as "faststart" and "frag_keyframe+empty_moov".
        timecode: of its first frame, HH:MM:SS:FF.
    """
    options = {"movflags": movflags} if movflags else {}
    with av.open(str(source)) as film, av.open(str(path), "w", options=options) as container:
        container.metadata.update(film.metadata | ({"timecode": timecode} if timecode else {}))
        chosen = [*film.streams.video, *(film.streams.audio if has_sound else ())]
        streams = {stream.index: container.add_stream_from_template(stream) for stream in chosen}
        if turn:
            streams[film.streams.video[0].index].set_display_rotation(turn)
        if start:
            film.seek(int(start * av.time_base))
        for packet in film.demux(chosen):
            later = delay - start + (sound_delay if packet.stream.type == "audio" else 0.0)
            if packet.dts is None:
                continue
            shift = round(later / packet.time_base)
            packet.pts, packet.dts = packet.pts + shift, packet.dts + shift
            packet.stream = streams[packet.stream_index]
            container.mux(packet)
    return path


def shown(path: Path) -> np.ndarray:
    """(N, height, width, 3) uint8 RGB of the frames that FFmpeg shows, as they are stored."""
    with av.open(str(path)) as film:
        return np.stack([frame.to_ndarray(format="rgb24") for frame in film.decode(video=0)])


def photograph(path: Path, pixels: np.ndarray, **tags: object) -> Path:
    """An image file of (H, W, 3) uint8 RGB with EXIF: ``turned``, ``make``, ``model``, ``focal_length``."""
    exif = Image.Exif()
    for name, tag in (("turned", 0x0112), ("make", 0x010F), ("model", 0x0110)):
        if name in tags:
            exif[tag] = tags[name]
    if "focal_length" in tags:  # as 35 mm film would need it
        exif.get_ifd(0x8769)[0xA405] = tags["focal_length"]
    Image.fromarray(np.ascontiguousarray(pixels)).save(path, exif=exif)
    return path


def numbered(count: int, width: int = 64, height: int = 48) -> list[np.ndarray]:
    """Grey images that tell their number by white and black fields at the bottom, with a white bar above."""
    images = []
    for index in range(count):
        image = np.full((height, width, 3), 90, np.uint8)
        image[: height // 4, : width // 2] = 250
        bits = [250 if index >> bit & 1 else 10 for bit in range(8)]
        image[height // 2 :] = np.repeat(bits, width // 8)[None, :, None]
        images.append(image)
    return images


def sliding(moment: float, width: int = 128, height: int = 96) -> np.ndarray:
    """A bright square that slides before a smooth wall, of which half a frame is half a moment."""
    image = np.linspace(40, 90, width).astype(np.uint8)[None, :, None].repeat(height, axis=0).repeat(3, axis=2)
    left = 10 + round(8 * moment)
    image[height // 4 : 3 * height // 4, left : left + 30] = 220
    return image


def woven(first: np.ndarray, second: np.ndarray, top: int) -> np.ndarray:
    """An image of two fields, of which the first has the lines ``top`` (0 or 1) and every second one on."""
    image = second.copy()
    image[top::2] = first[top::2]
    return image


def number_of(image: np.ndarray) -> int:
    """Which of ``numbered`` an image shows."""
    height, width = image.shape[:2]
    row = image[height * 3 // 4, width // 16 :: width // 8].mean(axis=1)
    return sum(1 << bit for bit, value in enumerate(row[:8]) if value > 128)
