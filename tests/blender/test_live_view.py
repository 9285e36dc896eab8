"""A running training's scene in the viewports of the Blender scene that it was started from."""

from dataclasses import replace
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from support.blender_windows import viewport
from support.builders import looking_at, scene_file
from support.small_scenes import imported, lens, rig_of_three
from support.training_panel import panel_says

from frog_blender import point_cloud
from frog_blender.cameras import pose_of
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import SceneFile, write_scene
from frog_blender.scene_import.capture_objects import active_capture
from frog_blender.tasks import background_task
from frog_blender.tasks.background_task import Ended
from frog_blender.tasks.training import LiveView, TrainingTask
from frog_blender.timeline import playback_cache
from frog_blender.ui import rig_overlay, train_panel
from frog_blender.viewport import drawing, live, views

CAPTURE = "/films/room"


def snapshot(seed=1):
    file = scene_file(400, seed=seed, sh_count=4, moving=100)
    return SceneFile(replace(file.header, capture_path=CAPTURE), file.arrays)


@pytest.fixture
def live_view(empty):
    """A training that goes on, and its view."""
    view = LiveView(empty)
    task = TrainingTask(lambda control: iter(()), live=view)
    task.show()
    return view


def offer(view, seed=1):
    player = ScenePlayer(snapshot(seed))
    view.source.offer(player)
    assert view.update()
    return player


def test_the_newest_snapshot_is_shown_at_the_frame_of_the_timeline(empty, live_view):
    assert live.shown_in(empty) is None and not live_view.update()
    assert bpy.app.background and not live_view.source.is_wanted, "without a window nobody sees it"
    player = offer(live_view)
    frames = player.header.frame_count
    for frame in (1, 3, frames):
        empty.frame_set(frame)
        shown = live.shown_in(empty)
        assert shown.time.scene is player and shown.time.time == pytest.approx((frame - 1) / (frames - 1))
    np.testing.assert_array_equal(shown.matrix, np.eye(4))
    newer = offer(live_view, seed=2)
    assert live.shown_in(empty).time.scene is newer


def test_another_scene_and_a_scene_that_says_no_show_nothing(empty, live_view):
    offer(live_view)
    other = bpy.data.scenes.new("Other")
    assert live.shown_in(other) is None
    empty.frog.show_live = False
    assert live.shown_in(empty) is None
    live_view.update()
    assert not live_view.source.is_wanted, "the training makes no more of them"


@pytest.mark.parametrize("ended", [Ended(""), Ended("It failed.")], ids=["cancelled", "failed"])
def test_captures_give_way_to_it_until_it_ends_however_it_ends(empty, live_view, tmp_path, monkeypatch, ended):
    write_scene(tmp_path / "room.frog", snapshot())
    capture = imported(tmp_path / "room.frog")
    monkeypatch.setattr(drawing, "is_possible", lambda: True)
    monkeypatch.setattr(drawing.state(), "source", live.shown_in)
    empty.frog.viewport_drawing = "POINTS"
    drawing.apply()
    assert point_cloud.is_drawn_in("viewport", capture)
    offer(live_view)
    bpy.ops.ed.undo_push(message="Mine")
    drawing.apply()
    assert not point_cloud.is_drawn_in("viewport", capture), "though it is of the same capture"
    bpy.ops.ed.undo_push(message="Mine")
    task = TrainingTask.current()
    task.put(ended)
    while background_task.tick() is not None:
        pass
    assert live.shown_in(empty) is None and live_view.player is None
    drawing.apply()
    assert point_cloud.is_drawn_in("viewport", active_capture(bpy.context))
    bpy.ops.ed.undo()  # to where it was hidden, which the next drawing finds
    drawing.apply()
    assert point_cloud.is_drawn_in("viewport", active_capture(bpy.context))


def seen_camera(space):
    """Of a viewport that looks freely: (4, 4) from the camera to the world, in Blender's axes."""
    view = space.region_3d
    matrix = Matrix.LocRotScale(view.view_location, view.view_rotation, None)
    return np.array(matrix @ Matrix.Translation((0, 0, view.view_distance)))


@pytest.fixture
def rig(new_file):
    """A training of three cameras that has a snapshot, and the viewport of a new file."""
    view = LiveView(new_file, rig_of_three(), 2.0)
    TrainingTask(lambda control: iter(()), live=view).show()
    views.count_as_untouched()
    offer(view)
    return view


def test_a_view_that_nobody_moved_looks_through_the_rig_and_one_key_comes_back(new_file, rig):
    space, before = viewport()["space_data"], views.Pose.of(viewport()["space_data"])
    live.look_where_untouched()
    np.testing.assert_allclose(seen_camera(space), pose_of(rig.cameras[0]), atol=1e-5)
    assert views.is_through(space) and space.region_3d.view_perspective == "PERSP"
    with bpy.context.temp_override(**viewport()):
        bpy.ops.frog.look_live()
        assert views.Pose.of(space).is_as(before) and not views.is_through(space)
        new_file.frog.preview_camera = rig.cameras[2].name
        bpy.ops.frog.look_live()
        np.testing.assert_allclose(seen_camera(space), pose_of(rig.cameras[2]), atol=1e-5)
        space.region_3d.view_distance *= 2
        views.back(space)
        space.region_3d.view_distance *= 2
        moved = views.Pose.of(space)
        live.look_where_untouched()
        assert views.Pose.of(space).is_as(moved), "the user's own view stays"
        TrainingTask.forget()
        assert not bpy.ops.frog.look_live.poll()


