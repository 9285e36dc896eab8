"""Decoded frames on disk, so that a capture larger than memory can be trained on.

Each video is decoded once, undistorted, resized to its camera and compressed without loss. The folder's name is a hash
of everything that decides the pixels. It gets that name only when complete.
"""

from __future__ import annotations

import json
import math
import os
import shutil
import tempfile
import threading
import time
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, closing, suppress
from dataclasses import asdict, replace
from pathlib import Path
from typing import BinaryIO

import numpy as np

from ..arrays import ImageArray
from ..capture.camera import MAX_PIXELS, MAX_SIDE
from ..capture.capture import Capture
from ..capture.decoding import DecodedShot, decode_masked
from ..capture.frame_keys import Sources, decoding_key, has_changed, sources_of
from ..capture.sharing import lock_exclusively, open_shared
from ..errors import FrogError, found_instead, in_words
from ..io.cache_folder import default_cache_folder
from ..io.child_process import Stopped
from . import limit
from .codecs import TileCodec
from .files import ALPHA, IGNORED, IMAGE, Description, FrameFiles, FrameWriter, PackedShot, names_of, pack, parts_of
from .image_coding import DamagedTiles, Region, halved_image

DAMAGED = "damaged"
"""An empty file in a store that has to be written again."""
_SPARE_BYTES = 256 << 20  # left free on the disk
_BEST_RATIO = 8  # by which frames are compressed at most, as far as anybody knows before
_LOOKED_EVERY = 64 << 20  # bytes written, after which the room is looked at again


def opened_files(folder: Path, capture: Capture) -> tuple[Sources, FrameFiles]:
    """The source files of a store, as its index says, and its frames in the order of decoding.

    Raises:
        OSError: if a file cannot be opened.
        DamagedTiles: if it is not a store of this version, or is not whole.
    """
    index, needed = limit.read_index(folder), set(names_of(capture.has_masks))
    if index is None or (folder / DAMAGED).exists():
        raise DamagedTiles(f"{folder}: not a store of this version, or one that is damaged")
    if not {IMAGE} <= set(index.files) <= needed:
        raise DamagedTiles(f"{folder}: other files than such a capture has")
    shapes = capture.shapes
    shots = [shapes[shot] for shot in capture.decoding_order]
    return index.sources, FrameFiles(folder, shots, index.files)


