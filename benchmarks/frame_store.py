"""Ways to keep decoded frames on disk without loss: bytes, time to write, and time to read what a training reads.

    python benchmarks/frame_store.py CAPTURE [--images 12] [--step 23]

A line for each: bytes beside those of the raw frames, milliseconds on one processor to write an image, megabytes of
pixels a second that whole images decode at, and what a mean step of the standard recipe reads: milliseconds, and their
share of a step of ``--step`` milliseconds. The recipe takes an image of half the size in 40 % of the steps, a rectangle
of 0.35 a side in 45 %, and a whole image in 15 %. ``ours`` is what the frame store does. lz4 and blosc2 are measured
where they are installed.
"""

from __future__ import annotations

import argparse
import importlib
import time
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np
import zstandard

from frog_blender.engine.capture.decoding import decode_masked
from frog_blender.engine.frames.codecs import TileCodec
from frog_blender.engine.frames.files import FrameFiles, FrameWriter, pack_shot
from frog_blender.engine.frames.image_coding import halved_image
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import prepare_capture

Image = np.ndarray
Region = tuple[int, int, int, int]
Unpack = Callable[[Any, tuple[int, ...]], Image]
HALF, CROP, WHOLE = 0.40, 0.45, 0.15  # shares of the steps
SIDE = 0.35  # of a rectangle beside the image's
BAND = 64  # rows of a block, in formats that are none of images


def seconds(work: Callable[[], object], repeats: int = 3) -> float:
    """Of this thread's processor time, the least of some."""
    times = []
    for _ in range(repeats):
        started = time.thread_time()
        work()
        times.append(time.thread_time() - started)
    return min(times)


