"""Decoded frames on disk, so that a capture larger than memory can be trained on.

Each video is decoded once, undistorted, resized to its camera and written as raw bytes into one file, which is then
memory mapped. The folder's name is a hash of everything that decides the bytes. It gets that name only when complete.
"""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import tempfile
import time
import weakref
from collections.abc import Callable
from pathlib import Path

import numpy as np

from ..arrays import ImageArray
from ..errors import FrogError, found_instead
from .camera import MAX_PIXELS, MAX_SIDE
from .capture import Capture, Distortion, Shot
from .decoding import decode_masked
from .mask_planes import MaskPlanes, PlaneWriter
from .masking import MaskSource
from .sharing import lock_exclusively, open_shared

_VERSION = 2  # raise it when the same capture would decode to other bytes
_PIXELS = "frames.raw"
_INDEX = "index.json"
_PARTIAL = ".partial-"
_ABANDONED_AFTER = 3600.0  # seconds without a write after which a partial store belongs to a killed process
_SPARE_BYTES = 256 << 20  # left free on the disk


class DecodingCancelled(Exception):
    """The caller's ``cancelled`` answered True during decoding. No FrogError: nothing is wrong with the input."""


class FrameStore:
    """The frames of a capture, uint8 sRGB, memory mapped read-only."""

    def __init__(self, capture: Capture, folder: Path) -> None:
        """Map a whole store; use ``open``, which makes it where it is missing."""
        self.folder = folder
        self._offsets, self._shapes, total = _layout(capture)
        self._pixels: ImageArray = np.memmap(folder / _PIXELS, dtype=np.uint8, mode="r", shape=(total,))
        self._map = weakref.ref(self._pixels._mmap)  # type: ignore[attr-defined]
        self._planes = MaskPlanes(folder) if capture.has_masks else MaskPlanes()
        self._in_use = open_shared(folder / _INDEX)

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
            FrogError: if a file is missing or cut off, images are too large, or the disk has no room.
        """
        _check_sizes(capture)
        cache = Path(cache_folder) if cache_folder is not None else default_cache_folder()
        sources = _sources(capture)
        folder = cache / _key(capture, sources)
        if not _is_whole(folder, capture):
            try:
                cache.mkdir(parents=True, exist_ok=True)
                _remove_stale(cache, capture)
                _build(folder, capture, sources, progress, cancelled)
            except OSError as error:
                reason = error.strerror or str(error)
                raise FrogError(f"{cache}: the decoded frames cannot be written here ({reason}).") from error
        return cls(capture, folder)

    def image(self, shot_index: int) -> ImageArray:
        """(H, W, 3) uint8 sRGB view of the memory map; ``shot_index`` counts in ``capture.shots``."""
        height, width = self._shapes[shot_index]
        offset = self._offsets[shot_index]
        return self._pixels[offset : offset + height * width * 3].reshape(height, width, 3)

    def alpha(self, shot_index: int) -> ImageArray | None:
        """(H, W) uint8 view of the subject's share of each pixel; None where all images are whole."""
        return self._planes.alpha(self._offsets[shot_index], self._shapes[shot_index])

    def ignored(self, shot_index: int) -> ImageArray | None:
        """(H, W) uint8 view, 255 for pixels that are to be ignored; None where none is in any image."""
        return self._planes.ignored(self._offsets[shot_index], self._shapes[shot_index])

    def __len__(self) -> int:
        return len(self._offsets)

    def give_up(self) -> int:
        """Deletes the frames from disk to free space. They can be decoded again; this store cannot be used any more.

        Returns:
            The bytes that were freed. 0, and nothing is deleted, if another process reads the same frames, or an image
            of this store is still referenced.
        """
        if not lock_exclusively(self._in_use):
            return 0
        size, self._pixels, self._in_use = self._pixels.size, np.empty(0, np.uint8), None
        self._planes = MaskPlanes()
        mapped = self._map()
        if mapped is not None:  # still referenced: closing it by force would crash the process
            self._pixels, self._in_use = np.frombuffer(mapped, np.uint8), open_shared(self.folder / _INDEX)
            return 0
        shutil.rmtree(self.folder, ignore_errors=True)
        return 0 if (self.folder / _PIXELS).exists() else size