def test_the_first_snapshot_alone_is_looked_at(new_file, rig):
    space, before = viewport()["space_data"], views.Pose.of(viewport()["space_data"])
    rig.forget()
    live.on_snapshot()
    live.show_here(new_file)
    live._after_load()
    assert views.Pose.of(space).is_as(before), "there is nothing to see yet"
    closed = bpy.data.scenes.new("Closed")
    rig.attach(closed)
    bpy.data.scenes.remove(closed)
    live._after_load()
    assert rig.scene == new_file and views.Pose.of(space).is_as(before), "nor in a new file that shows it"
    offer(rig)
    live.on_snapshot()
    np.testing.assert_allclose(seen_camera(space), pose_of(rig.cameras[0]), atol=1e-5)
    views.back(space)
    live.on_snapshot()
    assert views.Pose.of(space).is_as(before), "who went back stays there"


@pytest.mark.parametrize("size", [(900, 400), (300, 700)])
def test_all_that_a_camera_films_is_seen(rig, size):
    """By Blender's rule: 72 mm over the lens are the longer side of a free view, at a distance of one."""
    for camera in rig.cameras:
        pose = views.through(camera, 3.0, size)
        seen = np.array(size) / max(size) * 72.0 / pose.lens
        filmed = np.array([camera.width, camera.height]) / np.diag(camera.intrinsics)[:2]
        assert (seen >= filmed - 1e-6).all() and np.isclose(seen, filmed).any()


def test_a_new_file_shows_it_and_another_one_says_where_it_is(rig, tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    rig.attach(bpy.context.scene)
    bpy.ops.wm.read_homefile(use_factory_startup=True)
    assert "no scene that is open" in live.elsewhere(bpy.context.scene)
    live._after_load()
    assert rig.scene == bpy.context.scene and views.is_through(viewport()["space_data"])
    bpy.data.objects["Cube"].location.x = 5.0
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other.blend"))
    rig.attach(bpy.context.scene)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "mine.blend"))
    bpy.context.scene.objects["Cube"].location.x = 5.0
    live._after_load()
    scene = bpy.context.scene
    assert rig.scene is None and live.elsewhere(scene) in panel_says(train_panel.FROG_PT_train)
    assert "Show It Here" in rig_overlay.told(scene, viewport()["space_data"])[0]
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "other.blend"))
    assert rig.scene == bpy.context.scene and not live.elsewhere(rig.scene), "opened again it is there again"
    other = bpy.data.scenes.new("Other")
    assert "belongs to the scene Scene" in live.elsewhere(other)
    assert bpy.ops.frog.show_live_here.poll() is False
    live.show_here(other)
    assert rig.scene == other and bpy.ops.frog.show_live_here.poll()


def test_a_click_on_a_drawn_camera_finds_it(new_file, rig, monkeypatch):
    space = viewport()["space_data"]
    assert not any("Click a camera" in line for line in rig_overlay.told(new_file, space)), "none is drawn"
    monkeypatch.setattr(rig_overlay, "shown_capture", lambda scene: SimpleNamespace(cameras=rig.cameras))
    assert any("Click a camera" in line for line in rig_overlay.told(new_file, space))
    eye = looking_at("eye", (0.3, -9.0, 2.0), (640, 480), lens(400.0, 400.0, 320.0, 240.0))
    k, window = eye.intrinsics, np.zeros((4, 4))
    window[0, 0], window[1, 1] = 2 * k[0, 0] / 640, 2 * k[1, 1] / 480
    window[2, 2], window[2, 3], window[3, 2] = -1.001, -0.1, -1
    matrix = window @ np.linalg.inv(pose_of(eye))
    region = SimpleNamespace(width=640, height=480)
    context = SimpleNamespace(scene=new_file, region=region, region_data=SimpleNamespace(perspective_matrix=matrix))
    for camera, corners in zip(rig.cameras, rig_overlay.corners_of(rig.cameras), strict=True):
        x, y = eye.project(corners[5:6])[0][0]
        assert rig_overlay.camera_at(context, (x, 480 - y)) == camera.name
    assert rig_overlay.camera_at(context, (3, 3)) == ""


def test_nothing_of_an_earlier_snapshot_stays_in_memory(empty, live_view):
    before = len(playback_cache.frames())
    for seed in range(4):
        offer(live_view, seed)
        live.shown_in(empty).time.part()
        assert len(playback_cache.frames()) == before + 1
    TrainingTask.forget()
    assert len(playback_cache.frames()) == before and live_view.player is None
