"""``--fly`` of the scripts that render a capture: poses, depths and masks, of a block that slides before a wall."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest
from support.builders import REPOSITORY

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.evaluation.fly import FlyImage, read_fly

EXAMPLES = REPOSITORY / "examples"
SCRIPT = """
import bpy
import numpy as np
from capture_rig import Rig
from capture_videos import make
from scene_parts import Scene, box, plain, surroundings, wall

class Wall(Scene):
    def build(self):
        wall("wall", (-30, 2, -30), (60, 0, 0), (0, 0, 60), plain("blue", (0.1, 0.1, 0.9)))
        box("block", (0.0, 0.0, 1.0), (1.0, 1.0, 1.0), plain("red", (0.9, 0.1, 0.1)))
        surroundings((1, 1, 1), 1.0)

    def pose(self, phase):
        bpy.data.objects["block"].location.x = phase

make("", Rig(40, 30, 37.5), Wall, [0])
"""


def crossing(origin: np.ndarray, rays: np.ndarray, frame: int) -> tuple[np.ndarray, np.ndarray]:
    """Where rays (N, 3) enter the block, in their lengths, infinity for never; and where they meet the wall."""
    center = np.array([frame / 30, 0.0, 1.0])
    with np.errstate(divide="ignore"):
        ends = np.stack([(center + side - origin) / rays for side in (-0.5, 0.5)])
        enter, leave = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
        return np.where(enter < leave, enter, np.inf), (2 - origin[1]) / rays[:, 1]


def seen_by_two(image: FlyImage, points: np.ndarray, training: list[Camera]) -> np.ndarray:
    seen = np.zeros(len(points), int)
    for camera in training:
        x, y = camera.project(points)[0].T
        inside = (x > 0) & (x < camera.width) & (y > 0) & (y < camera.height)
        seen += inside & (crossing(camera.center, points - camera.center, image.frame)[0] > 0.999)
    return seen > 1


def test_what_is_written_beside_the_images_is_true(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("imageio_ffmpeg", reason="writes the videos of examples")
    script = tmp_path / "make_wall.py"
    script.write_text(SCRIPT)
    command = [sys.executable, str(script), str(tmp_path / "fly"), "--fly", "--samples", "4", "--threads", "1"]
    subprocess.run(command, check=True, capture_output=True, env={"PYTHONPATH": str(EXAMPLES)})
    monkeypatch.syspath_prepend(EXAMPLES)
    from capture_rig import Rig

    views = Rig(40, 30, 37.5).views[1:]
    poses = [np.linalg.inv(view.matrix @ np.diag([1.0, -1, -1, 1])) for view in views]
    images, names = read_fly(tmp_path / "fly" / "transforms.json", 30)
    assert names == [f"cam{index:02d}" for index in range(1, 12)]
    assert [image.frame for image in images[::7]] == [8, 13, 22] and len(images) == 21
    assert {image.group for image in images} == {"near2", "near3", "zoom", "beside", "above"}
    training = [
        Camera(name, 40, 30, images[0].camera.intrinsics, pose) for name, pose in zip(names, poses, strict=True)
    ]
    for image in images:
        sources, mask = image.sources(), image.mask()
        assert sources is not None
        points, source = sources
        rays = points.reshape(-1, 3) - image.camera.center
        block, back = crossing(image.camera.center, rays, image.frame)
        np.testing.assert_allclose(np.minimum(block, back), 1, atol=1e-5, err_msg=image.path.name)
        expected = seen_by_two(image, points.reshape(-1, 3), training).reshape(mask.shape)
        assert np.mean(mask != expected) < 0.005 and (mask == (source > 0)).all(), image.path.name
        blue, _, red = cv2.imread(str(image.path)).reshape(-1, 3).T.astype(int)
        assert np.mean((red > blue) == (block < back)) > 0.96, image.path.name
    assert not all(image.mask().all() for image in images)
    zoom = next(image for image in images if image.group == "zoom")
    np.testing.assert_allclose(zoom.camera.world_to_camera, poses[2], atol=1e-9)
    assert zoom.camera.intrinsics[0, 0] == 3 * 37.5
