"""One scene, written in the layout of every reader of standing cameras, trains alike."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from support.filmed_scene import FRAMES, image, rig
from support.image_stores import ImageStore
from support.layouts import rigs
from support.layouts.colmap import write_model
from support.layouts.files import write_films, write_frames
from support.training_steps import train

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.capture import Capture, Shot
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.seeding.views import Images
from frog_blender.engine.capture.seeds import Seeds, find_seeds
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.optimize.trainer import Limits, Trainer

STEPS = 40
Writer = Callable[[Path], object]


def colmap_folders(folder: Path, text: bool = False) -> None:
    write_frames(folder / "images", rig())
    names = [f"{camera.name}/{frame:04d}.png" for camera in rig() for frame in range(FRAMES)]
    write_model(folder / "sparse" / "0", names, [camera for camera in rig() for _ in range(FRAMES)], text=text)


def colmap_films(folder: Path) -> None:
    write_films(folder, rig())
    write_model(folder / "sparse" / "0", [f"{camera.name}.png" for camera in rig()], rig(), text=True)


def opencv_films(folder: Path) -> None:
    rigs.opencv_frames(folder)
    for camera in rig():
        for file in (folder / camera.name).iterdir():
            file.unlink()
        (folder / camera.name).rmdir()
    write_films(folder, rig())


AS_FILMED: dict[str, Writer] = {
    "multipleview": rigs.multipleview,
    "PanopticSports": rigs.panoptic_sports,
    "EasyVolcap": rigs.easyvolcap,
    "EasyMocap": rigs.easymocap,
    "caliscope": rigs.caliscope,
    "anipose, freemocap": rigs.anipose,
    "Pose2Sim": rigs.pose2sim,
    "frames of cameras_opencv.json": rigs.opencv_frames,
    "films of cameras_opencv.json": opencv_films,
    "COLMAP's binary model": colmap_folders,
    "COLMAP's text model": lambda folder: colmap_folders(folder, text=True),
    "COLMAP's model and films": colmap_films,
}
CENTRED: dict[str, Writer] = {
    "N3DV's frames": rigs.n3dv_frames,
    "N3DV, one folder deeper": rigs.n3dv_nested,
    "multipleview by rows": rigs.multipleview_rows,
}
"""Layouts that cannot say where the principal point is."""


class Drawn(ImageStore):
    """The images of cameras by their formula, frame after frame."""

    def __init__(self, cameras: Sequence[Camera]) -> None:
        self._images = [image(camera, frame) for frame in range(FRAMES) for camera in cameras]

    def image(self, shot_index: int) -> np.ndarray:
        return self._images[shot_index]


def in_memory(cameras: Sequence[Camera]) -> Capture:
    path = Path("memory")
    shots = tuple(Shot(camera, frame, path, frame) for frame in range(FRAMES) for camera in range(len(cameras)))
    return Capture(path, "memory", tuple(cameras), (None,) * len(cameras), shots, FRAMES)


def trained(capture: Capture, store: Images, seeds: Seeds) -> float:
    """The training's PSNR in dB over all images."""
    settings = recipe("draft", steps=STEPS, steps_per_moment=0, max_gaussians=600)
    trainer = Trainer(capture, store, seeds, settings, "frog", Limits(steps=STEPS), seed=0)
    return train(trainer).evaluate(len(capture.shots))[0]


@cache
def expected(centred: bool) -> tuple[Capture, Seeds, float]:
    cameras = rigs.centred() if centred else rig()
    capture, store = in_memory(cameras), Drawn(cameras)
    seeds = find_seeds(capture, store, count_limit=400)
    return capture, seeds, trained(capture, store, seeds)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*AS_FILMED, *CENTRED])
def test_a_layout_trains_as_the_scene_that_was_written(name: str, tmp_path: Path) -> None:
    reference, seeds, psnr = expected(name in CENTRED)
    (tmp_path / "capture").mkdir()
    (AS_FILMED | CENTRED)[name](tmp_path / "capture")
    capture = open_capture(tmp_path / "capture")
    store = FrameStore.open(capture, cache_folder=tmp_path / "cache")
    assert [(s.camera, s.frame, s.offset) for s in capture.shots] == [(s.camera, s.frame, 0) for s in reference.shots]
    for found, written in zip(capture.cameras, reference.cameras, strict=True):
        np.testing.assert_allclose(found.world_to_camera, written.world_to_camera, atol=1e-6, rtol=0)
        np.testing.assert_allclose(found.intrinsics, written.intrinsics, atol=1e-6, rtol=0)
    drawn = Drawn(reference.cameras)
    for index in range(len(capture.shots)):
        np.testing.assert_array_equal(store.image(index), drawn.image(index))
    # What a layout holds out, and the depths and points that come with it, are its own.
    same = replace(capture, test_cameras=frozenset(), test_frames=frozenset(), near_far=None, points=None)
    assert trained(same, store, seeds) == pytest.approx(psnr, abs=0.01)


@pytest.mark.slow
def test_half_a_pixel_would_be_seen() -> None:
    """The figure that the layouts have in common tells cameras that are a little off."""
    reference, seeds, psnr = expected(False)
    shift = np.array([[0, 0, 0.5], [0, 0, 0], [0, 0, 0]])
    others = [replace(c, intrinsics=c.intrinsics + shift * (-1) ** i) for i, c in enumerate(reference.cameras)]
    assert abs(trained(reference.with_cameras(others), Drawn(reference.cameras), seeds) - psnr) > 0.02
