"""The child's task for clocks: synchronisation, in a process whose matrix library has one thread.

The matrices are small: in the caller's process several threads would mostly wait for each other, and while the caller
is Blender, its window would wait too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from ...arrays import Float64s
from ...io.plain_values import JsonList, JsonObject
from ..camera import Camera
from ..capture import Distortion
from ..readers.geometry import distortion
from ..synchronization import NamedTracks, synchronize
from ..video import load_opencv
from .work_folder import WorkFolder

STAGE = "synchronisation"
_PARTS = 1000


def request_of(
    films: Mapping[str, Path],
    cameras: Mapping[str, tuple[Camera, Distortion | None]],
    tracks: Mapping[str, NamedTracks] | None,
    work: WorkFolder,
) -> JsonObject:
    """What ``clocks`` is asked; lenses have OpenCV's coefficients alone, as calibration finds them."""
    return {
        "tracks": tracks and {name: [track.times.tolist(), _plain(track.positions)] for name, track in tracks.items()},
        "work": str(work.path.absolute()),
        "films": {name: str(path.absolute()) for name, path in films.items()},
        "cameras": [
            {
                "name": name,
                "size": [camera.width, camera.height],
                "intrinsics": camera.intrinsics.tolist(),
                "pose": camera.world_to_camera.tolist(),
                "distortion": [] if lens is None else np.asarray(lens.coefficients).tolist(),
            }
            for name, (camera, lens) in cameras.items()
        ],
    }


def _plain(values: Float64s) -> JsonList:
    """Lists of numbers, None for NaN."""
    plain = values.astype(object)
    plain[np.isnan(values)] = None
    return list(plain.tolist())


def clocks(request: JsonObject, tell: Callable[[str, int, int], None]) -> JsonObject:
    """The synchronisation of a request's films as plain values (``Synchronization.to_json``)."""
    load_opencv().setNumThreads(1)  # films and pairs of them share the processors
    cameras, lenses = {}, {}
    for entry in request["cameras"]:
        name, (width, height) = str(entry["name"]), entry["size"]
        intrinsics, pose = (np.asarray(entry[key], np.float64) for key in ("intrinsics", "pose"))
        cameras[name] = Camera(name, int(width), int(height), intrinsics, pose)
        lenses[name] = distortion(np.asarray(entry["distortion"], np.float64)) if entry["distortion"] else None

    def progress(_what: str, share: float) -> None:
        tell(STAGE, round(share * _PARTS), _PARTS)

    films = {str(name): Path(path) for name, path in request["films"].items()}
    tracks = {
        str(name): NamedTracks(*(np.asarray(values, np.float64) for values in track))
        for name, track in (request["tracks"] or {}).items()
    }
    kept = WorkFolder(Path(request["work"]))
    found = synchronize(films, cameras or None, distortions=lenses, tracks=tracks, progress=progress, kept=kept)
    return found.to_json()
