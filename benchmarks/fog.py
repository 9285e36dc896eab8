"""How much of a scene hangs where nobody looked: what cameras outside the rig see, and how far the scene reaches.

    python benchmarks/fog.py SCENE.frog CAPTURE [--views 20] [--out FOG.png]

Cameras stand on a sphere around what the scene's own cameras look at, twice as far away as the farthest of those, and
look inwards. Printed is a JSON line:

- ``haze``: mean alpha of their images. A room seen from outside covers a part; fog covers all.
- ``unmissed``: Gaussians that training images do not miss: the most that can be left out, those of the least peak
  weight (see ``playback.importance``) first, for 0.02 dB of the training images.
- ``covered``: share of the outside images' pixels that those Gaussians alone cover by a twentieth or more.
- ``around``: Gaussians that have a camera within three standard deviations of their centre.
- ``box``: the longest side of the box of all centres, and of all but a thousandth, over the rig's radius; ``largest``:
  the largest standard deviation over it.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.video import load_opencv
from frog_blender.engine.evaluation.evaluate import open_training_capture
from frog_blender.engine.evaluation.metrics import psnr_of
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.gaussians import NumpyGaussians
from frog_blender.engine.playback.importance import largest_weights, sampled_views
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.playback.transform import rotations_of

ALLOWED = 0.02  # dB
TRAINING_VIEWS = 240  # images at full size that are looked for what few of them show
COVERED = 0.05  # alpha
SIDE, FIELD_OF_VIEW, FARTHER = 192, 70.0, 2.0  # pixels, degrees, times the farthest camera's distance
SHOTS = 24  # training images that are compared

Floats = NDArray[np.float64]


def rig_of(cameras: list[Camera]) -> tuple[Floats, float]:
    """The point nearest to all optical axes, and the farthest camera's distance to it."""
    centers = np.array([camera.center for camera in cameras])
    across = [np.eye(3) - np.outer(camera.forward, camera.forward) for camera in cameras]
    pulled = 1e-6 * len(cameras)  # axes may be parallel
    target = sum(part @ center for part, center in zip(across, centers, strict=True)) + pulled * centers.mean(0)
    middle = np.linalg.solve(sum(across) + pulled * np.eye(3), target)
    return middle, float(np.linalg.norm(centers - middle, axis=1).max())


def outside_cameras(cameras: list[Camera], count: int) -> list[Camera]:
    """Cameras evenly spread over a sphere, which look at its middle."""
    middle, radius = rig_of(cameras)
    focal = SIDE / 2 / np.tan(np.radians(FIELD_OF_VIEW / 2))
    lens = np.array([[focal, 0, SIDE / 2], [0, focal, SIDE / 2], [0, 0, 1]])
    found = []
    for number in range(count):
        height, angle = 1 - (2 * number + 1) / count, np.pi * (3 - np.sqrt(5)) * number
        forward = -np.array([np.cos(angle), np.sin(angle), 0]) * np.sqrt(1 - height**2) - [0, 0, height]
        right = np.cross(forward, np.eye(3)[np.abs(forward).argmin()])
        right /= np.linalg.norm(right)
        rotation = np.stack([right, np.cross(forward, right), forward])
        eye = middle - FARTHER * radius * forward
        pose = np.vstack([np.column_stack([rotation, -rotation @ eye]), [0, 0, 0, 1]])
        found.append(Camera(f"outside {number}", SIDE, SIDE, lens, pose))
    return found


def cameras_inside(gaussians: NumpyGaussians, cameras: list[Camera], sigmas: float = 3.0) -> int:
    """Gaussians that have a camera within so many standard deviations."""
    rotations = rotations_of(gaussians.quaternions)
    nearest = np.full(len(gaussians), np.inf)
    for camera in cameras:
        own = np.einsum("nij,ni->nj", rotations, camera.center - gaussians.means)
        nearest = np.minimum(nearest, np.linalg.norm(own / gaussians.scales, axis=1))
    return int((nearest < sigmas).sum())


