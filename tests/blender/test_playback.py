"""The timeline shows the engine's Gaussians, whatever the order of frames, and files stay small and reopenable."""

import bpy
import numpy as np
import pytest
from support.small_scenes import imported, plays, rig_of_three, shows, write_scene
from support.users_scene import views

from frog_blender import point_cloud
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
    capture = imported(path)
    empty.frame_set(4)
    before = point_cloud.read(capture)["position"]
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"), compress=False)
    np.testing.assert_array_equal(point_cloud.read(capture)["position"], before)  # refilled after saving
    assert (tmp_path / "scene.blend").stat().st_size < 1_500_000
    name = capture.name

    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "scene.blend"))
    capture = bpy.data.objects[name]
    shows(capture, path, 3.0)
    plays(capture, path, 8)


def test_what_nobody_plays_is_let_go(empty, tmp_path):
    """When another scene is opened; what is played stays."""
    paths = [write_scene(tmp_path / f"{name}.frog", rig_of_three()) for name in "abc"]
    first, second = map(imported, paths[:2])
    bpy.data.objects.remove(first)
    assert open_scenes.paths() == set(paths[:2])
    kept = playback.open_scene(paths[1])
    imported(paths[2])
    assert open_scenes.paths() == set(paths[1:]) and playback.open_scene(paths[1]) is kept
    plays(second, paths[1], 4)
