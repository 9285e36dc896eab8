"""The files of decoded frames: images, alpha and what is ignored, each in compressed tiles.

``NAME.tiles`` has the tiles, ``NAME.sizes`` the bytes of each of them (uint32, little-endian). Masks that say nothing
in any image are left out: nothing then costs more than without masks.
"""

import os
import zlib
from collections.abc import Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ..arrays import ImageArray
from ..capture.decoding import DecodedShot
from .codecs import TileCodec
from .image_coding import DamagedTiles, Grid, Region, TileFile, pack_image, read_image

IMAGE, ALPHA, IGNORED = "image", "alpha", "ignored"
_SILENT = {ALPHA: 255, IGNORED: 0}

Shape = tuple[int, int]
PackedShot = tuple[dict[str, list[bytes]], set[str]]
"""The tiles of a shot by file, and the masks among them that say something."""
Description = dict[str, int]
"""A checksum (CRC-32) of the tiles' sizes, by the file's name."""


def pack(shot: DecodedShot, has_masks: bool, codec: TileCodec) -> PackedShot:
    """Compresses a decoded shot."""
    parts = parts_of(shot)
    said = {name for name, silent in _SILENT.items() if has_masks and (parts[name] != silent).any()}
    return {name: pack_image(parts[name], codec) for name in names_of(has_masks)}, said


def parts_of(shot: DecodedShot) -> dict[str, ImageArray]:
    """(H, W, 3) the image, and (H, W) alpha and what is ignored; of a shot without, masks that say nothing."""
    masks, size = {ALPHA: shot.alpha, IGNORED: shot.ignored}, shot.image.shape[:2]
    said = {name: np.full(size, _SILENT[name], np.uint8) if mask is None else mask for name, mask in masks.items()}
    return {IMAGE: shot.image} | said


def names_of(has_masks: bool) -> list[str]:
    """The files of a store, without their endings; masks may be left out."""
    return [IMAGE, *([ALPHA, IGNORED] if has_masks else [])]


class FrameWriter:
    """Writes shots one after the other into a folder.

    Attributes:
        written: bytes so far.
    """

    def __init__(self, folder: Path, has_masks: bool) -> None:
        self._folder, self.written = folder, 0
        self._sizes: dict[str, list[int]] = {name: [] for name in names_of(has_masks)}
        self._said: set[str] = set()
        self._opened = ExitStack()
        self._files = {name: self._opened.enter_context((folder / f"{name}.tiles").open("wb")) for name in self._sizes}

    def add(self, packed: PackedShot) -> None:
        """The next shot. OSError if the disk does not take it."""
        tiles_of, said = packed
        for name, tiles in tiles_of.items():
            content = b"".join(tiles)
            self._files[name].write(content)
            self._sizes[name] += map(len, tiles)
            self.written += len(content)
        self._said |= said

    def finish(self) -> Description:
        """Ends the files, and leaves out the masks that say nothing."""
        described: Description = {}
        for name, file in self._files.items():
            file.flush()
            os.fsync(file.fileno())
            file.close()
            if name in _SILENT and name not in self._said:
                (self._folder / f"{name}.tiles").unlink()
                continue
            sizes = np.array(self._sizes[name], "<u4").tobytes()
            (self._folder / f"{name}.sizes").write_bytes(sizes)
            described[name] = zlib.crc32(sizes)
        return described

    def close(self) -> None:
        """Closes the files, whatever is in them."""
        with suppress(OSError):  # what was not written yet does not fit on the disk
            self._opened.close()


class FrameFiles:
    """The frames of a folder, read by any number of threads.

    Args:
        folder: where they are.
        shapes: (H, W) of the shots in the order in which they were written.
        description: what ``FrameWriter.finish`` returned.

    Raises:
        OSError: if a file cannot be opened.
        DamagedTiles: if one is not what was written, as far as its length tells.
    """

    def __init__(self, folder: Path, shapes: Sequence[Shape], description: Description) -> None:
        self._files, codec = dict[str, TileFile](), TileCodec()
        try:
            for name, checksum in description.items():
                grids = [Grid(*shape, 1 if name in _SILENT else 3) for shape in shapes]
                sizes = _read_sizes(folder / f"{name}.sizes", checksum)
                self._files[name] = TileFile(folder / f"{name}.tiles", grids, sizes, codec)
        except BaseException:
            self.close()
            raise

    def close(self) -> None:
        """No image can be read any more."""
        for file in self._files.values():
            file.close()

    def has(self, name: str) -> bool:
        """Whether masks of that kind say something of any image."""
        return name in self._files

    def read(self, name: str, row: int, region: Region | None = None) -> ImageArray:
        """(H, W, 3) an image, or (H, W) a mask, or a region of it. DamagedTiles if it is not what was written."""
        return read_image(self._files[name], row, region)


def _read_sizes(path: Path, checksum: int) -> NDArray[np.uint32]:
    content = path.read_bytes()
    if zlib.crc32(content) != checksum:
        raise DamagedTiles(f"{path}: other bytes than were written")
    return np.frombuffer(content, "<u4").astype(np.uint32)
