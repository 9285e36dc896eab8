"""The frames of a folder or zip of 3DGS ``.ply`` files, one a frame."""

import io
import re
import zipfile
from pathlib import Path

from ..capture.natural_order import natural
from ..errors import FrogError, found_instead
from ..gaussians import NumpyGaussians
from ..io.regular_file import regular_file
from ..io.unpacking import check_growth, zip_member
from ..scene.header import MAX_FRAMES
from .frame_source import FrameSource
from .ply import LONGEST_HEADER, PROMISE, read_splats, splats_in
from .stills import decoding

_FRAMES = "a folder or .zip of 3DGS .ply files"


class PlySequence(FrameSource):
    """The frames of a folder or zip of files, one a frame, as other trainers and players write them.

    Files are taken in the order of the numbers in their names. Where the first says so (see PROMISE), the same row is
    the same Gaussian in all of them; where none does, it is looked at what moves how far.

    Args:
        path: of the folder or zip.
        rate: frames a second, which no file says.
    """

    origin = "plys"

    def __init__(self, path: Path, rate: float) -> None:
        self._path, self.rate = path, rate
        if not 1e-3 <= rate <= 1e4:
            raise FrogError(f"{path}: found {rate:g} frames a second, expected 0.001 to 10,000.")
        self._archive: zipfile.ZipFile | None = None
        if path.is_dir():
            names = [file.name for file in path.iterdir() if file.suffix.lower() == ".ply"]
        else:
            regular_file(path, _FRAMES)
            with decoding(path, _FRAMES):
                self._archive = zipfile.ZipFile(path)
                names = [name for name in self._archive.namelist() if name.lower().endswith(".ply")]
                unpacked = sum(self._archive.getinfo(name).file_size for name in names)
                check_growth("frames", path.stat().st_size, unpacked)  # of which several may be the same bytes
        # Without what systems put into zips for themselves.
        self._names = sorted((name for name in names if not re.search(r"(^|/)(\.|__MACOSX)", name)), key=natural)
        self.frame_count = len(self._names)
        if not 1 <= self.frame_count <= MAX_FRAMES:
            raise found_instead(path, f"{self.frame_count:,} .ply files", _FRAMES)
        head = self._file(0).read(LONGEST_HEADER).partition(b"\nend_header")[0]
        self.keeps_identity = True if PROMISE.encode() in head.splitlines() else None

    def at(self, frame: int) -> NumpyGaussians:
        """A frame, counted from 0, with the file's own axes."""
        path = self._path / self._names[frame]
        splats = read_splats(path) if self._archive is None else splats_in(path, self._file(frame))
        self.left_out = max(self.left_out, splats.left_out)
        self.notes = tuple(dict.fromkeys((*self.notes, *splats.notes)))
        if splats.frame_count > 1:
            raise found_instead(path, "Gaussians that move by themselves", "one frame; import this file alone")
        if not splats.world.is_plain:
            raise found_instead(path, "coordinates that need more than single precision", "local ones")
        return splats.gaussians

    def _file(self, frame: int) -> io.BytesIO:
        """What a frame's file holds, or of a folder's how it begins."""
        name = self._names[frame]
        if self._archive is None:
            with regular_file(self._path / name, "a 3DGS .ply").open("rb") as file:
                return io.BytesIO(file.read(LONGEST_HEADER))
        with decoding(self._path / name, "a 3DGS .ply"):
            return io.BytesIO(zip_member(self._archive, name))
