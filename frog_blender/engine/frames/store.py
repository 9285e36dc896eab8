"""Decoded frames on disk, so that a capture larger than memory can be trained on.

Each video is decoded once, undistorted, resized to its camera and compressed without loss. The folder's name is a hash
of everything that decides the pixels. It gets that name only when complete.
"""

from __future__ import annotations

import os
import tempfile
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from typing import BinaryIO

from ..arrays import ImageArray
from ..capture.camera import MAX_PIXELS, MAX_SIDE
from ..capture.capture import Capture
from ..capture.decoding import decode_masked
from ..capture.frame_keys import bytes_of, decoding_order, has_changed, key_of, shapes_of, sources_of
from ..capture.sharing import lock_exclusively, open_shared
from ..errors import FrogError, found_instead
from ..io.cache_folder import default_cache_folder
from .building import DAMAGED, altered, build, opened_files, remove_stale
from .files import ALPHA, IGNORED, FrameFiles, masks_of
from .image_coding import Region, halved_image
from .limit import INDEX, remove_store, size_of
from .tiles import DamagedTiles

_IMAGE = "image"
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
        self._shapes = shapes_of(capture)
        self._rows = {shot: row for row, shot in enumerate(decoding_order(capture))}
        self._in_use: BinaryIO | None
        self._files: FrameFiles
        self._open_files()
        self._kept: dict[_Key, ImageArray] = {}
        self._lock = threading.Lock()
        self.is_large = sum(map(bytes_of, self._shapes)) > _memory_for_images()
        self._reader: ThreadPoolExecutor | None = None
        self._ahead: list[tuple[_Asked, Future[ImageArray]]] = []

    @classmethod
    def open(
        cls,
        capture: Capture,
        *,
        cache_folder: Path | None = None,
        progress: Callable[[int, int], None] | None = None,
        cancelled: Callable[[], bool] | None = None,
    ) -> FrameStore:
        """The store of a capture, decoded now unless an earlier run left it.

        Args:
            capture: its cameras' sizes are the frames' sizes.
            cache_folder: where stores live; by default ``$FROG_CACHE`` or the user's cache folder.
            progress: called with (frames done, frames in all) after each frame.
            cancelled: asked before each frame.

        Raises:
            DecodingCancelled: if ``cancelled`` said so.
            FrogError: if a file is missing or cut off, images are too large, or disk or limit have no room.
        """
        _check_sizes(capture)
        cache = Path(cache_folder) if cache_folder is not None else default_cache_folder()
        sources = sources_of(capture)
        folder = cache / key_of(capture, sources)
        for _ in range(_TRIES):
            if (store := _opened(capture, folder)) is not None:
                return store
            try:
                cache.mkdir(parents=True, exist_ok=True)
                remove_stale(cache, capture)
                build(folder, capture, sources, progress, cancelled)
            except OSError as error:
                reason = error.strerror or str(error)
                raise FrogError(f"{cache}: the decoded frames cannot be written here ({reason}).") from error
        raise FrogError(f"{folder}: another process deletes the decoded frames as often as they are written.")

    def image(self, shot_index: int) -> ImageArray:
        """(H, W, 3) uint8 sRGB; ``shot_index`` counts in ``capture.shots``.

        Raises:
            FrogError: if it is damaged, and the capture is not there any more.
        """
        kept = self._kept.get((_IMAGE, shot_index))
        return self._keep(_IMAGE, shot_index, self._read(_IMAGE, shot_index)) if kept is None else kept

    def part(self, shot_index: int, region: Region, is_half: bool = False) -> ImageArray:
        """A region (left, top, width, height) of an image, or of the one of half its size; errors as of ``image``."""
        for index, (asked, reading) in enumerate(self._ahead):
            if asked == (shot_index, region, is_half):
                del self._ahead[: index + 1]
                return reading.result()
        return self._part(shot_index, region, is_half)

    def prefetch(self, shot_index: int, region: Region, is_half: bool = False) -> None:
        """Begins to read what ``part`` will probably be asked for next."""
        if (_IMAGE, shot_index) in self._kept:
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
        if not lock_exclusively(self._in_use):
            return 0
        if self._reader is not None:
            self._reader.shutdown()
        self._in_use, self._ahead, self._reader, self._kept = None, [], None, {}
        size = size_of(self.folder)
        self._files.close()
        if remove_store(self.folder):
            return size
        with suppress(OSError, DamagedTiles):  # somebody else has opened them meanwhile
            self._open_files()
        return 0

    def _open_files(self) -> None:
        self._in_use = open_shared(self.folder / INDEX)
        try:
            if self._in_use is not None:
                found, here = os.fstat(self._in_use.fileno()), (self.folder / INDEX).stat()
                if not os.path.samestat(found, here):
                    raise DamagedTiles(f"{self.folder}: another process replaced it")
            self._sources, self._files = opened_files(self.folder, self._capture)
        except BaseException:
            if self._in_use is not None:
                self._in_use.close()
            raise

    def _part(self, shot: int, region: Region, is_half: bool) -> ImageArray:
        left, top, width, height = region
        kept = self._kept.get((_IMAGE, shot))
        if kept is None and not self.is_large:
            kept = self.image(shot)
        if kept is not None:
            return (halved_image(kept) if is_half else kept)[top : top + height, left : left + width]
        if is_half:
            return self._half(shot)[top : top + height, left : left + width]
        return self._read(_IMAGE, shot, region)

    def _half(self, shot: int) -> ImageArray:
        try:
            return self._files.half(self._rows[shot])
        except DamagedTiles:
            return halved_image(self._anew(_IMAGE, shot))

    def _mask(self, name: str, shot: int) -> ImageArray | None:
        if not self._files.has(name):
            return None
        kept = self._kept.get((name, shot))
        return self._keep(name, shot, self._read(name, shot)) if kept is None else kept

    def _read(self, name: str, shot: int, region: Region | None = None) -> ImageArray:
        row = self._rows[shot]
        try:
            image = self._files.image(row, region) if name == _IMAGE else self._files.mask(name, row, region)
        except DamagedTiles:
            left, top, width, height = region or (0, 0, *self._shapes[shot][::-1])
            image = self._anew(name, shot)[top : top + height, left : left + width]
        image.flags.writeable = False
        return image

    def _keep(self, name: str, shot: int, image: ImageArray) -> ImageArray:
        if not self.is_large:
            with self._lock:
                self._kept[name, shot] = image
        return image

    def _anew(self, name: str, shot: int) -> ImageArray:
        """What the capture itself says, where the store is damaged; kept, and the store is marked."""
        with suppress(OSError):
            (self.folder / DAMAGED).touch()
        try:
            unchanged = not has_changed(self._sources)
            (found,) = (altered(self._capture, shot, each) for each in decode_masked(self._capture, [shot]))
        except FrogError as error:
            raise FrogError(
                f"{self.folder}: decoded frames are damaged, and cannot be decoded again: {error}"
            ) from error
        if not unchanged:
            expected = "what was written; the capture has changed meanwhile: start again, and it is decoded anew"
            raise found_instead(self.folder, "damaged frames", expected)
        images = {_IMAGE: found.image, **masks_of(found)}
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
        except (OSError, DamagedTiles):
            return None
        if store._in_use is not None or not _is_lockable(folder):
            with suppress(OSError):
                os.utime(folder / INDEX)
            return store
        time.sleep(0.02)  # whoever deletes it holds it for no longer
    return None


def _is_lockable(folder: Path) -> bool:
    """Whether somebody may hold a lock on the store: some network disks have none."""
    try:
        file = open_shared(folder / INDEX)
        if file is not None:
            file.close()
        with tempfile.TemporaryFile(dir=folder.parent) as probe:
            return lock_exclusively(probe)
    except OSError:
        return False
