"""Evaluating a scene: the right images, the right pixels, the right sums."""

import shutil
import tracemalloc
import warnings
import zipfile
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support import synthetic_capture as film
from support.builders import refused, still_scene

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.frame_keys import made_of
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.errors import FrogError
from frog_blender.engine.evaluation.evaluate import TrueImages, as_trained, evaluate_images
from frog_blender.engine.evaluation.masks import load_masks, moving_mask
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.header import SceneHeader

MIDDLE = 3


@pytest.fixture(scope="module")
def images(capture: Capture, store: FrameStore) -> TrueImages:
    return TrueImages(capture, store)


def frozen_scene(test_cameras: tuple[str, ...] = ("cam00",), test_frames: tuple[int, ...] = ()) -> ScenePlayer:
    """The true Gaussians of the middle frame at every time: right there, wrong elsewhere."""
    said = {"test_cameras": test_cameras, "test_frames": test_frames, "steps": 77}
    true = film.gaussians_at(MIDDLE)
    return ScenePlayer(still_scene(true, film.rig(), film.FRAMES, background=(0.0, 0.0, 0.0), **said))


def errors(scene: ScenePlayer, capture: Capture, store: FrameStore, camera: int) -> np.ndarray:
    """(frames, H, W, 3) squared differences."""
    drawn = [draw(scene.at_frame(f), capture.cameras[camera]).rgb.clip(0, 1) for f in range(film.FRAMES)]
    truth = [store.image(capture.shot_index(camera, f)) / 255.0 for f in range(film.FRAMES)]
    return (np.array(drawn, np.float64) - np.array(truth)) ** 2


def decibels(squares: np.ndarray) -> float:
    return -10 * float(np.log10(squares.mean()))


def test_held_out_images_by_hand(capture: Capture, store: FrameStore) -> None:
    scene = frozen_scene()
    report = evaluate_images(scene, TrueImages(capture, store))
    squares = errors(scene, capture, store, 0)
    assert report["psnr"] == pytest.approx(np.mean([decibels(square) for square in squares]), abs=1e-4)
    mask = moving_mask(store, [capture.shot_index(0, f) for f in range(film.FRAMES)])
    assert report["psnr_moving"] == pytest.approx(decibels(squares[:, mask]), abs=1e-4)
    assert report["psnr_moving"] < report["psnr"]
    assert 0.3 < report["ssim"] < 1 and 0 < report["sharpness_moving"] < 3
    assert report["frames"] == film.FRAMES and report["split"] == "held-out" and list(report["cameras"]) == ["cam00"]
    assert (report["method"], report["gaussians"]) == ("static", scene.count)
    assert report["steps"] == 77


def test_splits(images: TrueImages) -> None:
    named = {"test": "held-out", "val": "held-out", "train": "training"}
    assert {name: evaluate_images(frozen_scene(), images, split=name)["split"] for name in named} == named
    for wrong in ("tets", "", "Train"):
        with pytest.raises(FrogError, match=f"found the split {wrong}.*, expected one of auto, held-out, test, val, t"):
            evaluate_images(frozen_scene(), images, split=wrong)
    report = evaluate_images(frozen_scene(), images, split="training")
    assert list(report["cameras"]) == ["cam01", "cam02", "cam03"] and report["frames"] == 18
    means = [report["cameras"][name]["psnr"] for name in report["cameras"]]
    assert report["psnr"] == pytest.approx(np.mean(means))
    every_third = evaluate_images(frozen_scene((), (1, 4)), images)
    assert every_third["frames"] == 8 and every_third["split"] == "held-out" and len(every_third["cameras"]) == 4
    everything = evaluate_images(frozen_scene(()), images)
    assert everything["frames"] == 24 and everything["split"] == "training"
    refused("no held-out image", evaluate_images, frozen_scene(()), images, split="held-out")


def test_the_header_decides_what_was_held_out_not_the_capture(images: TrueImages) -> None:
    """The capture holds cam00 out by itself; a scene that was trained on it must not be judged on it."""
    report = evaluate_images(frozen_scene(("cam02",)), images)
    assert list(report["cameras"]) == ["cam02"]


def test_progress_is_reported(images: TrueImages) -> None:
    told: list[tuple[int, int]] = []
    evaluate_images(frozen_scene(), images, progress=lambda done, total: told.append((done, total)))
    assert told == [(i, 6) for i in range(1, 7)]


def test_moving_pixels_are_those_that_change(capture: Capture, store: FrameStore) -> None:
    mask = moving_mask(store, [capture.shot_index(2, f) for f in range(film.FRAMES)])
    assert mask.shape == (film.HEIGHT, film.WIDTH) and 0.05 < mask.mean() < 0.6
    for frame in range(film.FRAMES):
        ball = film.gaussians_at(frame).means[-12:].mean(0)
        column, row = np.floor(capture.cameras[2].project(ball[None])[0][0]).astype(int)
        assert mask[row, column]
    assert mask[:3].mean() < 0.2  # where the ball never comes, but for what the codec does
    assert not moving_mask(store, [0, 0, 0]).any()


