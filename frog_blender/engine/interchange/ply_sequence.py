"""A folder or zip of 3DGS ``.ply`` files, one a frame, as other trainers and players write them: a ``FrameSource``.

Files are taken in the order of the numbers in their names. Where the first says so (see ``ply.PROMISE``), the same row
is the same Gaussian in all of them; where none does, it is looked at what moves how far.
"""

from __future__ import annotations

import io
import re
import zipfile
import zlib
from pathlib import Path

from ..capture.camera import Camera
from ..errors import FrogError, brief, found_instead
from ..gaussians import NumpyGaussians
from ..io.regular_file import regular_file
from ..playback.frame_delta import canonical_gaussians
from ..scene.header import MAX_FRAMES
from .ply import promises_order, read_splats, splats_in

_EXPECTED = "a folder or .zip of 3DGS .ply files"
_PIECES = re.compile(r"(\d+)")
_LARGEST = 8 << 30  # bytes of a frame's file
_MOST_PACKED = 1032  # bytes that one of a zip can become


class PlySequence:
    """The frames of a folder or zip.

    Args:
        path: of the folder or zip.
        rate: frames a second, which no file says.
    """

    origin = "plys"
    cameras: tuple[Camera, ...] = ()

    def __init__(self, path: Path, rate: float) -> None:
        self._path, self.rate, self.left_out = path, rate, 0
        if not 1e-3 <= rate <= 1e4:
            raise FrogError(f"{path}: found {rate:g} frames a second, expected 0.001 to 10,000.")
        self._archive: zipfile.ZipFile | None = None
        if path.is_dir():
            names = [each.name for each in path.iterdir() if each.suffix.lower() == ".ply"]
        else:
            regular_file(path, _EXPECTED)
            try:
                self._archive = zipfile.ZipFile(path)
                names = [name for name in self._archive.namelist() if name.lower().endswith(".ply")]
            except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
                raise found_instead(path, f"a zip that cannot be opened ({brief(error)})", _EXPECTED) from error
        self._names = sorted((name for name in names if not _is_hidden(name)), key=_by_number)
        self.frame_count = len(self._names)
        if not 1 <= self.frame_count <= MAX_FRAMES:
            raise found_instead(path, f"{self.frame_count:,} .ply files", _EXPECTED)
        self.keeps_identity: bool | None = True if promises_order(self._file(0)) else None

    def at(self, frame: int) -> NumpyGaussians:
        """A frame, counted from 0, with the file's own axes."""
        place = self._path / self._names[frame]
        splats = read_splats(place) if self._archive is None else splats_in(place, self._file(frame))
        self.left_out = max(self.left_out, splats.left_out)
        if not splats.world.is_plain:
            raise found_instead(place, "coordinates that need more than single precision", "local ones")
        return canonical_gaussians(splats.arrays)

    def _file(self, frame: int) -> io.BytesIO:
        """What a frame's file holds, or of a folder's how it begins."""
        name = self._names[frame]
        if self._archive is None:
            with regular_file(self._path / name, "a 3DGS .ply").open("rb") as file:
                return io.BytesIO(file.read(1 << 16))
        entry = self._archive.getinfo(name)
        if entry.file_size > min(_LARGEST, _MOST_PACKED * max(entry.compress_size, 1)):
            raise found_instead(self._path, f"{entry.file_size:,} bytes of {brief(name)}", "what its size allows for")
        try:
            with self._archive.open(entry) as packed:
                return io.BytesIO(packed.read(entry.file_size))
        except (zipfile.BadZipFile, zlib.error, OSError, ValueError, RuntimeError, EOFError) as error:
            sentence = f"{brief(name)}, which cannot be unpacked ({brief(error)})"
            raise found_instead(self._path, sentence, _EXPECTED) from error


def _is_hidden(name: str) -> bool:
    """What systems put into zips for themselves."""
    return any(part.startswith((".", "__MACOSX")) for part in name.split("/"))


def _by_number(name: str) -> list[tuple[int, int, str]]:
    """So that 10 comes after 9."""
    pieces = _PIECES.split(name)
    return [(1, int(piece[:18]), "") if piece.isdecimal() else (0, 0, piece) for piece in pieces]