def _check_sizes(capture: Capture) -> None:
    """FrogError for images larger than a scene file allows."""
    for camera in capture.cameras:
        if max(camera.width, camera.height) > MAX_SIDE or camera.width * camera.height > MAX_PIXELS:
            found = f"images of {camera.width} x {camera.height} pixels of {camera.name}"
            expected = f"at most {MAX_SIDE:,} a side and {MAX_PIXELS:,} in all; choose a smaller image scale"
            raise found_instead(capture.path, found, expected)


def default_cache_folder() -> Path:
    """``$FROG_CACHE``, or ``frog_blender`` in the platform's cache folder of this user."""
    if os.environ.get("FROG_CACHE"):
        return Path(os.environ["FROG_CACHE"])
    if os.name == "nt":
        base = os.environ.get("LOCALAPPDATA") or str(Path.home() / "AppData" / "Local")
    elif os.uname().sysname == "Darwin":
        base = str(Path.home() / "Library" / "Caches")
    else:
        base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "frog_blender"


def _layout(capture: Capture) -> tuple[list[int], list[tuple[int, int]], int]:
    """Byte offset and (H, W) of each shot, and all bytes; one camera's frames lie together, as they are written."""
    offsets = [0] * len(capture.shots)
    shapes = [(0, 0)] * len(capture.shots)
    total = 0
    for index in decoding_order(capture):
        camera = capture.cameras[capture.shots[index].camera]
        offsets[index], shapes[index] = total, (camera.height, camera.width)
        total += camera.height * camera.width * 3
    return offsets, shapes, total


def decoding_order(capture: Capture) -> list[int]:
    """Indices of the shots, one file after the other, in ascending frames."""

    def place(index: int) -> tuple[int, str, int]:
        shot: Shot = capture.shots[index]
        return (shot.camera, str(shot.path), shot.index)

    return sorted(range(len(capture.shots)), key=place)


def _facts(path: Path) -> list[int]:
    """Size and modification time, which tell whether a file has changed. OSError if it cannot be read."""
    facts = path.stat()
    return [facts.st_size, facts.st_mtime_ns]


def _sources(capture: Capture) -> dict[str, list[int]]:
    """The capture's files and their facts."""
    sources = {}
    masks = {mask.path for shot in capture.shots for mask in (shot.mask, shot.ignore) if mask}
    for path in sorted({shot.path for shot in capture.shots} | masks):
        try:
            sources[str(path.resolve())] = _facts(path)
        except OSError as error:
            raise FrogError(
                f"{path}: the file cannot be read ({error.strerror}), expected a part of the capture."
            ) from error
    return sources


def decoding_key(capture: Capture) -> str:
    """A hash of all that decides the decoded bytes: the files as they are now, cameras, lenses, which frames of what.

    Raises:
        FrogError: if a file of the capture is missing.
    """
    return _key(capture, _sources(capture))


def is_decoded(capture: Capture) -> bool:
    """True when the default cache folder has the frames of a capture whose cameras have the frames' sizes."""
    try:
        return _is_whole(default_cache_folder() / decoding_key(capture), capture)
    except FrogError:  # a file of the capture is missing
        return False


def _key(capture: Capture, sources: dict[str, list[int]]) -> str:
    cameras = [
        [c.width, c.height, c.intrinsics.tolist(), _distortion_key(d), crop]
        for c, d, crop in zip(capture.cameras, capture.distortions, capture.crops, strict=True)
    ]
    shots = [[s.camera, s.frame, str(s.path.resolve()), s.index] for s in capture.shots]
    decides = [_VERSION, sources, cameras, shots, capture.background]
    if capture.has_masks:
        decides += [str(capture.key), [[_mask_key(shot.mask), _mask_key(shot.ignore)] for shot in capture.shots]]
    if capture.alteration is not None:
        decides += [capture.alteration.key, sorted(capture.test_cameras), sorted(capture.test_frames)]
    return hashlib.sha256(json.dumps(decides).encode()).hexdigest()[:32]


def _mask_key(mask: MaskSource | None) -> list[object]:
    if mask is None:
        return []
    return [str(mask.path.resolve()), mask.index, mask.is_alpha, *(["inverted"] if mask.inverted else [])]