def remove_stale(cache: Path, capture: Capture) -> None:
    """Deletes what killed runs and other versions left, and stores of this capture whose source files have changed.

    Stores of some of its cameras, or of altered images, stay.
    """
    for entry in limit.stored_frames(cache):
        index = entry.index
        is_own = index is not None and index.capture == str(capture.path.resolve())
        if index is None or limit.PARTIAL in entry.folder.name or (is_own and has_changed(index.sources)):
            limit.remove_store(entry.folder)


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
    progress: Callable[[int, int], None],
    cancelled: Callable[[], bool],
) -> None:
    """Decode into a temporary folder and rename it to ``folder``."""
    raw = 3 * sum(map(math.prod, capture.shapes))
    _check_room(folder.parent, raw // _BEST_RATIO, raw // _BEST_RATIO)
    partial = Path(tempfile.mkdtemp(prefix=folder.name + limit.PARTIAL, dir=folder.parent))
    index = partial / limit.INDEX
    facts = limit.Index(limit.FORMAT, str(capture.path.resolve()), sources, {})
    try:
        index.touch()
        with open_shared(index) as in_use:  # before it says whose it is: nobody else deletes a store that is locked
            index.write_text(json.dumps(asdict(facts)), encoding="utf-8")
            described = _write(partial, capture, progress, cancelled)
            limit.keep_to_limit(folder.parent, 0, partial)
            index.write_text(json.dumps(asdict(replace(facts, files=described))), encoding="utf-8")
            if os.name == "nt":  # where no folder is renamed that has an open file
                in_use.close()
            _put(partial, folder, capture)
    finally:
        limit.remove_store(partial, even_open=True)


def _write(
    partial: Path, capture: Capture, progress: Callable[[int, int], None], cancelled: Callable[[], bool]
) -> Description:
    """Decodes, compresses in threads, and writes in the order of decoding."""
    order, workers, codec = capture.decoding_order, os.cpu_count() or 1, TileCodec()
    waiting, done, looked = deque[Future[PackedShot]](), 0, 0

    def write_first() -> None:
        nonlocal done, looked
        writer.add(waiting.popleft().result())
        done += 1
        if writer.written - looked > _LOOKED_EVERY:
            looked = writer.written
            _check_room(partial.parent, writer.written * len(order) // done - writer.written, _LOOKED_EVERY, partial)
        progress(done, len(order))

    packers = ThreadPoolExecutor(workers, thread_name_prefix="frog-packing")
    with closing(FrameWriter(partial, capture.has_masks)) as writer, packers:
        for index, decoded in zip(order, decode_masked(capture, order), strict=True):
            if cancelled():
                packers.shutdown(wait=False, cancel_futures=True)
                raise Stopped
            waiting.append(packers.submit(pack, altered(capture, index, decoded), capture.has_masks, codec))
            if len(waiting) > 2 * workers:
                write_first()
        while waiting:
            write_first()
        return writer.finish()


def _check_room(cache: Path, more: int, at_once: int, partial: Path | None = None) -> None:
    """Makes room for ``more`` bytes, as far as that is known.

    Raises:
        FrogError: if the limit is lower, or the disk has no room for what is written ``at_once``.
    """
    limit.make_room(cache, more, _SPARE_BYTES)
    free = shutil.disk_usage(cache).free
    if free < at_once + _SPARE_BYTES:
        raise FrogError(
            f"{cache}: the decoded frames need about {more / 1e9:.2f} GB and {_SPARE_BYTES / 1e9:.2f} GB that stay "
            f"free, found {free / 1e9:.2f} GB free: choose a smaller image scale, or another cache folder with "
            "FROG_CACHE."
        )
    limit.keep_to_limit(cache, more, partial)


def _put(partial: Path, folder: Path, capture: Capture) -> None:
    """Renames a finished store, unless another process put the same one there first, which may be in use by now."""
    try:
        partial.rename(folder)
    except OSError:
        with suppress(OSError, DamagedTiles):
            opened_files(folder, capture)[1].close()
            return  # it is whole
        # Damaged: whoever has it open goes on with what it has.
        if not limit.remove_store(folder, even_open=True) and folder.exists():
            raise found_instead(folder, "files of others", "decoded frames alone: move them elsewhere") from None
        partial.rename(folder)


_KEPT_SHARE = 1 / 8  # of the memory, for images that were decoded before
_LEAST_KEPT = 1 << 30
_TRIES = 5  # to open what another process may be deleting

_Key = tuple[str, int]
_Asked = tuple[int, Region, bool]


class FrameStore:
    """The frames of a capture, uint8 sRGB, read-only.

    Images of a capture that fits into memory are kept there; of a larger one what is asked for is read each time. An
    image whose checksum is wrong is decoded from the capture again, and the whole store the next time it is opened.

    Attributes:
        folder: where it lies.
        is_large: its images do not fit into the memory that is taken for them.
    """

    def __init__(self, capture: Capture, folder: Path) -> None:
        """A whole store; use ``open``, which makes it where it is missing.

        Raises:
            OSError: if it is not there.
            DamagedTiles: if it is not whole.
        """
        self.folder, self._capture = folder, capture
        self._shapes = capture.shapes
        self._rows = {shot: row for row, shot in enumerate(capture.decoding_order)}
        self._in_use: BinaryIO | None
        self._files: FrameFiles
        self._open_files()
        self._kept: dict[_Key, ImageArray] = {}
        self._lock = threading.Lock()
        self.is_large = 3 * sum(map(math.prod, self._shapes)) > _memory_for_images()
        self._reader: ThreadPoolExecutor | None = None
        self._ahead: list[tuple[_Asked, Future[ImageArray]]] = []

    @classmethod
    def open(
        cls,
        capture: Capture,
        *,
        cache_folder: Path | None = None,
        progress: Callable[[int, int], None] = lambda done, total: None,
        cancelled: Callable[[], bool] = lambda: False,
    ) -> FrameStore:
        """The store of a capture, decoded now unless an earlier run left it.

        Args:
            capture: its cameras' sizes are the frames' sizes.
            cache_folder: where stores live; by default ``$FROG_CACHE`` or the user's cache folder.
            progress: called with (frames done, frames in all) after each frame.
            cancelled: asked before each frame.

        Raises:
            Stopped: if ``cancelled`` said so.
            FrogError: if a file is missing or cut off, images are too large, or disk or limit have no room.
        """
        _check_sizes(capture)
        cache = Path(cache_folder) if cache_folder is not None else default_cache_folder()
        sources = sources_of(capture)
        folder = cache / decoding_key(capture, sources)
        for _ in range(_TRIES):
            if (store := _opened(capture, folder)) is not None:
                return store
            with in_words(f"{cache}: the decoded frames cannot be written here"):
                cache.mkdir(parents=True, exist_ok=True)
                remove_stale(cache, capture)
                build(folder, capture, sources, progress, cancelled)
        raise FrogError(f"{folder}: another process deletes the decoded frames as often as they are written.")

    def image(self, shot_index: int) -> ImageArray:
        """(H, W, 3) uint8 sRGB; ``shot_index`` counts in ``capture.shots``.

        Raises:
            FrogError: if it is damaged, and the capture is not there any more.
        """
        return self._whole(IMAGE, shot_index)

    def part(self, shot_index: int, region: Region, is_half: bool = False) -> ImageArray:
        """A region (left, top, width, height) of an image, or of the one of half its size; errors as of ``image``."""
        for index, (asked, reading) in enumerate(self._ahead):
            if asked == (shot_index, region, is_half):
                del self._ahead[: index + 1]
                return reading.result()
        return self._part(shot_index, region, is_half)

    def prefetch(self, shot_index: int, region: Region, is_half: bool = False) -> None:
        """Begins to read what ``part`` will probably be asked for next."""
        if (IMAGE, shot_index) in self._kept:
            return
        if self._reader is None:
            self._reader = ThreadPoolExecutor(1, thread_name_prefix="frog-frames")
        asked = shot_index, region, is_half
        # Of what was begun before, the last is what a step asks for now; others were guessed wrong.
        self._ahead = [*self._ahead[-1:], (asked, self._reader.submit(self._part, *asked))]

    def alpha(self, shot_index: int) -> ImageArray | None:
        """(H, W) uint8, the subject's share of each pixel; None where all images are whole."""
        return self._mask(ALPHA, shot_index)

    def ignored(self, shot_index: int) -> ImageArray | None:
        """(H, W) uint8, 255 for pixels that are to be ignored; None where none is in any image."""
        return self._mask(IGNORED, shot_index)

    def __len__(self) -> int:
        return len(self._shapes)

    def give_up(self) -> int:
        """Deletes the frames from disk to free space. They can be decoded again; this store cannot be used any more.

        Returns:
            The bytes that were freed. 0, and nothing is deleted, if another process reads the same frames.
        """
        if self._in_use is None or not lock_exclusively(self._in_use):
            return 0
        if self._reader is not None:
            self._reader.shutdown()
        self._in_use, self._ahead, self._reader, self._kept = None, [], None, {}
        size = limit.size_of(self.folder)
        self._files.close()
        if limit.remove_store(self.folder):
            return size
        with suppress(OSError, DamagedTiles):  # somebody else has opened them meanwhile
            self._open_files()
        return 0

    def _open_files(self) -> None:
        index = self.folder / limit.INDEX
        with ExitStack() as opening:
            self._in_use = opening.enter_context(open_shared(index))
            if not os.path.samestat(os.fstat(self._in_use.fileno()), index.stat()):
                raise DamagedTiles(f"{self.folder}: another process replaced it")
            self._sources, self._files = opened_files(self.folder, self._capture)
            opening.pop_all()

    def _part(self, shot: int, region: Region, is_half: bool) -> ImageArray:
        left, top, width, height = region
        if self.is_large and not is_half and (IMAGE, shot) not in self._kept:
            return self._read(IMAGE, shot, region)
        image = self.image(shot)
        return (halved_image(image) if is_half else image)[top : top + height, left : left + width]

    def _mask(self, name: str, shot: int) -> ImageArray | None:
        return self._whole(name, shot) if self._files.has(name) else None

    def _whole(self, name: str, shot: int) -> ImageArray:
        """Kept, unless the capture is large."""
        kept = self._kept.get((name, shot))
        if kept is None:
            kept = self._read(name, shot)
            if not self.is_large:
                with self._lock:
                    self._kept[name, shot] = kept
        return kept

    def _read(self, name: str, shot: int, region: Region | None = None) -> ImageArray:
        try:
            image = self._files.read(name, self._rows[shot], region)
        except DamagedTiles:
            left, top, width, height = region or (0, 0, *self._shapes[shot][::-1])
            image = self._anew(name, shot)[top : top + height, left : left + width]
        image.flags.writeable = False
        return image

    def _anew(self, name: str, shot: int) -> ImageArray:
        """What the capture itself says, where the store is damaged; kept, and the store is marked."""
        with suppress(OSError):
            (self.folder / DAMAGED).touch()
        try:
            unchanged = not has_changed(self._sources)
            decoded = altered(self._capture, shot, next(decode_masked(self._capture, [shot])))
        except FrogError as error:
            raise FrogError(
                f"{self.folder}: decoded frames are damaged, and cannot be decoded again: {error}"
            ) from error
        if not unchanged:
            expected = "what was written; the capture has changed meanwhile: start again, and it is decoded anew"
            raise found_instead(self.folder, "damaged frames", expected)
        images = parts_of(decoded)
        with self._lock:
            for kind, image in images.items():
                image.flags.writeable = False
                self._kept[kind, shot] = image
        return images[name]


def _memory_for_images() -> int:
    """Bytes."""
    try:
        memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    except (AttributeError, ValueError, OSError):  # Windows
        return _LEAST_KEPT
    return max(_LEAST_KEPT, int(memory * _KEPT_SHARE))


def _check_sizes(capture: Capture) -> None:
    """FrogError for images larger than a scene file allows."""
    for camera in capture.cameras:
        if max(camera.width, camera.height) > MAX_SIDE or camera.width * camera.height > MAX_PIXELS:
            found = f"images of {camera.width} x {camera.height} pixels of {camera.name}"
            expected = f"at most {MAX_SIDE:,} a side and {MAX_PIXELS:,} in all; choose a smaller image scale"
            raise found_instead(capture.path, found, expected)


def _opened(capture: Capture, folder: Path) -> FrameStore | None:
    """The store, which counts as used from now on; None where it is not there, or not whole."""
    for _ in range(_TRIES):
        try:
            store = FrameStore(capture, folder)
        except BlockingIOError:
            time.sleep(0.02)  # whoever deletes it holds it for no longer
            continue
        except (OSError, DamagedTiles):
            return None
        with suppress(OSError):
            os.utime(folder / limit.INDEX)
        return store
    return None
