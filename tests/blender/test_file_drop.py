"""Files that are dropped or chosen, several at once among them: what can be opened is, and the rest is said."""

from __future__ import annotations

import bpy
import pytest
from support.small_scenes import rig_of_three, write_scene

from frog_blender.engine.interchange.frame_files import write_frame
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.timeline import playback


def given(*paths):
    """What Blender passes."""
    files = [{"name": path.name} for path in paths]
    return {"filepath": str(paths[0]), "directory": f"{paths[0].parent}/", "files": files}


def played():
    return sorted(obj.frog.filepath for obj in playback.captures(bpy.data.objects))


@pytest.fixture
def scenes_of_two(tmp_path):
    return [write_scene(tmp_path / f"{name}.frog", rig_of_three(), seed=seed) for seed, name in enumerate("ab")]


def test_several_files(empty, scenes_of_two):
    assert bpy.ops.import_scene.frog(**given(*scenes_of_two)) == {"FINISHED"}
    assert played() == sorted(map(str, scenes_of_two))
    assert empty.camera.name == "cam00" and empty.camera.parent.parent.name == "a", "the first one sets the scene up"


def test_one_of_several_that_is_damaged(empty, scenes_of_two):
    first, second = scenes_of_two
    first.write_bytes(b"nonsense")
    with pytest.raises(RuntimeError, match=r"a\.frog"):  # the sentence; a script learns of it so
        bpy.ops.import_scene.frog(**given(*scenes_of_two))
    assert played() == [str(second)] and empty.camera.parent.parent.name == "b"


def test_several_splat_files_become_a_scene_each(empty, scenes_of_two, tmp_path):
    for path in scenes_of_two:
        write_frame(path.with_suffix(".ply"), ScenePlayer.load(path).at_frame(0))
        path.unlink()
    files = [path.with_suffix(".ply") for path in scenes_of_two]
    named = str(tmp_path / "one.frog")  # would be overwritten by the second
    assert bpy.ops.import_scene.frog_splats(**given(*files), scene_file=named) == {"FINISHED"}
    assert played() == sorted(map(str, scenes_of_two))


def test_frames_of_a_sequence_become_one_scene(empty, static_rig, tmp_path):
    folder = tmp_path / "frames"
    folder.mkdir()
    frames = [folder / f"{number}.ply" for number in range(3)]
    for number, frame in enumerate(frames):
        write_frame(frame, ScenePlayer.load(static_rig).at_frame(number))
    out = tmp_path / "out.frog"
    chosen = given(*frames[:2])
    assert bpy.ops.import_scene.frog_splats(**chosen, sequence=True, scene_file=str(out)) == {"FINISHED"}
    assert played() == [str(out)] and ScenePlayer.load(out).header.frame_count == 3


def test_every_file_handler_finds_what_it_fills_in(addon):
    """Blender fills in these, and ``invoke_popup`` of Blender's own scripts reads ``files``."""
    handlers = [cls for cls in bpy.types.FileHandler.__subclasses__() if cls.__module__.startswith("frog_blender")]
    assert len(handlers) == 3
    for handler in handlers:
        group, word = handler.bl_import_operator.split(".")
        properties = getattr(getattr(bpy.ops, group), word).get_rna_type().properties
        assert {"directory", "files"} <= set(properties.keys())
