"""How a scene of segments is at its seams: PSNR near them and elsewhere, and how much images change between frames.

    python benchmarks/seams.py SCENE.frog CAPTURE [--like SEGMENTED.frog] [--strip PICTURE.png]

CAPTURE has images of the scene's frames, by the cameras that trained it or others in the same world. ``--like`` asks a
scene in one piece at another one's seams. ``--strip`` draws the frames around a seam: what was filmed above, the scene
below. Prints a JSON object.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path

import cv2
import numpy as np

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import render_image
from frog_blender.engine.scene.segments import segments_of

NEAR = 5
"""Frames on each side of a seam that count as near."""
_STILL = 2.0  # levels of 255 by which a filmed pixel may change from a frame to the next and count as still
_LOOKED_AT, _MOVING = 60, 6.0  # frames, and the standard deviation in levels of 255 above which a pixel moves
_TIMED = 60


class Seen:
    """Images of a scene and of a capture, by camera and frame."""

    def __init__(self, scene: ScenePlayer, capture: Capture) -> None:
        self._scene, self._capture, self._store = scene, capture, FrameStore.open(capture)
        known = {camera.name: camera for camera in scene.header.cameras}
        self.cameras = [known.get(camera.name, camera) for camera in capture.cameras]

    @lru_cache  # noqa: B019
    def moving(self, camera: int) -> np.ndarray:
        """(H, W) bool, pixels that change over time, as ``frog eval`` has them; all where none does."""
        last = self._scene.header.frame_count - 1
        frames = np.linspace(0, last, _LOOKED_AT).round().astype(int).tolist()
        images = [self._store.image(self._capture.shot_index(camera, frame) or 0) for frame in frames]
        changes = np.std(images, axis=0).max(axis=2) > _MOVING
        return changes if changes.any() else ~changes

    def pair(self, camera: int, frame: int) -> tuple[np.ndarray, np.ndarray]:
        """(H, W, 3) float64 what was filmed, and what the scene shows, in levels of 255."""
        index = self._capture.shot_index(camera, frame)
        assert index is not None
        drawn = render_image(self._scene.at_frame(frame), self.cameras[camera], self._scene.header.background)
        return self._store.image(index).astype(np.float64), drawn.astype(np.float64)


def psnr(seen: Seen, frames: Iterable[int], *, moving: bool = False) -> float:
    """Mean PSNR of frames over all cameras, in dB; of ``moving`` regions alone."""
    values = []
    for frame in frames:
        for camera in range(len(seen.cameras)):
            filmed, drawn = seen.pair(camera, frame)
            squares = np.square(filmed - drawn)
            counted = squares[seen.moving(camera)] if moving else squares
            values.append(10 * np.log10(255**2 / max(float(counted.mean()), 1e-9)))
    return round(float(np.mean(values)), 2)


def changes(seen: Seen, frames: Iterable[int]) -> dict[str, float]:
    """How much images change from the frame before each of some frames, in levels of 255: by how much more than what
    was filmed does, by how much the error does, and by how much where what was filmed stands still."""
    found: list[tuple[float, float, float]] = []
    for frame in frames:
        for camera in range(len(seen.cameras)):
            (filmed_before, drawn_before), (filmed, drawn) = (seen.pair(camera, each) for each in (frame - 1, frame))
            true, shown = filmed - filmed_before, drawn - drawn_before
            still = np.abs(true).max(axis=2) <= _STILL
            moved = np.abs(shown).mean(axis=2)
            found.append((np.abs(shown).mean() - np.abs(true).mean(), np.abs(shown - true).mean(), moved[still].mean()))
    names = ("beyond what was filmed", "of the error", "where nothing moves")
    return dict(zip(names, np.mean(found, axis=0).round(3).tolist(), strict=True))


def strip(seen: Seen, seam: int, path: Path) -> None:
    """Draws the frames around a seam, as filmed and as the scene shows them."""
    columns = [np.concatenate(seen.pair(0, frame)) for frame in range(seam - 2, seam + 3)]
    for column in columns[:2]:
        column[:, -1] = 255
    columns[1][:, -3:] = (255, 0, 0)  # the seam lies between the second and the third
    image = np.concatenate(columns, axis=1)
    cv2.imwrite(str(path), image[:, :, ::-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("scene", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--like", type=Path)
    parser.add_argument("--strip", type=Path)
    parser.add_argument(
        "--every", type=int, default=12, help="frames that are looked at away from seams: every so many"
    )
    options = parser.parse_args()
    scene = ScenePlayer.load(options.scene)
    segments = segments_of((ScenePlayer.load(options.like) if options.like else scene).header.model)
    seams = [segment.first for segment in segments[1:]]
    if not seams:
        raise SystemExit(f"{options.like or options.scene}: expected a scene of segments.")
    seen, last = Seen(scene, open_capture(options.capture)), scene.header.frame_count - 1
    near = [frame for seam in seams for frame in range(seam - NEAR, seam + NEAR)]
    elsewhere = [frame for frame in range(1, last, options.every) if frame not in near]
    if options.strip:
        strip(seen, seams[len(seams) // 2], options.strip)
    places = np.linspace(0, last, _TIMED).round().astype(int).tolist()
    scene.compute(0.0)
    started = time.perf_counter()
    for frame in places:
        scene.compute(scene.time_of(frame))
    milliseconds = 1e3 * (time.perf_counter() - started) / len(places)
    result = {
        "seams": seams,
        "psnr near seams": psnr(seen, near),
        "psnr elsewhere": psnr(seen, elsewhere),
        "moving psnr near seams": psnr(seen, near, moving=True),
        "moving psnr elsewhere": psnr(seen, elsewhere, moving=True),
        "psnr before and after": [psnr(seen, [seam + side for seam in seams]) for side in (-2, -1, 0, 1)],
        "change at seams": changes(seen, seams),
        "change beside seams": changes(seen, [seam + side for seam in seams for side in (-3, -2, 2, 3)]),
        "change elsewhere": changes(seen, elsewhere[::2]),
        "bytes": options.scene.stat().st_size,
        "milliseconds a frame": round(milliseconds, 2),
        "gaussians": scene.count,
    }
    print(json.dumps(result, indent=1))


if __name__ == "__main__":
    main()
