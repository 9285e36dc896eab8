"""A capture rendered from a Blender scene: the rig sees its box, the images fit their cameras, nothing of the user's
scene changes, and it can be trained."""

import json
import sys
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from support.builders import refuses
from support.small_scenes import animate, read_png
from support.training_panel import finish

from frog_blender.engine.capture.readers import open_capture
from frog_blender.scene_capture.request import request_of
from frog_blender.tasks import background_task
from frog_blender.tasks.scene_capture import SceneCaptureTask

SIZE = 40


@pytest.fixture
def cube(empty, tmp_path):
    """A scene of a cube that moves 1 to the right over its two frames, and settings of a small rig around it."""
    bpy.ops.mesh.primitive_cube_add(size=1.0)
    cube = bpy.context.object
    animate(cube, "location", (1, (0, 0, 0)), (2, (1, 0, 0)))
    empty.frame_start, empty.frame_end = 1, 2
    empty.frame_set(1)
    empty.render.engine, empty.cycles.samples, empty.cycles.use_denoising = "CYCLES", 1, False
    settings = empty.frog.rig
    settings.size, settings.count, settings.folder = SIZE, 3, str(tmp_path / "capture")
    yield cube
    background_task.stop()


def rendered_capture():
    assert bpy.ops.frog.place_rig() == {"FINISHED"}
    assert bpy.ops.frog.capture_scene() == {"FINISHED"}
    return finish(SceneCaptureTask.current())


def corners(middle, half):
    return np.array([[x, y, z] for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]) * half + middle


@pytest.mark.parametrize("shape", ["RINGS", "DOME", "ARC"])
def test_every_camera_sees_the_whole_box_at_every_frame(cube, shape):
    settings = bpy.context.scene.frog.rig
    settings.shape, settings.count = shape, 9
    assert bpy.ops.frog.place_rig() == {"FINISHED"}
    np.testing.assert_allclose(settings.box.location, (0.5, 0.0, 0.0), atol=1e-6)
    np.testing.assert_allclose(settings.box.scale, (1.0, 0.5, 0.5), atol=1e-6)
    bpy.context.view_layer.update()
    seen = corners(np.array([0.5, 0.0, 0.0]), np.array([1.0, 0.5, 0.5]))
    cameras = request_of(bpy.context.scene, settings).cameras
    assert len(cameras) == 9
    for camera in cameras:
        pixels, _ = camera.project(seen)
        assert pixels.min() > 0 and pixels.max() < SIZE
        assert np.ptp(pixels, axis=0).max() > SIZE / 3, "the box is small in the image"


def test_what_is_set_is_seen_at_once_and_cameras_of_the_users_stay(cube):
    settings = bpy.context.scene.frog.rig
    settings.count = 5
    assert settings.collection is None, "no rig yet"
    bpy.ops.frog.place_rig()
    settings.count = 3
    assert bpy.ops.frog.remove_rig() == {"FINISHED"}
    assert settings.collection is None and not bpy.data.cameras and len(bpy.data.objects) == 1
    bpy.ops.frog.place_rig()
    placed = settings.collection.objects["rig00"]
    linked, copied, own = placed.copy(), placed.copy(), bpy.data.objects.new("own", bpy.data.cameras.new("own"))
    copied.data = placed.data.copy()
    mine = {linked, copied, own}
    for camera in mine:
        settings.collection.objects.link(camera)
    settings.lens = 85.0
    cameras = [obj for obj in settings.collection.objects if obj.type == "CAMERA"]
    assert len(cameras) == 6 and mine < set(cameras)
    assert sorted(camera.data.lens for camera in cameras) == [50.0] * 3 + [85.0] * 3
    bpy.ops.frog.remove_rig()
    assert set(settings.collection.objects) == mine
    settings.lens = 35.0
    assert set(settings.collection.objects) == mine, "the rig is gone"