def _distortion_key(distortion: Distortion | None) -> list[float] | dict[str, object] | None:
    if distortion is None:
        return None
    coefficients = distortion.coefficients.tolist()
    if distortion.lens is not None:
        return {"model": distortion.model, "coefficients": coefficients, "lens": distortion.lens.tolist()}
    return {"coefficients": coefficients, "skew": distortion.skew} if distortion.skew else coefficients


def _is_whole(folder: Path, capture: Capture) -> bool:
    """True if the store exists and has all its bytes."""
    try:
        total = _layout(capture)[2]
        whole = (folder / _INDEX).is_file() and (folder / _PIXELS).stat().st_size == total
        return whole and (not capture.has_masks or MaskPlanes.are_whole(folder, total // 3))
    except OSError:
        return False


def _remove_stale(cache: Path, capture: Capture) -> None:
    """Remove what killed runs left, and stores of this capture whose source files have changed since.

    Stores of some of its cameras, or of altered images, stay.
    """
    for entry in cache.iterdir():
        try:
            if _PARTIAL in entry.name:
                newest = max((p.stat().st_mtime for p in [entry, *entry.iterdir()]), default=0.0)
                if time.time() - newest > _ABANDONED_AFTER:
                    shutil.rmtree(entry, ignore_errors=True)
            elif (entry / _INDEX).is_file():
                index = json.loads((entry / _INDEX).read_text(encoding="utf-8"))
                if index["capture"] == str(capture.path.resolve()) and _changed(index["sources"]):
                    shutil.rmtree(entry, ignore_errors=True)
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            continue  # not ours to remove


def _changed(sources: object) -> bool:
    """Whether a source file of a store has changed. Indices of older versions list no files."""
    if not isinstance(sources, dict):
        return True
    try:
        return any(_facts(Path(path)) != facts for path, facts in sources.items())
    except OSError:
        return True


def _altered(capture: Capture, index: int, image: ImageArray) -> ImageArray:
    """A decoded image as the capture shows it, contiguous."""
    shot, alteration = capture.shots[index], capture.alteration
    if alteration is None or (capture.is_test(shot) and not alteration.tests_too):
        return image
    return np.ascontiguousarray(alteration.apply(image, capture.cameras[shot.camera].name, shot.frame))


def _build(
    folder: Path,
    capture: Capture,
    sources: dict[str, list[int]],
    progress: Callable[[int, int], None] | None,
    cancelled: Callable[[], bool] | None,
) -> None:
    """Decode into a temporary folder and rename it to ``folder``."""
    total = _layout(capture)[2]
    room = total * 5 // 3 if capture.has_masks else total
    free = shutil.disk_usage(folder.parent).free
    if free < room + _SPARE_BYTES:
        raise FrogError(
            f"{folder.parent}: the decoded frames need {room / 1e9:.2f} GB, found {free / 1e9:.2f} GB free: "
            "choose a smaller image scale, or another cache folder with FROG_CACHE."
        )
    partial = Path(tempfile.mkdtemp(prefix=folder.name + _PARTIAL, dir=folder.parent))
    try:
        with (partial / _PIXELS).open("wb") as file:
            file.truncate(total)
            order = decoding_order(capture)
            planes = PlaneWriter(partial)
            for done, (index, shot) in enumerate(zip(order, decode_masked(capture, order), strict=True), start=1):
                if cancelled is not None and cancelled():
                    raise DecodingCancelled(f"{capture.path}: decoding was cancelled.")
                file.write(_altered(capture, index, shot.image).data)
                if capture.has_masks:
                    planes.add(shot)
                if progress is not None:
                    progress(done, len(capture.shots))
            file.flush()
            os.fsync(file.fileno())
            planes.close()
        facts = {"capture": str(capture.path.resolve()), "sources": sources, "shots": len(capture.shots)}
        (partial / _INDEX).write_text(json.dumps(facts), encoding="utf-8")
        _put(partial, folder, capture)
    finally:
        shutil.rmtree(partial, ignore_errors=True)


def _put(partial: Path, folder: Path, capture: Capture) -> None:
    """Renames a finished store, unless another process put the same one there first, which may be in use by now."""
    try:
        partial.rename(folder)
    except OSError:
        if _is_whole(folder, capture):
            return
        shutil.rmtree(folder, ignore_errors=True)  # a store that lost bytes
        partial.rename(folder)
