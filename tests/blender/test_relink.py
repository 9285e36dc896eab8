"""Captures whose file is missing: one choice mends them, and a wrong one changes nothing."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from support.small_scenes import rig_of_three, shows, write_scene

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.timeline import open_scenes, playback


@pytest.fixture
def lost(empty, tmp_path):
    """Three captures of two files in ``there`` that play them from ``here``, where they are no more."""
    here, there = tmp_path / "here", tmp_path / "there"
    here.mkdir()
    for seed, name in enumerate(("a", "b")):
        bpy.ops.import_scene.frog(filepath=str(write_scene(here / f"{name}.frog", rig_of_three(), seed=seed)))
    first, second = sorted(playback.captures(empty.objects), key=lambda obj: obj.frog.filepath)
    twin = first.copy()
    twin.data = first.data.copy()
    empty.collection.objects.link(twin)
    here.rename(there)
    empty.frame_set(3)
    assert all(open_scenes.is_missing(playback.file_of(obj)) for obj in (first, second, twin))
    return first, second, twin, there


def test_one_choice_mends_all(empty, lost):
    first, second, twin, there = lost
    assert bpy.ops.frog.relink(object_name=first.name, filepath=str(there / "a.frog")) == {"FINISHED"}
    assert [obj.frog.filepath for obj in (first, twin)] == [str(there / "a.frog")] * 2
    assert second.frog.filepath == str(there / "b.frog")
    for obj, name in ((first, "a"), (second, "b"), (twin, "a")):
        assert open_scenes.problem(playback.file_of(obj)) == ""
        shows(obj, there / f"{name}.frog", 2.0)


def test_a_renamed_file_is_found_for_all_captures_of_it(empty, lost):
    first, second, twin, there = lost
    (there / "a.frog").rename(there / "c.frog")
    (there / "b.frog").write_bytes(b"damaged meanwhile")
    bpy.ops.frog.relink(object_name=first.name, filepath=str(there / "c.frog"))
    assert first.frog.filepath == twin.frog.filepath == str(there / "c.frog")
    assert second.frog.filepath.endswith("here/b.frog"), "what cannot be played is no find"


def test_a_wrong_choice_changes_nothing(empty, lost):
    first, _, _, there = lost
    (there / "bad.frog").write_bytes(b"nonsense")
    for choice in ("bad.frog", "nothing.frog"):
        with pytest.raises(RuntimeError, match=choice):
            bpy.ops.frog.relink(object_name=first.name, filepath=str(there / choice))
    with pytest.raises(RuntimeError, match="found no such capture"):
        bpy.ops.frog.relink(object_name="nobody", filepath=str(there / "a.frog"))
    assert "here" in first.frog.filepath


@pytest.fixture
def beside(empty, tmp_path):
    """A saved .blend with a capture and training settings whose paths begin at its folder; their file."""
    home = tmp_path / "home"
    home.mkdir()
    path = write_scene(home / "a.frog", rig_of_three())
    bpy.ops.wm.save_as_mainfile(filepath=str(home / "x.blend"))
    bpy.ops.import_scene.frog(filepath=str(path))
    capture = next(playback.captures(bpy.context.scene.objects))
    capture.frog.filepath, bpy.context.scene.frog.output_path = "//a.frog", "//b.frog"
    bpy.context.scene.frame_set(3)
    shows(capture, path, 2.0)
    return path


def linked_into(blend, beside):
    """The capture of ``beside``, linked into a new .blend."""
    name = next(playback.captures(bpy.context.scene.objects)).name
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(blend))
    with bpy.data.libraries.load(str(beside.parent / "x.blend"), link=True) as (_, wanted):
        wanted.objects = [name]
    return wanted.objects[0]


def test_saving_elsewhere_loses_nothing(beside, tmp_path):
    other = tmp_path / "p" / "q"
    other.mkdir(parents=True)
    bpy.ops.wm.save_as_mainfile(filepath=str(other / "y.blend"))
    for _ in range(2):  # in the open .blend, and in what was written
        capture = next(playback.captures(bpy.context.scene.objects))
        assert capture.frog.filepath.startswith("//") and playback.file_of(capture).resolve() == beside
        assert bpy.context.scene.frog.output_path.startswith("//..")
        bpy.context.scene.frame_set(5)
        shows(capture, beside, 4.0)
        bpy.ops.wm.open_mainfile(filepath=str(other / "y.blend"))


@pytest.mark.parametrize("saved", [False, True], ids=["unsaved", "saved"])
def test_what_is_appended_from_elsewhere_plays(beside, tmp_path, saved):
    """Its scene as well, whose training wrote beside it."""
    name = next(playback.captures(bpy.context.scene.objects)).name
    bpy.context.scene.name = "Filmed"
    bpy.ops.wm.save_mainfile()
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    if saved:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "mine.blend"))
    with bpy.data.libraries.load(str(beside.parent / "x.blend"), link=False) as (_, wanted):
        wanted.objects, wanted.scenes = [name], ["Filmed"]
    (obj,), (scene,) = wanted.objects, wanted.scenes
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
        (obj,) = playback.captures(bpy.context.scene.objects)
        assert obj.library is None and obj.frog.filepath == "//a.frog" and playback.file_of(obj).resolve() == beside
        bpy.context.scene.frame_set(5)
        drawn, _ = gather(bpy.context.evaluated_depsgraph_get())
        np.testing.assert_allclose(drawn.means, ScenePlayer.load(beside).at_frame(4.0).means, atol=1e-6)
        bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "other" / "mine.blend"))
    (obj,) = playback.captures(bpy.context.scene.objects)
    with pytest.raises(RuntimeError, match="linked from"):
        bpy.ops.frog.relink(object_name=obj.name, filepath=str(beside))


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
    bpy.context.scene.frame_set(5)
    shows(obj, beside, 4.0)
    bpy.ops.wm.save_mainfile()
    assert obj.frog.filepath.replace("\\", "/") == "//../home/a.frog"
    bpy.ops.wm.open_mainfile(filepath=str(other / "mine.blend"))
    (obj,) = playback.captures(bpy.context.scene.objects)
    bpy.context.scene.frame_set(3)
    shows(obj, beside, 2.0)