def test_images_fit_their_cameras_and_nothing_of_the_scene_changes(cube, tmp_path):
    scene, folder = bpy.context.scene, tmp_path / "takes of {today}"  # braces are Blender's own
    scene.frog.rig.folder = str(folder)
    scene.timeline_markers.new("cut", frame=1).camera = cube
    scene.frame_set(2, subframe=0.25)
    scene.view_settings.exposure = 1.5
    names = ("engine", "filepath", "film_transparent", "resolution_x", "use_motion_blur", "use_compositing")
    before = [getattr(scene.render, name) for name in names], scene.view_settings.view_transform
    task = rendered_capture()
    assert not task.error and task.progress.done == task.progress.total == 6
    assert ([getattr(scene.render, name) for name in names], scene.view_settings.view_transform) == before
    assert scene.camera == cube and scene.timeline_markers[0].camera == cube and scene.frame_current_final == 2.25
    assert bpy.data.filepath == "" and scene.view_settings.exposure == 1.5

    assert Path(scene.frog.capture_folder) == folder
    capture = open_capture(folder)
    assert capture.frame_count == 2 and capture.frames_per_second == 24.0 and len(capture.cameras) == 3
    for shot in capture.shots:
        assert shot.mask is not None and shot.mask.is_alpha
        alpha = read_png(shot.path)[..., 3]
        assert set(np.unique(alpha)) >= {0, 255}
        rows, columns = np.nonzero(alpha > 127)
        pixels, _ = capture.cameras[shot.camera].project(corners(np.array([float(shot.frame), 0.0, 0.0]), 0.5))
        box = np.array([columns.min(), rows.min(), columns.max() + 1, rows.max() + 1])
        np.testing.assert_allclose(box, [*pixels.min(axis=0), *pixels.max(axis=0)], atol=1.0)


def test_it_goes_on_where_it_was_stopped(cube, tmp_path):
    assert not rendered_capture().error
    folder = tmp_path / "capture"
    gone = folder / "cam01" / "0001.png"
    gone.unlink()
    (folder / "cam01" / "0000.png").write_bytes(b"kept as it is")
    assert bpy.ops.frog.capture_scene() == {"FINISHED"}
    task = SceneCaptureTask.current()
    assert task.kept == 5
    finish(task)
    assert not task.error and gone.is_file() and task.progress.done == 6
    assert (folder / "cam01" / "0000.png").read_bytes() == b"kept as it is"
    bpy.context.scene.frog.rig.count = 4
    refuses("found images of other cameras or frames", bpy.ops.frog.capture_scene)
    assert len(json.loads((folder / "transforms.json").read_text())["frames"]) == 6


def test_cancelled_it_leaves_whole_images_alone(cube, tmp_path):
    bpy.context.scene.frame_end = 200
    bpy.ops.frog.place_rig()
    bpy.ops.frog.capture_scene()
    task, end = SceneCaptureTask.current(), time.monotonic() + 200
    while task.progress.done == 0 and time.monotonic() < end:
        task.pump()
        time.sleep(0.02)
    assert bpy.ops.frog.cancel_scene_capture() == {"FINISHED"}
    finish(task)
    done = task.progress.done
    assert task.is_cancelled and not task.error and 0 < done < 600
    images = list((tmp_path / "capture").glob("*/*"))
    assert len(images) == done and {read_png(image).shape for image in images} == {(SIZE, SIZE, 4)}


def test_without_a_folder_of_its_own_or_anything_to_see_there_is_a_sentence(cube, tmp_path):
    (tmp_path / "capture").mkdir()
    (tmp_path / "capture" / "notes.txt").write_text("mine")
    bpy.ops.frog.place_rig()
    refuses("found other files, expected an empty folder", bpy.ops.frog.capture_scene)
    bpy.context.scene.frog.rig.folder = "//frog_capture"
    refuses("no folder yet", bpy.ops.frog.capture_scene)
    bpy.ops.frog.remove_rig()
    bpy.data.objects.remove(cube)
    refuses("found nothing that renders", bpy.ops.frog.place_rig)


@pytest.mark.parametrize(
    ("script", "said"),
    [
        ("import sys; sys.exit('no graphics card')", "ended with status 1 (no graphics card)"),
        ('print(\'{"frog": {"error": "out of memory"}}\')', "out of memory"),
    ],
)
def test_a_renderer_that_fails_is_told(cube, monkeypatch, script, said):
    monkeypatch.setattr("frog_blender.tasks.scene_capture.command", lambda *_, **__: [sys.executable, "-c", script])
    error = rendered_capture().error
    assert said in error and "done are kept" in error
    assert bpy.context.scene.frog.capture_folder == ""
