"""Scene files that Blender looks after as after its own: relative from the first save on, reported, found, packed,
appended and linked. One choice mends captures whose file is missing, and a wrong one changes nothing."""

import bpy
import numpy as np
import pytest
from support.composed_scene import the_capture
from support.small_scenes import plays, rig_of_three, shows, write_scene

from frog_blender import capture_files
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.timeline import open_scenes, playback


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
    scene = bpy.context.scene
    scene.frog.output_path = str(project / "b.frog")
    scene.frog.rig.folder = str(project / "rendered")
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "x.blend"), relative_remap=relative_paths)
    for _ in range(2):  # in the open .blend, and in what was written
        obj, told = the_capture(), bpy.context.scene.frog
        paths = (stored(obj), told.output_path, told.rig.folder, told.capture_folder)
        begin = "//" if relative_paths else f"{project}/"
        assert paths == (f"{begin}a.frog", f"{begin}b.frog", f"{begin}rendered", "")
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


def test_a_moved_project_plays_and_renders(project, rendered):
    bpy.context.scene.frame_set(3)
    before = rendered(bpy.context.scene)
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "x.blend"))
    there = project.rename(project.parent / "elsewhere")
    bpy.ops.wm.open_mainfile(filepath=str(there / "x.blend"))
    shows(the_capture(), there / "a.frog", 2.0)
    np.testing.assert_array_equal(rendered(bpy.context.scene), before)


def test_blenders_own_operators_look_after_files(project, tmp_path, capfd):
    """Paths become absolute and relative; what is missing is reported and found."""
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "x.blend"))
    obj, there = the_capture(), tmp_path / "there"
    bpy.ops.file.make_paths_absolute()
    assert obj.frog.filepath == str(project / "a.frog")
    bpy.ops.file.make_paths_relative()
    assert stored(obj) == "//a.frog"
    there.mkdir()
    (project / "a.frog").rename(there / "a.frog")
    bpy.context.scene.frame_set(2)
    capfd.readouterr()
    bpy.ops.file.report_missing_files()
    assert str(project / "a.frog") in capfd.readouterr().out
    bpy.ops.file.find_missing_files(directory=f"{tmp_path}/")
    assert playback.file_of(obj).resolve() == there / "a.frog"
    plays(obj, there / "a.frog", 5)
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
    shows(the_capture(), original, 2.0)
    np.testing.assert_array_equal(rendered(bpy.context.scene), before)
    bpy.ops.wm.open_mainfile(filepath=str(blend))  # which deletes the copies and writes new ones
    plays(the_capture(), original, 5)
    bpy.ops.file.unpack_all(method="WRITE_LOCAL")
    assert playback.file_of(the_capture()).read_bytes() == original.read_bytes()
    plays(the_capture(), original, 7)


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


@pytest.fixture
def beside(project):
    """A saved .blend with a capture and training settings whose paths begin at its folder; their file."""
    bpy.ops.wm.save_as_mainfile(filepath=str(project / "x.blend"))
    the_capture().frog.filepath, bpy.context.scene.frog.output_path = "//a.frog", "//b.frog"
    plays(the_capture(), project / "a.frog", 3)
    return project / "a.frog"


def linked_into(blend, beside):
    """The capture of ``beside``, linked into a new .blend."""
    name = the_capture().name
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    with bpy.data.libraries.load(str(beside.parent / "x.blend"), link=True) as (_, blocks):
        blocks.objects = [name]
    return blocks.objects[0]


def test_saving_elsewhere_loses_nothing(beside, tmp_path):
    other = tmp_path / "p" / "q"
    other.mkdir(parents=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(other / "y.blend"))
    for _ in range(2):  # in the open .blend, and in what was written
        capture = the_capture()
        assert capture.frog.filepath.startswith("//") and playback.file_of(capture).resolve() == beside
        assert bpy.context.scene.frog.output_path.startswith("//..")
        plays(capture, beside, 5)
        bpy.ops.wm.open_mainfile(filepath=str(other / "y.blend"))


@pytest.mark.parametrize("saved", [False, True], ids=["unsaved", "saved"])
def test_what_is_appended_from_elsewhere_plays(beside, tmp_path, saved):
    """Its scene as well, whose training wrote beside it."""
    name = the_capture().name
    bpy.context.scene.name = "Filmed"
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    if saved:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    with bpy.data.libraries.load(str(beside.parent / "x.blend"), link=False) as (_, blocks):
        blocks.objects, blocks.scenes = [name], ["Filmed"]
    (obj,), (scene,) = blocks.objects, blocks.scenes
    assert playback.file_of(obj).resolve() == beside and obj.frog.filepath.startswith("//") == saved
    assert bpy.path.abspath(scene.frog.output_path) == str(beside.parent / "b.frog")
    scene.frame_set(5)
    shows(obj, beside, 4.0)


def overridden_here(linked):
    """An override of a linked object, in the scene in its place; Blender 5.3 makes none of what no scene has."""
    bpy.context.scene.collection.objects.link(linked)
    return linked.override_create(remap_local_usages=True)


def test_an_override_plays_what_its_library_does(beside, tmp_path):
    """And saving what overrides it elsewhere does not touch that."""
    from frog_blender.render.collect_instances import gather

    obj = overridden_here(linked_into(tmp_path / "mine.blend", beside))
    (tmp_path / "other").mkdir()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "other" / "mine.blend"))
    for _ in range(2):  # in the open .blend, and in what was written
        obj = the_capture()
        assert obj.library is None and obj.frog.filepath == "//a.frog" and playback.file_of(obj).resolve() == beside
        bpy.context.scene.frame_set(5)
        drawn, _ = gather(bpy.context.evaluated_depsgraph_get())
        np.testing.assert_allclose(drawn.means, ScenePlayer.load(beside).at_frame(4.0).means, atol=1e-6)
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "other" / "mine.blend"))


@pytest.mark.parametrize("overridden", [False, True], ids=["linked", "overridden"])
def test_what_is_made_local_keeps_its_file(beside, tmp_path, overridden):
    """Until it is saved by what the link was, from then on by what its own .blend says."""
    other = tmp_path / "other"
    other.mkdir()
    obj = linked_into(other / "mine.blend", beside)
    if overridden:
        obj = overridden_here(obj)
    else:
        bpy.context.scene.collection.objects.link(obj)
    assert playback.file_of(obj).resolve() == beside
    obj = obj.make_local() or obj
    obj.data.make_local()
    assert obj.library is None and obj.override_library is None and obj.frog.filepath == "//a.frog"
    plays(obj, beside, 5)
    bpy.ops.wm.save_mainfile()
    assert obj.frog.filepath.replace("\\", "/") == "//../project/a.frog"
    bpy.ops.wm.open_mainfile(filepath=str(other / "mine.blend"))
    obj = the_capture()
    plays(obj, beside, 3)
