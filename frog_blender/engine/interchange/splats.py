"""Scenes to and from other programs: frames as 3DGS ``.ply`` files, and such a file as a static scene.

No ``.ply`` says which way is up; most viewers take y for down. Here numbers go in and out with the axes that they have,
unless a turn is asked for; in Blender's menus, where z is up, the export turns to y down and the import back again.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path

from ..arrays import Array
from ..field.names import CANONICAL
from ..gaussians import NumpyGaussians
from ..playback.render_files import PlayedFrames
from ..playback.transform import transform
from ..scene.quantization import morton_order
from ..scene.scene_file import SceneFile, write_scene
from .frame_source import Imported, check_ending, imported_header
from .gltf import write_glb
from .ply import read_splats, write_splats
from .spz import VERSIONS as SPZ_VERSIONS
from .spz import write_spz

FROM_PLY = "ply"
"""``capture_format`` of a scene that is a ``.ply`` of another program."""


def import_splats(
    source: Path, target: Path, *, compact: bool = False, progress: Callable[[int, int], None] = lambda done, of: None
) -> Imported:
    """Writes a 3DGS ``.ply`` as a static scene without cameras; FrogError when it cannot, and nothing is changed then.

    Args:
        compact: pack the scene (see quantization): several times smaller, without a visible difference.
        progress: told how many of how many steps are done.
    """
    check_ending(target)
    splats = read_splats(source)
    progress(1, 2)
    arrays = splats.arrays
    if compact:  # neighbours in the file are packed well if they are neighbours in the scene
        order = morton_order(arrays["means"])
        arrays = {name: array[order] for name, array in arrays.items()}
    assert arrays.keys() == CANONICAL
    header = imported_header(source, FROM_PLY, world=splats.world)
    write_scene(target, SceneFile(header, arrays), compact=compact)
    return Imported(target, len(arrays["means"]), splats.left_out, splats.world)


def numbered(path: Path, frame: int) -> Path:
    """The file of one frame of several that are written as ``path``: ``NAME_0007.ply``."""
    return path.with_name(f"{path.stem}_{frame:04d}{path.suffix}")


def write_frame(
    path: Path, gaussians: NumpyGaussians, *, promise: bool = False, spz_version: int = SPZ_VERSIONS[0]
) -> None:
    """Writes Gaussians in the format of the path's ending, atomically; FrogError when it cannot.

    Args:
        path: ends in .ply, which takes the axes as they are, or .spz or .glb, for which z is up.
        promise: see ``write_splats``; of a .ply alone.
        spz_version: see ``write_spz``; of a .spz alone.
    """
    match path.suffix.lower():
        case ".spz":
            write_spz(path, gaussians, version=spz_version)
        case ".glb":
            write_glb(path, gaussians)
        case _:
            write_splats(path, gaussians, promise=promise)


def export_frames(
    scene: PlayedFrames,
    frames: Iterable[int],
    folder: Path,
    stem: str,
    report: Callable[[int], None] | None = None,
    turn: Array | None = None,
    *,
    suffix: str = ".ply",
    spz_version: int = SPZ_VERSIONS[0],
) -> list[Path]:
    """Writes frames (counted from 0) of a scene as ``STEM_0000.ply`` and so on, each atomically; returns their paths.

    Count and order of the Gaussians are the same in all of them, which the headers of several say where it is true.

    Args:
        report: is told how many are done after each.
        turn: (4, 4) from the scene's own axes to those of the files, such as Y_DOWN; None to leave them.
        suffix, spz_version: see ``write_frame``.
    """
    paths: list[Path] = []
    chosen = list(frames)
    for frame in chosen:
        path = numbered(folder / f"{stem}{suffix}", frame)
        gaussians = scene.at_frame(frame)
        placed = gaussians if turn is None else transform(gaussians, turn)
        write_frame(path, placed, promise=len(chosen) > 1 and scene.keeps_identity, spz_version=spz_version)
        paths.append(path)
        if report is not None:
            report(len(paths))
    return paths