def test_mask_files(capture: Capture, store: FrameStore, tmp_path: Path) -> None:
    mask = np.zeros((film.HEIGHT, film.WIDTH), np.uint8)
    mask[5:15, 20:40] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    np.savez(tmp_path / "masks.npz", cam00=mask)
    np.savez(tmp_path / "frames.npz", cam00=np.stack([mask] * film.FRAMES))
    scene = frozen_scene()
    expected = decibels(errors(scene, capture, store, 0)[:, mask > 0])
    for name in ("mask.png", "masks.npz", "frames.npz"):
        report = evaluate_images(scene, TrueImages(capture, store, tmp_path / name))
        assert report["psnr_moving"] == pytest.approx(expected, abs=1e-4), name
    others = evaluate_images(scene, TrueImages(capture, store, tmp_path / "masks.npz"), split="training")
    assert others["psnr_moving"] is None and others["psnr"] > 0
    black = tmp_path / "black.png"
    cv2.imwrite(str(black), mask * 0)
    assert evaluate_images(scene, TrueImages(capture, store, black))["psnr_moving"] is None


def test_mask_files_that_do_not_fit(capture: Capture, tmp_path: Path) -> None:
    cv2.imwrite(str(tmp_path / "small.png"), np.zeros((10, 10), np.uint8))
    np.savez(tmp_path / "small.npz", cam01=np.zeros((10, 10)))
    np.savez(tmp_path / "objects.npz", cam01=np.array([{}], dtype=object))
    np.savez(tmp_path / "whole.npz", cam01=np.ones((film.HEIGHT, film.WIDTH)))
    whole = (tmp_path / "whole.npz").read_bytes()
    (tmp_path / "cut.npz").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "empty.png").write_bytes(b"")
    (tmp_path / "text.png").write_text("no image")
    (tmp_path / "text.npz").write_text("no archive")
    (tmp_path / "whole.npz").unlink()
    for path in (*tmp_path.iterdir(), tmp_path / "missing.png"):
        assert str(path) in refused(".", load_masks, path, capture)


def test_masks_of_no_camera_are_refused(capture: Capture, tmp_path: Path) -> None:
    mask = np.ones((film.HEIGHT, film.WIDTH))
    np.savez(tmp_path / "x.npz", cam01=mask, Cam00=mask)
    with pytest.raises(FrogError, match="a mask named 'Cam00', expected names of cameras: cam00, cam01, cam02, cam03"):
        load_masks(tmp_path / "x.npz", capture)


def test_a_small_file_of_large_masks_is_never_unpacked(capture: Capture, tmp_path: Path) -> None:
    """Zeros hardly take room on the disk: a file of a megabyte asked for gigabytes."""
    path = tmp_path / "bomb.npz"
    for shape in ((40_000, 60_000), (10**6, film.HEIGHT, film.WIDTH), (film.HEIGHT,), (0, film.HEIGHT, film.WIDTH)):
        header = BytesIO()
        np.lib.format.write_array_header_1_0(header, {"descr": "|b1", "fortran_order": False, "shape": shape})
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive, archive.open("cam00.npy", "w") as file:
            file.write(header.getvalue())
            for _ in range(min(int(np.prod(shape)), 2**26) >> 20):
                file.write(bytes(2**20))
        tracemalloc.start()
        sentence = refused(".", load_masks, path, capture)
        assert tracemalloc.get_traced_memory()[1] < 20e6
        tracemalloc.stop()
        assert str(path) in sentence


def test_a_capture_that_is_not_as_it_was_is_told_and_another_refused(filmed: Path, tmp_path: Path) -> None:
    """Another take of the same rig has its cameras and frames; a copy has the same content at another time."""
    taken = open_capture(Path(shutil.copytree(filmed, tmp_path / "monday")))
    scene = still_scene(
        film.gaussians_at(0), taken.cameras, film.FRAMES, made_of=made_of(taken), capture_path="/monday"
    )

    def told(header: SceneHeader = scene.header, **changes: Any) -> list[str]:
        with warnings.catch_warnings(record=True) as caught:
            as_trained(header, replace(open_capture(taken.path), **changes))
        return [str(warning.message) for warning in caught]

    turned = [replace(c, world_to_camera=np.diag([-1.0, -1, 1, 1]) @ c.world_to_camera) for c in taken.cameras]
    moved = [replace(c, intrinsics=c.intrinsics + np.diag([0.1, 0.1, 0])) for c in taken.cameras]
    later = [replace(shot, offset=0.25) for shot in taken.shots]
    assert not told()
    assert [
        "found another calibration or image size" in each and "(/monday)" in each for each in told(cameras=tuple(moved))
    ] == [True]
    assert ["another calibration" in each for each in told(cameras=tuple(turned))] == [True]
    assert ["found other times of images" in each for each in told(shots=tuple(later))] == [True]
    with pytest.raises(FrogError, match="camera cam00 placed otherwise"):  # a scene that does not say of what it is
        told(replace(scene.header, made_of={}), cameras=tuple(turned))
    film.write_capture(taken.path, range(film.FRAMES)[::-1])
    assert ["found other images than" in each for each in told()] == [True]
    refused("camera cam00 placed otherwise", told, cameras=tuple(turned))