class Codec:
    """A way to keep an image: whole, or in bands of rows."""

    def __init__(
        self, name: str, pack: Callable[[Image], Any], unpack: Callable[[Any, tuple[int, ...]], Image]
    ) -> None:
        self.name, self._pack, self._unpack = name, pack, unpack

    def write(self, image: Image) -> list[tuple[Any, tuple[int, ...]]]:
        bands = [image[top : top + BAND] for top in range(0, len(image), BAND)] if self.in_bands else [image]
        return [(self._pack(np.ascontiguousarray(band)), band.shape) for band in bands]

    @property
    def in_bands(self) -> bool:
        return self.name not in ("PNG", "WebP", "raw")

    def read(self, packed: list[tuple[Any, tuple[int, ...]]], region: Region) -> Image:
        left, top, width, height = region
        first, last = (top // BAND, -(-(top + height) // BAND)) if self.in_bands else (0, 1)
        image = np.concatenate([self._unpack(*each) for each in packed[first:last]])
        start = top - (first * BAND if self.in_bands else 0)
        return image[start : start + height, left : left + width]


def predicted(image: Image) -> Image:
    """(3, H, W) green, and red and blue less green, each less the pixel above."""
    red, green, blue = cv2.split(image)
    planes = np.stack([green, red - green, blue - green])
    planes[:, 1:] -= planes[:, :-1].copy()
    return planes


def restored(planes: Image) -> Image:
    """The image of what ``predicted`` made."""
    for row in range(1, planes.shape[1]):
        planes[:, row] += planes[:, row - 1]
    planes[1:] += planes[0]
    return np.asarray(cv2.merge([planes[1], planes[0], planes[2]]))


def codecs() -> list[Codec]:
    """Those whose packages are installed."""

    def array(content: bytes, shape: tuple[int, ...]) -> Image:
        return np.frombuffer(bytearray(content), np.uint8).reshape(shape)

    def image_file(ending: str, *settings: int) -> Codec:
        def pack(image: Image) -> Any:
            return cv2.imencode(ending, image, settings)[1]

        return Codec({".png": "PNG", ".webp": "WebP"}[ending], pack, lambda content, _: cv2.imdecode(content, -1))

    found = [Codec("raw", lambda image: image.tobytes(), array)]
    found.append(image_file(".png", cv2.IMWRITE_PNG_COMPRESSION, 1))
    found.append(image_file(".webp", cv2.IMWRITE_WEBP_QUALITY, 101))
    for level in (-1, 1, 3):
        write = zstandard.ZstdCompressor(level=level, write_checksum=True).compress
        read = zstandard.ZstdDecompressor().decompress
        found.append(
            Codec(
                f"zstd {level}, predicted",
                lambda image, write=write: write(predicted(image).tobytes()),
                lambda content, shape, read=read: restored(array(read(content), (3, *shape[:2]))),
            )
        )
    for name, module in (("lz4", "lz4.frame"), ("blosc2", "blosc2")):
        try:
            library = importlib.import_module(module)
        except ImportError:
            continue
        found.append(
            Codec(
                f"{name}, predicted",
                lambda image, library=library: library.compress(predicted(image).tobytes()),
                lambda content, shape, library=library: restored(array(library.decompress(content), (3, *shape[:2]))),
            )
        )
    return found


def regions(image: Image) -> tuple[Region, Region]:
    """The whole image, and a rectangle in it as training takes them."""
    height, width = image.shape[:2]
    down, across = (round(SIDE * length / 16) * 16 for length in (height, width))
    return (0, 0, width, height), (width // 3 // 16 * 16, height // 3 // 16 * 16, across, down)


def line(
    name: str,
    size: float,
    write: Callable[[], object],
    images: list[Image],
    reads: tuple[Callable[[int], Image], Callable[[int], Image], Callable[[int], Image]],
    step: float,
) -> str:
    """A row of the table; raises if something is lost.

    Args:
        size: bytes of an image.
        write: keeps one.
        reads: an image, a rectangle, and one of half the size, by number.
        step: milliseconds.
    """
    for number, image in enumerate(images):
        if not np.array_equal(reads[0](number), image):
            raise SystemExit(f"{name} is not lossless")
    whole, crop, half = (seconds(lambda read=read: [read(n) for n in range(len(images))]) for read in reads)
    mean = (WHOLE * whole + CROP * crop + HALF * half) / len(images)
    raw = images[0].nbytes
    figures = f"{size / raw:.3f} | {1e3 * seconds(write, 2):.1f} | {raw * len(images) / whole / 1e6:.0f}"
    return f"| {name} | {figures} | {1e3 * mean:.2f} | {100e3 * mean / step:.1f} % |"


def measure(codec: Codec, images: list[Image], step: float) -> str:
    """Of one codec."""
    packed = [codec.write(image) for image in images]
    whole, crop = regions(images[0])
    reads = (
        lambda number: codec.read(packed[number], whole),
        lambda number: codec.read(packed[number], crop),
        lambda number: halved_image(codec.read(packed[number], whole)),
    )
    size = sum(len(content) for each in packed for content, _ in each) / len(images)
    return line(codec.name, size, lambda: codec.write(images[0]), images, reads, step)


def measure_ours(shots: list[Any], step: float) -> str:
    """Of the frame store's files, read from the disk's cache."""
    codec, images = TileCodec(), [shot.image for shot in shots]
    with TemporaryDirectory() as folder:
        writer = FrameWriter(Path(folder), False)
        for shot in shots:
            writer.add(pack_shot(shot, False, codec))
        files = FrameFiles(Path(folder), [image.shape[:2] for image in images], writer.finish())
        whole, crop = regions(images[0])
        reads = (lambda number: files.image(number, whole), lambda number: files.image(number, crop), files.half)
        size = sum(file.stat().st_size for file in Path(folder).iterdir()) / len(shots)
        row = line("ours", size, lambda: pack_shot(shots[0], False, codec), images, reads, step)
        files.close()
    return row


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--images", type=int, default=12)
    parser.add_argument("--scale", type=float)
    parser.add_argument("--step", type=float, default=23.0, help="milliseconds of a step that the share is of")
    options = parser.parse_args()
    cv2.setNumThreads(1)
    capture, _ = prepare_capture(TrainingJob(options.capture, Path("x.frog"), scale=options.scale))
    order = capture.decoding_order[: options.images]
    shots = list(decode_masked(capture.without_masks(), order))
    images = [shot.image for shot in shots]
    print("| kept as | size beside raw | ms to write | MB/s, whole | ms a step | of a step |")
    print("|---|---|---|---|---|---|")
    for codec in codecs():
        print(measure(codec, images, options.step), flush=True)
    print(measure_ours(shots, options.step), flush=True)


if __name__ == "__main__":
    main()
