"""EasyVolcap, EasyMocap, 4K4D and ENeRF: ``intri.yml``, ``extri.yml`` and ``images/NAME/000000.jpg`` or films.

Of a camera NAME in ``names``: ``K_NAME`` (3 x 3, pixels), ``D_NAME`` or ``dist_NAME`` (k1 k2 p1 p2 k3), ``H_NAME``
and ``W_NAME`` (optional), ``Rot_NAME`` (3 x 3) or ``R_NAME`` (rotation vector), ``T_NAME``: world to camera in
OpenCV's axes. (zju3dv/EasyVolcap, easyvolcap/utils/easy_utils.py; zju3dv/EasyMocap.)

Nothing is held out. Masks are not used.

Their files are of the YAML that OpenCV's FileStorage writes: ``key: !!opencv-matrix`` with rows, cols, dt and data;
``key: number``; ``key:`` with a list of names, or in brackets. Nothing else of YAML is read. An own reader: sizes and
types are checked here, and no other program's parser is trusted with what anybody may have written.
"""

import re
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...errors import found_instead
from ...io.regular_file import read_text
from ..capture import Capture
from ..video import VideoFacts
from .assembly import matched, standing_cameras
from .checks import number, numbers, pinhole, size
from .filmed import of_cameras
from .footage import MAX_CAMERAS
from .geometry import opencv_camera
from .projects import calibrations, recorded

_INTRINSICS, _EXTRINSICS = "intri.yml", "extri.yml"
# A key at a line's begin, and what follows it until the next one.
_ENTRY = re.compile(r'^"?([^\s:"#%\-\]][^:"\n]*)"?[ \t]*:(.*(?:\n(?:[ \t\-\]#%].*)?)*)', re.MULTILINE)
_FIELD = re.compile(r"^\s+(rows|cols|dt)\s*:\s*(\S+)\s*$", re.MULTILINE)
_DATA = re.compile(r"^\s+data\s*:\s*\[([^\]]*)\]", re.MULTILINE)
_EMPTY = re.compile(r"(~|null|\[\s*\]|!!opencv-matrix.*data\s*:\s*\[\s*\])?", re.DOTALL)
_MATRIX = "!!opencv-matrix"
_MOST_NUMBERS = 1000
_LONGEST = 2**24  # bytes: a camera takes a thousand


def matches(path: Path) -> bool:
    """True if the folder holds ``intri.yml``, here or below."""
    return any(calibrations(path, _INTRINSICS, _names))


def _size_by(lens: Float64s, film: VideoFacts) -> tuple[int, int]:
    """The size of a film as it is shown, or as it is stored where the lens is rounder then."""
    stretch = np.log(lens[0, 0] / lens[1, 1])
    is_stored = abs(stretch + np.log(film.header.aspect)) < abs(stretch)
    return film.stored if is_stored else (film.width, film.height)


def read(path: Path) -> Capture:
    """Open a folder of EasyVolcap's.

    Raises:
        FrogError: if ``extri.yml`` or all footage is missing, or a value cannot be used.
    """
    file = next(calibrations(path, _INTRINSICS, _names))
    if not (extrinsics := file.with_name(_EXTRINSICS)).is_file():
        found = f"{_INTRINSICS} and no {_EXTRINSICS}"
        raise found_instead(file.parent, found, "both: the cameras' lenses and their poses")
    inner, outer = _OpencvYaml(file), _OpencvYaml(extrinsics)
    names = inner.cameras()
    if not names or len(names) > MAX_CAMERAS or len(set(names)) < len(names):
        found = f"{len(names)} cameras" if names else "no camera"
        raise found_instead(inner.path, found, "names, each with a K_NAME")
    footage = recorded(path, names)
    sizes = {name: (inner.number(f"W_{name}"), inner.number(f"H_{name}")) for name in names}
    if not all(min(sides) > 0 for sides in sizes.values()):  # the file does not say it: that of the images
        filmed, _ = of_cameras(inner.path, names, footage)
        sizes = dict.fromkeys(names, (1.0, 1.0)) | {  # those without footage are left out
            name: _size_by(pinhole(inner.matrix(f"K_{name}").tolist(), inner.path, f"K_{name}"), film.facts)
            for name, film in filmed.items()
        }
    cameras = []
    for name, sides in sizes.items():
        width, height = (size(side, inner.path, f"{key}_{name}") for key, side in zip("WH", sides, strict=True))
        turn = next((key for key in (f"Rot_{name}", f"R_{name}") if key in outer.blocks), f"Rot_{name}")
        lens = next((key for key in (f"D_{name}", f"dist_{name}") if key in inner.blocks), None)
        values = {
            f"K_{name}": inner.matrix(f"K_{name}").tolist(),
            turn: outer.matrix(turn).tolist(),
            f"T_{name}": outer.matrix(f"T_{name}").tolist(),
            lens or f"D_{name}": inner.matrix(lens).tolist() if lens else [],
        }
        cameras.append(opencv_camera(name, (width, height), values, inner.path))
    return standing_cameras(path, "easyvolcap", *matched(inner.path, cameras, footage))


def _names(file: Path) -> list[str]:
    return _OpencvYaml(file).cameras()


class _OpencvYaml:
    """A file's values by key."""

    def __init__(self, path: Path) -> None:
        """Reads the file; FrogError where it is not such a file."""
        self.path = path
        self.blocks: dict[str, str] = {}
        for match in _ENTRY.finditer(read_text(path, "OpenCV's YAML", _LONGEST, foreign=True)):
            if not _EMPTY.fullmatch(value := match[2].strip()):  # a value that is left empty is none
                self.blocks.setdefault(match[1].strip(), value)
        if not self.blocks:
            raise found_instead(path, "no key with a value", "OpenCV's YAML (%YAML:1.0)")

    def matrix(self, key: str) -> Float64s:
        """(rows, cols) numbers.

        Raises:
            FrogError: if the key is not there or no matrix of at most ``_MOST_NUMBERS`` finite numbers.
        """
        block = self.blocks.get(key)
        if block is None or not block.startswith(_MATRIX):
            raise found_instead(self.path, f"no matrix {key}", f"{key}: {_MATRIX}")
        fields, data = dict(_FIELD.findall(block)), _DATA.search(block)
        if data is None or not {"rows", "cols"} <= fields.keys():
            raise found_instead(self.path, f"a matrix {key} without rows, cols or data", "all three")
        shape = tuple(round(number(np.array(fields[side]), self.path, f"{side} of {key}")) for side in ("rows", "cols"))
        values = [word for word in re.split(r"[\s,]+", data[1]) if word]
        if min(shape) < 1 or shape[0] * shape[1] != len(values) or len(values) > _MOST_NUMBERS:
            found = f"{len(values)} numbers in {key} of {shape[0]} x {shape[1]}"
            raise found_instead(self.path, found, f"as many as it has places, at most {_MOST_NUMBERS}")
        return np.reshape(numbers(np.array(values), (len(values),), self.path, key), shape)

    def number(self, key: str) -> float:
        """A number; 0 where the key is not there. FrogError for anything else."""
        return number(np.array(self.blocks.get(key, "0").strip()), self.path, key)

    def cameras(self) -> list[str]:
        """Their names: those listed, or else those that have a matrix K."""
        block = self.blocks.get("names", "")
        if block.startswith("["):
            items = block.strip("[] \n").split(",")
        else:
            items = [line.strip()[1:] for line in block.splitlines() if line.strip().startswith("-")]
        listed = [name for item in items if (name := item.strip().strip("\"'"))]
        return listed or [key[2:] for key in self.blocks if key.startswith("K_")]
