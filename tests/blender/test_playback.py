"""The timeline shows the engine's Gaussians, whatever the order of frames, and files stay small and reopenable."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from support.small_scenes import plays, rig_of_three, shows, write_scene
from support.users_scene import views

from frog_blender import point_cloud
from frog_blender.scene_import.capture_objects import active_capture
from frog_blender.timeline import open_scenes, playback


def test_frames_in_random_order(empty, capture, static_rig):
    random = np.random.default_rng(3)
    moved = []
    for frame in random.permutation(10):
        subframe = float(random.choice([0.0, 0.5]))
        empty.frame_set(int(frame) + 1, subframe=subframe)
        shows(capture, static_rig, frame + subframe)
        moved.append(point_cloud.read(capture)["position"][0])
    assert np.ptp(moved, axis=0).max() > 1e-3, "the test's own scene does not move"


def test_start_frame_shifts_the_capture_and_its_ends_are_held(empty, capture, static_rig):
    for frame, shown in ((-5, 0.0), (500, 9.0), (20, 9.0)):
        empty.frame_set(frame)
        shows(capture, static_rig, shown)
    capture.frog.start_frame = 15.0
    shows(capture, static_rig, 5.0)


def test_import_sets_the_scene_up(empty, capture):
    assert (empty.frame_start, empty.frame_end) == (1, 10)
    assert empty.render.fps / empty.render.fps_base == pytest.approx(24.0)
    assert (empty.render.resolution_x, empty.render.resolution_y) == (96, 64)
    assert empty.camera.name == "cam00" and empty.render.engine == "FROG"
    assert sum(obj.type == "CAMERA" for obj in empty.objects) == 3
    assert capture.parent.type == "EMPTY" and len(empty.collection.children) == 1


def test_importing_shows_the_capture_at_once(empty, static_rig):
    """Solid viewports would show grey spheres."""
    if not views():
        pytest.skip("this Blender has no window")
    bpy.ops.import_scene.frog(filepath=str(static_rig), use_frog_engine=False)
    assert {view.shading.type for view in views()} == {"SOLID"}
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    assert {view.shading.type for view in views()} == {"RENDERED"}
    assert {view.region_3d.view_perspective for view in views()} == {"CAMERA"}


def test_an_unusable_file_is_told_once_and_mended_by_a_good_one(empty, capture, static_rig, capfd):
    before = point_cloud.count(capture)
    for spoil, said in ((static_rig.unlink, "found no file"), (lambda: static_rig.write_bytes(b"no"), "x.frog")):
        spoil()
        for frame in (3, 4, 5):
            empty.frame_set(frame)
        assert capfd.readouterr().err.count(str(static_rig)) == 1
        assert said.replace("x.frog", static_rig.name) in open_scenes.problem(static_rig)
        assert point_cloud.count(capture) == before
    write_scene(static_rig, rig_of_three(), count=33, seed=5, sh_count=9)
    empty.frame_set(5)
    assert open_scenes.problem(static_rig) == ""
    shows(capture, static_rig, 4.0)


def test_saved_file_is_small_and_plays_when_reopened(empty, tmp_path):
    path = write_scene(tmp_path / "many.frog", rig_of_three(), count=20_000)
    bpy.ops.import_scene.frog(filepath=str(path))
    empty.frame_set(4)
    before = point_cloud.read(active_capture(bpy.context))["position"]
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"), compress=False)
    np.testing.assert_array_equal(
        point_cloud.read(active_capture(bpy.context))["position"], before
    )  # refilled after saving
    assert (tmp_path / "scene.blend").stat().st_size < 1_500_000
    name = active_capture(bpy.context).name

    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    capture = bpy.data.objects[name]
    shows(capture, path, 3.0)
    plays(capture, path, 8)


def test_what_nobody_plays_is_let_go(empty, tmp_path):
    """When another scene is opened; what is played stays."""
    paths = [write_scene(tmp_path / f"{name}.frog", rig_of_three()) for name in "abc"]
    for path in paths[:2]:
        assert bpy.ops.import_scene.frog(filepath=str(path)) == {"FINISHED"}
    first, second = (
        next(obj for obj in playback.captures(empty.objects) if playback.file_of(obj) == p) for p in paths[:2]
    )
    bpy.data.objects.remove(first)
    assert open_scenes.paths() == set(paths[:2])
    kept = playback.open_scene(paths[1])
    assert bpy.ops.import_scene.frog(filepath=str(paths[2])) == {"FINISHED"}
    assert open_scenes.paths() == set(paths[1:]) and playback.open_scene(paths[1]) is kept
    plays(second, paths[1], 4)
