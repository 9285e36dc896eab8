"""From a folder of videos to an image with other objects, by the buttons that a person presses: the bundled capture,
trained as `draft` trains it."""

from __future__ import annotations

import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from support.small_scenes import glowing

from frog_blender import point_cloud
from frog_blender.scene_import.capture_objects import cameras_of
from frog_blender.tasks import background_task
from frog_blender.tasks.training import TrainingTask
from frog_blender.timeline import playback

CAPTURE = Path(__file__).resolve().parents[2] / "examples" / "captures" / "room"
GLOW = (0.9, 0.1, 0.8)


def ball(place, radius):
    """A glowing sphere."""
    bpy.ops.mesh.primitive_uv_sphere_add(radius=radius, location=place)
    bpy.context.object.data.materials.append(glowing(GLOW))
    return bpy.context.object


def seconds_patient(condition, seconds):
    end = time.monotonic() + seconds
    while not condition() and time.monotonic() < end:
        time.sleep(0.02)
    assert condition(), f"not within {seconds} s"


@pytest.mark.slow
def test_film_train_scrub_render(empty, tmp_path, rendered, monkeypatch):
    pytest.importorskip("torch")
    pytest.importorskip("cv2")
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    assert bpy.ops.import_scene.frog_capture(directory=str(CAPTURE)) == {"FINISHED"}
    settings = empty.frog
    settings.output_path, settings.recipe = str(tmp_path / "room.frog"), "draft"
    assert bpy.ops.frog.train() == {"FINISHED"}
    task = TrainingTask.current()
    seconds_patient(lambda: background_task.tick() is None, 3000.0)
    state = task.state
    assert not task.error and state.result == tmp_path / "room.frog"
    assert state.psnr > 25.0 and 0 < state.moving < state.gaussians

    (obj,) = playback.captures(empty.objects)
    assert empty.render.engine == "FROG" and empty.frame_end == 30
    assert all(camera.data.show_background_images for camera in cameras_of(obj))
    first = point_cloud.read(obj)["position"].copy()
    empty.frame_set(20)
    later = point_cloud.read(obj)["position"].copy()
    empty.frame_set(1)
    np.testing.assert_array_equal(point_cloud.read(obj)["position"], first)
    travelled = np.linalg.norm(later - first, axis=1)
    assert travelled.max() > 0.05 and (travelled == 0).any()

    # A ball around what moves most: it hides what lies behind it, and what lies before it hides the ball.
    place = first[travelled > 0.5 * travelled.max()].mean(0)
    alone = rendered(empty)[..., 3].astype(float) / 255
    sphere = ball(place, 0.35)
    empty.frog.hold_out, empty.render.film_transparent = True, True
    cut = rendered(empty)[..., 3].astype(float) / 255
    assert alone.mean() > 0.9
    hidden = alone - cut
    assert 0.002 < (hidden > 0.5).mean() < 0.5

    empty.frog.hold_out = empty.render.film_transparent = False
    assert bpy.ops.frog.compose(engine="CYCLES") == {"FINISHED"}
    empty.cycles.samples, empty.cycles.use_denoising = 1, False
    both = rendered(empty)[..., :3].astype(float) / 255
    sphere.hide_render = True
    without = rendered(empty)[..., :3].astype(float) / 255
    changed = np.abs(both - without).max(-1)
    # Only where the ball hides splats does its light show, there all of it.
    assert changed[hidden < 1 / 255].max() < 8 / 255
    seen = both[(cut < 2 / 255) & (hidden > 0.9)]
    np.testing.assert_allclose(np.median(seen, axis=0), [243 / 255, 89 / 255, 231 / 255], atol=0.02)