class TrainingImages:
    """Some training images of a capture, and the scene at their times."""

    def __init__(self, scene: ScenePlayer, folder: Path) -> None:
        capture = open_training_capture(scene, folder)
        self._store, train = FrameStore.open(capture), capture.train_indices
        self._shots = [train[int(k)] for k in np.linspace(0, len(train) - 1, min(SHOTS, len(train)))]
        self._capture, self._background = capture, scene.header.background
        self._gaussians = [scene.at(capture.time_of(capture.shots[shot])) for shot in self._shots]

    def psnr(self, chosen: NDArray[np.bool_]) -> float:
        """Of the chosen Gaussians (N,) alone: mean over the images, dB."""
        values = []
        for shot, gaussians in zip(self._shots, self._gaussians, strict=True):
            camera = self._capture.cameras[self._capture.shots[shot].camera]
            image = draw(gaussians.part(chosen), camera, self._background).rgb.clip(0, 1)
            values.append(psnr_of(float(np.mean((image - self._store.image(shot) / 255.0) ** 2))))
        return float(np.mean(values))


def unmissed(peaks: NDArray[np.float32], images: TrainingImages) -> tuple[NDArray[np.bool_], float]:
    """The most Gaussians (N,), of the least peaks first, that images miss by no more than ALLOWED; and their PSNR."""
    order, whole = peaks.argsort(), images.psnr(np.ones(len(peaks), bool))
    low, high = 0, len(order) + 1
    while high - low > max(1, low // 50):
        number = (low + high) // 2
        kept = np.ones(len(peaks), bool)
        kept[order[:number]] = False
        low, high = (number, high) if whole - images.psnr(kept) <= ALLOWED else (low, number)
    chosen = np.zeros(len(peaks), bool)
    chosen[order[:low]] = True
    return chosen, whole


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("scene", type=Path)
    parser.add_argument("capture", type=Path)
    parser.add_argument("--views", type=int, default=20)
    parser.add_argument("--out", type=Path, help="what the outside cameras see, as an image")
    options = parser.parse_args()
    scene = ScenePlayer.load(options.scene)
    cameras = list(scene.header.cameras)
    middle, radius = rig_of(cameras)
    peaks = np.zeros(scene.count, np.float32)
    for camera, frame in sampled_views(scene.header, TRAINING_VIEWS, trained=True):
        np.maximum(peaks, largest_weights(scene.at_frame(frame), camera), out=peaks)
    fog, psnr = unmissed(peaks, TrainingImages(scene, options.capture))
    gaussians = scene.at_frame(scene.header.frame_count // 2)
    outside = outside_cameras(cameras, options.views)
    images = [draw(gaussians, camera) for camera in outside]
    covered = [float((draw(gaussians.part(fog), camera).alpha >= COVERED).mean()) for camera in outside]
    offsets = np.abs(gaussians.means - middle).max(1) / radius
    figures = {
        "gaussians": scene.count,
        "training psnr": round(psnr, 2),
        "haze": round(float(np.mean([image.alpha.mean() for image in images])), 3),
        "unmissed": int(fog.sum()),
        "covered": round(float(np.mean(covered)), 4),
        "around": cameras_inside(gaussians, cameras),
        "box": [round(2 * float(np.quantile(offsets, share)), 2) for share in (1.0, 0.999)],
        "largest": round(float(gaussians.scales.max()) / radius, 2),
    }
    print(json.dumps(figures))
    if options.out:
        columns = 5
        tiles = [image.rgb.clip(0, 1) for image in images]
        tiles += [np.zeros_like(tiles[0])] * (-len(tiles) % columns)
        rows = [np.hstack(tiles[start : start + columns]) for start in range(0, len(tiles), columns)]
        load_opencv().imwrite(str(options.out), (np.vstack(rows)[..., ::-1] * 255).astype(np.uint8))


if __name__ == "__main__":
    main()
