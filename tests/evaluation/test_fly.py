"""Images from off the rig: what counts, at which frame, from where; and what one training image shows of them."""

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from support import synthetic_capture as film
from support.builders import Run, refused, still_scene
from support.layouts.lists import posed_as

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.evaluation.fly import evaluate_fly
from frog_blender.engine.evaluation.metrics import psnr, psnr_of
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.scene_file import write_scene

SHOWN = 2  # the frame that the scene has at all times
SIZE = {"w": film.WIDTH, "h": film.HEIGHT}


@pytest.fixture
def scene(capture: Capture, tmp_path: Path, own_cache: Path) -> Path:
    still = still_scene(
        film.gaussians_at(SHOWN), capture.cameras, film.FRAMES, background=(0.0, 0.0, 0.0), test_cameras=("cam00",)
    )
    write_scene(tmp_path / "x.frog", still)
    return tmp_path / "x.frog"


def zoomed(camera: Camera, factor: float) -> Camera:
    return replace(camera, intrinsics=np.diag([factor, factor, 1.0]) @ camera.intrinsics).cropped(
        *((factor - 1) * camera.intrinsics[:2, 2]), camera.width, camera.height
    )


def entry(folder: Path, name: str, camera: Camera, image: np.ndarray, **own: Any) -> dict[str, Any]:
    """Writes an image (H, W, 3) uint8; returns what a list says of it."""
    cv2.imwrite(str(folder / name), image[..., ::-1])
    return posed_as(camera, name, fl_x=camera.intrinsics[0, 0], **own)


def listed(folder: Path, entries: list[dict[str, Any]], **top: Any) -> Path:
    (folder / "list.json").write_text(json.dumps({**SIZE, **top, "frames": entries}))
    return folder / "list.json"


def test_groups_by_hand(scene: Path, filmed: Path, capture: Capture, tmp_path: Path) -> None:
    """A camera nearer, turned and zoomed, at two frames: only where the mask is white, at the frame that is said."""
    near = zoomed(capture.cameras[1].moved(np.array([0.1, 0.05, 0.02]), np.array([0.2, 0.1, -1.5])), 1.5)
    mask = np.zeros((film.HEIGHT, film.WIDTH), np.uint8)
    mask[4:30, 10:40] = 255
    cv2.imwrite(str(tmp_path / "mask.png"), mask)
    images = {frame: film.image(near, frame) for frame in (SHOWN, 5)}
    spoiled = {frame: np.where(mask[..., None] > 0, image, 255 - image) for frame, image in images.items()}
    entries = [
        entry(tmp_path, f"near_{frame}.png", near, image, frame=frame, group="near", mask_path="mask.png")
        for frame, image in spoiled.items()
    ]
    entries.append(entry(tmp_path, "whole.png", near, images[5], frame=5))
    figures = evaluate_fly(scene, filmed, listed(tmp_path, entries))
    drawn = draw(film.gaussians_at(SHOWN), near).rgb.clip(0, 1)
    squares = [(drawn.astype(np.float64) - image / 255) ** 2 for image in (images[SHOWN], images[5])]
    expected = [psnr_of(float(square[mask > 0].mean())) for square in squares]
    assert figures["groups"]["near"] == {"psnr": pytest.approx(np.mean(expected)), "one_image": None, "frames": 2}
    whole = psnr(drawn, images[5] / 255)
    assert expected[0] > 50 > 30 > expected[1] and figures["groups"]["whole"]["psnr"] == pytest.approx(whole)
    assert figures["fly"] == pytest.approx((np.mean(expected) + whole) / 2)
    assert (figures["one_image"], figures["frames"], figures["gaussians"]) == (None, 3, len(film.gaussians_at(0)))


def test_one_image_is_looked_up_by_depth(
    scene: Path, filmed: Path, capture: Capture, store: FrameStore, tmp_path: Path
) -> None:
    """A step aside of 6 pixels at depth 3 shows a training image 6 pixels further, but for the columns beyond it."""
    camera, frame, depth, step = capture.cameras[2], 4, 3.0, 6
    aside = camera.moved(np.zeros(3), np.array([-step * depth / film.FOCAL, 0.0, 0.0]))
    taken = np.asarray(store.image(capture.shot_index(2, frame) or 0))
    source = np.full((film.HEIGHT, film.WIDTH), 2, np.uint8)
    source[:, -step:] = 0
    cv2.imwrite(str(tmp_path / "source.png"), source)
    np.save(tmp_path / "depth.npy", np.full(source.shape, depth, np.float32))
    own = {"frame": frame, "group": "aside", "depth_file_path": "depth.npy", "source_path": "source.png"}
    entries = [entry(tmp_path, "aside.png", aside, np.roll(taken, -step, axis=1), **own)]

    def one_image(*names: str) -> float:
        return evaluate_fly(scene, filmed, listed(tmp_path, entries, training_cameras=names))["one_image"]

    assert one_image("cam01", "cam02") > 80
    assert one_image("cam02", "cam01") < 40  # another camera's image
    refused("found cam9 among the training_cameras, expected some of cam00, cam01", one_image, "cam01", "cam9")


def test_lists_that_do_not_fit(scene: Path, filmed: Path, capture: Capture, tmp_path: Path) -> None:
    image = film.image(capture.cameras[0], 0)
    good = entry(tmp_path, "a.png", capture.cameras[0], image, frame=0)
    cv2.imwrite(str(tmp_path / "small.png"), image[:9])
    np.save(tmp_path / "small.npy", np.ones((9, 9)))
    for changes, words in (
        ({"frame": 6}, 'found 6 as "frame" of a.png, expected the capture\'s frame that it shows, from 0 to 5'),
        ({"frame": None}, 'found None as "frame" of a.png'),
        ({"file_path": "small.png"}, "small.png: found 48 x 9 pixels, expected 48 x 36 as list.json says"),
        ({"file_path": "none.png"}, "none.png"),
        ({"mask_path": "small.png"}, r"small.png: found an array of \(9, 48\), expected \(36, 48\) as a.png"),
        ({"depth_file_path": "small.npy", "source_path": "a.png"}, "small.npy: found an array of"),
        ({"mask_path": "../a.png"}, "outside"),
        ({"k1": 0.1}, "found lens distortion of a.png, expected images without any"),
    ):
        refused(words, evaluate_fly, scene, filmed, listed(tmp_path, [good | changes]))


def test_the_command(run: Run, scene: Path, filmed: Path, tmp_path: Path) -> None:
    command = ("eval", scene, filmed, "--cameras", film.write_fly(tmp_path / "fly", SHOWN, ["a"]))
    status, out, _ = run(*command, "--json")
    assert status == 0 and json.loads(out)["groups"]["a"]["psnr"] > 50
    status, out, _ = run(*command)
    assert status == 0 and f"{'a':>18}  5" in out and f"{'fly':>18}  5" in out
    for wish in (("--split", "test"), ("--mask", scene), ("--perceptual",)):
        status, _, told = run(*command, *wish)
        assert status == 2 and "--cameras: found --split, --mask" in told
