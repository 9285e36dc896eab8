"""Decoding the frames of a capture into the cache, where there is room for them."""

from __future__ import annotations

import json
import os
import shutil
import tempfile
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from ..capture.capture import Capture
from ..capture.decoding import DecodedShot, decode_masked
from ..capture.frame_keys import Sources, bytes_of, decoding_order, has_changed, shapes_of
from ..errors import FrogError
from .codecs import TileCodec, codec_of, usual_codec
from .files import ALPHA, IGNORED, Description, FrameFiles, FrameWriter, PackedShot, names_of, pack_shot
from .limit import FORMAT, INDEX, PARTIAL, make_room, read_index, remove_abandoned, remove_store, size_of, too_small
from .tiles import DamagedTiles

DAMAGED = "damaged"
"""An empty file in a store that has to be written again."""
_SPARE_BYTES = 256 << 20  # left free on the disk
_BEST_RATIO = 8  # by which frames are compressed at most, as far as anybody knows before
_LOOKED_EVERY = 64 << 20  # bytes written, after which the room is looked at again


class DecodingCancelled(Exception):
    """The caller's ``cancelled`` answered True during decoding. No FrogError: nothing is wrong with the input."""


def is_whole(folder: Path, capture: Capture) -> bool:
    """True if the store exists and has all its bytes."""
    try:
        opened_files(folder, capture)[1].close()
        return True
    except (OSError, DamagedTiles):
        return False


def opened_files(folder: Path, capture: Capture) -> tuple[Sources, FrameFiles]:
    """The source files of a store, as its index says, and its frames in the order of decoding.

    Raises:
        OSError: if a file cannot be opened.
        DamagedTiles: if it is not a store of this version, cannot be unpacked here, or is not whole.
    """
    index = read_index(folder)
    if index is None or index.get("format") != FORMAT or (folder / DAMAGED).exists():
        raise DamagedTiles(f"{folder}: not a store of this version, or one that is damaged")
    sources, files = index.get("sources"), index.get("files")
    needed = set(names_of(capture.has_masks))
    if not (isinstance(sources, dict) and isinstance(files, dict)):
        raise DamagedTiles(f"{folder}: an index without its files")
    whole = needed - {ALPHA, IGNORED} <= set(files) <= needed
    if not whole or not all(_are_two_numbers(value) for value in files.values()):
        raise DamagedTiles(f"{folder}: other files than such a capture has")
    codec = codec_of(index.get("codec"))
    if codec is None:
        raise DamagedTiles(f"{folder}: packed by {index.get('codec')!r}, which is not here")
    shapes = shapes_of(capture)
    return sources, FrameFiles(folder, [shapes[shot] for shot in decoding_order(capture)], files, codec)


def _are_two_numbers(value: object) -> bool:
    return isinstance(value, list) and len(value) == 2 and all(type(number) is int and number >= 0 for number in value)


def remove_stale(cache: Path, capture: Capture) -> None:
    """Deletes what killed runs and other versions left, and stores of this capture whose source files have changed.

    Stores of some of its cameras, or of altered images, stay.
    """
    remove_abandoned(cache)
    for folder in [path.parent for path in cache.glob(f"*/{INDEX}") if PARTIAL not in path.parent.name]:
        index = read_index(folder)
        if (
            index is not None
            and index.get("capture") == str(capture.path.resolve())
            and has_changed(index.get("sources"))
        ):
            remove_store(folder)


def altered(capture: Capture, index: int, decoded: DecodedShot) -> DecodedShot:
    """A decoded image as the capture shows it, contiguous."""
    shot, alteration = capture.shots[index], capture.alteration
    if alteration is None or (capture.is_test(shot) and not alteration.tests_too):
        return decoded
    image = alteration.apply(decoded.image, capture.cameras[shot.camera].name, shot.frame)
    return replace(decoded, image=np.ascontiguousarray(image))


def build(
    folder: Path,
    capture: Capture,
    sources: Sources,
    progress: Callable[[int, int], None] | None,
    cancelled: Callable[[], bool] | None,
) -> None:
    """Decode into a temporary folder and rename it to ``folder``."""
    raw = sum(map(bytes_of, shapes_of(capture)))
    _check_room(folder.parent, raw // _BEST_RATIO, raw // _BEST_RATIO)
    partial = Path(tempfile.mkdtemp(prefix=folder.name + PARTIAL, dir=folder.parent))
    try:
        codec = usual_codec()
        described = _write(partial, capture, codec, progress, cancelled)
        _keep_to_limit(folder.parent, size_of(partial))
        facts = {"format": FORMAT, "capture": str(capture.path.resolve()), "sources": sources}
        facts |= {"codec": codec.name, "files": described}
        (partial / INDEX).write_text(json.dumps(facts), encoding="utf-8")
        _put(partial, folder, capture)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _write(
    partial: Path,
    capture: Capture,
    codec: TileCodec,
    progress: Callable[[int, int], None] | None,
    cancelled: Callable[[], bool] | None,
) -> Description:
    """Decodes, compresses in threads, and writes in the order of decoding."""
    order, workers = decoding_order(capture), os.cpu_count() or 1
    writer, waiting = FrameWriter(partial, capture.has_masks), deque[Future[PackedShot]]()
    done, looked = 0, 0

    def write_first() -> None:
        nonlocal done, looked
        writer.add(waiting.popleft().result())
        done += 1
        if writer.written - looked > _LOOKED_EVERY:
            looked = writer.written
            _check_room(partial.parent, writer.written * len(order) // done - writer.written, _LOOKED_EVERY, partial)
        if progress is not None:
            progress(done, len(order))

    try:
        with ThreadPoolExecutor(workers, thread_name_prefix="frog-packing") as threads:
            for index, decoded in zip(order, decode_masked(capture, order), strict=True):
                if cancelled is not None and cancelled():
                    raise DecodingCancelled(f"{capture.path}: decoding was cancelled.")
                waiting.append(threads.submit(pack_shot, altered(capture, index, decoded), capture.has_masks, codec))
                if len(waiting) > 2 * workers:
                    write_first()
            while waiting:
                write_first()
        return writer.finish()
    except BaseException:
        writer.abandon()
        raise


def _check_room(cache: Path, more: int, at_once: int, partial: Path | None = None) -> None:
    """Makes room for ``more`` bytes, as far as that is known.

    Raises:
        FrogError: if the limit is lower, or the disk has no room for what is written ``at_once``.
    """
    written = 0 if partial is None else size_of(partial)
    make_room(cache, more, written, _SPARE_BYTES)
    free = shutil.disk_usage(cache).free
    if free < at_once + _SPARE_BYTES:
        raise FrogError(
            f"{cache}: the decoded frames need about {more / 1e9:.2f} GB, found {free / 1e9:.2f} GB free: "
            "choose a smaller image scale, or another cache folder with FROG_CACHE."
        )
    _keep_to_limit(cache, more + written)


def _keep_to_limit(cache: Path, needed: int) -> None:
    """Makes room under the limit for a store; FrogError if there is none."""
    make_room(cache, 0, needed)
    if (error := too_small(cache, needed)) is not None:
        raise error


def _put(partial: Path, folder: Path, capture: Capture) -> None:
    """Renames a finished store, unless another process put the same one there first, which may be in use by now."""
    try:
        partial.rename(folder)
    except OSError:
        if is_whole(folder, capture):
            return
        if not remove_store(folder):  # damaged, and open: whoever has it open goes on with what it has
            shutil.rmtree(folder, ignore_errors=True)
        partial.rename(folder)
