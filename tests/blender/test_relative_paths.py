"""Scene files that Blender looks after as after its own: relative from the first save on, reported, found, packed."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from support.small_scenes import rig_of_three, shows, write_scene

from frog_blender import capture_files
from frog_blender.timeline import open_scenes, playback


def the_capture():
    return next(playback.captures(bpy.context.scene.objects))


def stored(obj):
    return obj.frog.filepath.replace("\\", "/")


@pytest.fixture
def project(empty, tmp_path):
    """A folder with the scene file of a capture that a .blend without a name plays."""
    folder = tmp_path / "project"
    folder.mkdir()
    bpy.ops.import_scene.frog(filepath=str(write_scene(folder / "a.frog", rig_of_three())))
    return folder


@pytest.mark.parametrize("relative_paths", [True, False], indirect=True, ids=["relative", "absolute"])
def test_the_first_save_keeps_paths_as_the_user_wants_them(project, relative_paths):
    obj, scene = the_capture(), bpy.context.scene
    obj.frog.bake_folder, scene.frog.output_path = str(project / "bakes"), str(project / "b.frog")
    scene.frog.rig.folder = str(project / "rendered")
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "x.blend"), relative_remap=relative_paths)
    for _ in range(2):  # in the open .blend, and in what was written
        obj, scene = the_capture(), bpy.context.scene
        found = (
            stored(obj),
            obj.frog.bake_folder,
            scene.frog.output_path,
            scene.frog.rig.folder,
            scene.frog.capture_folder,
        )
        begin = "//" if relative_paths else f"{project}/"
        assert found == (f"{begin}a.frog", f"{begin}bakes", f"{begin}b.frog", f"{begin}rendered", "")
        shows(obj, project / "a.frog", 0.0)
        bpy.ops.wm.open_mainfile(filepath=str(project / "x.blend"))


def test_a_scripts_path_from_the_current_folder_is_kept(empty, tmp_path, relative_paths, monkeypatch):
    write_scene(tmp_path / "a.frog", rig_of_three())
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path)
    bpy.ops.import_scene.frog(filepath="a.frog")
    assert the_capture().frog.filepath == str(tmp_path / "a.frog")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "elsewhere" / "x.blend"))
    assert stored(the_capture()) == "//../a.frog"
    bpy.ops.import_scene.frog(filepath="a.frog")
    assert {stored(obj) for obj in playback.captures(bpy.context.scene.objects)} == {"//../a.frog"}


@pytest.mark.parametrize("failing", [False, True], ids=["copy", "nowhere"])
def test_what_is_not_saved_under_a_name_keeps_its_paths(project, tmp_path, relative_paths, failing):
    bpy.context.scene.frog.output_path = str(project / "b.frog")
    if failing:
        with pytest.raises(RuntimeError):
            bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "none" / "x.blend"))
    else:
        bpy.ops.wm.save_as_mainfile(filepath=str(project / "x.blend"), copy=True)
    assert bpy.context.scene.frog.output_path == str(project / "b.frog")
    assert the_capture().frog.filepath == str(project / "a.frog")


def test_make_paths_absolute_and_relative(project):
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "x.blend"))
    obj = the_capture()
    bpy.ops.file.make_paths_absolute()
    assert obj.frog.filepath == str(project / "a.frog")
    bpy.ops.file.make_paths_relative()
    assert stored(obj) == "//a.frog"
    bpy.context.scene.frame_set(4)
    shows(obj, project / "a.frog", 3.0)


def test_a_moved_project_plays_and_renders(project, rendered):
    bpy.context.scene.frame_set(3)
    before = rendered(bpy.context.scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "x.blend"))
    there = project.rename(project.parent / "elsewhere")
    bpy.ops.wm.open_mainfile(filepath=str(there / "x.blend"))
    shows(the_capture(), there / "a.frog", 2.0)
    np.testing.assert_array_equal(rendered(bpy.context.scene), before)


def test_missing_files_are_reported_and_found(project, tmp_path, capfd):
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "x.blend"))
    obj, there = the_capture(), tmp_path / "there"
    there.mkdir()
    (project / "a.frog").rename(there / "a.frog")
    bpy.context.scene.frame_set(2)
    capfd.readouterr()
    bpy.ops.file.report_missing_files()
    assert str(project / "a.frog") in capfd.readouterr().out
    bpy.ops.file.find_missing_files(directory=f"{tmp_path}/")
    assert playback.file_of(obj).resolve() == there / "a.frog"
    bpy.context.scene.frame_set(5)
    shows(obj, there / "a.frog", 4.0)
    assert not open_scenes.problem(playback.file_of(obj))
    capfd.readouterr()
    bpy.ops.file.report_missing_files()
    assert "a.frog" not in capfd.readouterr().out


def test_a_packed_capture_needs_no_file(project, tmp_path, rendered):
    scene = bpy.context.scene
    scene.frame_set(3)
    before, original = rendered(scene), tmp_path / "kept.frog"
    original.write_bytes((project / "a.frog").read_bytes())
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "x.blend"))
    bpy.ops.file.pack_all()
    assert capture_files.packed_bytes(the_capture()) == original.stat().st_size
    bpy.ops.wm.save_mainfile()
    (project / "a.frog").unlink()
    blend = (project / "x.blend").rename(tmp_path / "y.blend")
    bpy.ops.wm.open_mainfile(filepath=str(blend))
    obj = the_capture()
    shows(obj, original, 2.0)
    np.testing.assert_array_equal(rendered(bpy.context.scene), before)
    assert playback.bake_path(obj) == tmp_path / "a.frogbake", "not among temporary files"
    bpy.context.scene.frame_end = 4
    assert bpy.ops.frog.bake() == {"FINISHED"} and len(playback.baked(obj)) == 4
    bpy.ops.wm.open_mainfile(filepath=str(blend))  # which deletes the copies and writes new ones
    bpy.context.scene.frame_set(5)
    shows(the_capture(), original, 4.0)
    bpy.ops.file.unpack_all(method="WRITE_LOCAL")
    assert playback.file_of(the_capture()).read_bytes() == original.read_bytes()
    bpy.context.scene.frame_set(7)
    shows(the_capture(), original, 6.0)


def test_duplicates_part_when_one_plays_another_file(project):
    first = the_capture()
    second = first.copy()
    second.data = first.data.copy()
    bpy.context.scene.collection.objects.link(second)
    assert second.frog.source == first.frog.source
    second.frog.filepath = str(write_scene(project / "b.frog", rig_of_three(), seed=1))
    assert first.frog.filepath == str(project / "a.frog")
    second.frog.filepath = ""
    assert not capture_files.is_capture(second) and capture_files.is_capture(first)
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "x.blend"))
    first.frog.filepath = "//" + "ä" * 600 + ".frog"  # longer than Blender's own paths may be
    assert first.frog.source is None and len(first.frog.filepath) == 607
