"""Frames of a scene as files for other programs, one a frame: 3DGS ``.ply``, packed or not, ``.sog``, ``.spz`` or
``.glb``.

No ``.ply`` or ``.sog`` says which way is up; most viewers take y for down. Here numbers go in and out with the axes
that they have, unless a turn is asked for; in Blender's menus, where z is up, the export turns to y down and the import
back again.
"""

from collections.abc import Iterator, Sequence
from pathlib import Path

from ..arrays import Array
from ..gaussians import NumpyGaussians
from ..io.atomic_files import write_atomically
from ..playback.render_files import PlayedFrames
from ..playback.transform import transform
from .gltf import glb_bytes
from .ply import compressed_bytes, splat_bytes
from .sog import sog_bytes
from .spz import Spz, spz_bytes
from .stills import decoding

AS_THEY_ARE = (".ply", ".compressed.ply", ".sog")
"""Endings of formats that do not say which way is up."""
_COMPRESSED, _SPZ = AS_THEY_ARE[1], Spz()


def numbered(path: Path, frame: int) -> Path:
    """The file of one frame of several that are written as ``path``: ``NAME_0007.ply``."""
    return path.with_name(f"{path.name.removesuffix(ending(path))}_{frame:04d}{ending(path)}")


def ending(path: Path) -> str:
    """The part of its name that says the format, in lower or upper case."""
    return path.name[-len(_COMPRESSED) :] if path.name.lower().endswith(_COMPRESSED) else path.suffix


def write_frame(path: Path, gaussians: NumpyGaussians, *, promise: bool = False, spz: Spz = _SPZ) -> None:
    """Writes Gaussians in the format of the path's ending, atomically; FrogError when it cannot.

    Args:
        path: ends as one of AS_THEY_ARE, which take the axes as they are, or in .spz or .glb, for which z is up.
        promise: see ``splat_bytes``; of a .ply that is not packed.
        spz: of a .spz alone.
    """
    with decoding(path, "Gaussians that its format can hold"):
        match ending(path).lower():
            case ".spz":
                content = spz_bytes(gaussians, spz)
            case ".compressed.ply":
                content = compressed_bytes(gaussians)
            case ".sog":
                content = sog_bytes(gaussians)
            case ".glb":
                content = glb_bytes(gaussians)
            case _:
                content = splat_bytes(gaussians, promise=promise)
    write_atomically(path, content)


def export_frames(
    scene: PlayedFrames, frames: Sequence[int], path: Path, *, turn: Array | None = None, spz: Spz = _SPZ
) -> Iterator[Path]:
    """Writes frames (counted from 0) of a scene, each atomically; yields their paths as they are written.

    Count and order of the Gaussians are the same in all of them, which the headers of several say where it is true.

    Args:
        path: of all of them, see ``numbered``.
        turn: (4, 4) from the scene's own axes to those of the files, such as Y_DOWN; None to leave them.
        spz: see ``write_frame``.
    """
    promise = len(frames) > 1 and scene.keeps_identity
    for frame in frames:
        gaussians = scene.at_frame(frame)
        placed = gaussians if turn is None else transform(gaussians, turn)
        write_frame(numbered(path, frame), placed, promise=promise, spz=spz)
        yield numbered(path, frame)
