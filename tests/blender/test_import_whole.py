"""An import that fails leaves nothing, and one that works leaves alone what is the user's. Of several files that are
dropped or chosen, what can be opened is, and the rest is said."""

import bpy
import pytest
from support.small_scenes import rig_of_three, write_scene
from support.users_scene import users_scene, views

from frog_blender import point_cloud
from frog_blender.engine.errors import FrogError
from frog_blender.engine.interchange.frame_files import write_frame
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.scene_import import create_objects as importing
from frog_blender.scene_import import scene_setup
from frog_blender.scene_import.scene_setup import is_untouched, values
from frog_blender.timeline import playback


def everything():
    """The names of all data-blocks, by list; the shared nodes and material stay for the next import."""
    lists = [kind.identifier for kind in bpy.data.bl_rna.properties if kind.type == "COLLECTION"]
    return {name: sorted(block.name for block in getattr(bpy.data, name)) for name in lists}


STEPS = {
    "the Gaussians": (point_cloud, "write"),
    "a camera": (importing, "apply_lens"),
    "the last of the settings": (scene_setup, "set_background"),
    "the viewports": (scene_setup, "show_in_viewports"),
}


ERRORS = (ValueError("cannot convert float NaN to integer"), MemoryError(), FrogError("No."))


@pytest.mark.parametrize(("step", "error"), list(zip(STEPS, (*ERRORS, *ERRORS), strict=False)))
def test_whatever_fails_nothing_is_left(empty, static_rig, monkeypatch, step, error):
    users_scene(empty)
    before, settings = everything(), values(empty)
    module, name = STEPS[step]

    def fail(*_, **__):
        raise error

    monkeypatch.setattr(module, name, fail)
    with pytest.raises(RuntimeError) as refused:
        bpy.ops.import_scene.frog(filepath=str(static_rig), set_up_scene=True)
    said = str(refused.value).strip()
    assert "\n" not in said and "Traceback" not in said
    assert (str(static_rig) in said and type(error).__name__ in said) or "No." in said
    assert everything() == before and values(empty) == settings
    monkeypatch.undo()
    assert bpy.ops.import_scene.frog(filepath=str(static_rig)) == {"FINISHED"}


def test_a_world_that_is_replaced_stays_in_the_file(empty, static_rig, tmp_path):
    world = users_scene(empty)
    assert bpy.ops.import_scene.frog(filepath=str(static_rig), set_up_scene=True) == {"FINISHED"}
    assert empty.world != world and world.use_fake_user and empty.render.engine == "FROG"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "x.blend"))
    kept = bpy.data.worlds["My studio lights"]
    assert "TEX_ENVIRONMENT" in {node.type for node in kept.node_tree.nodes}


def test_a_new_file_is_set_up(new_file, static_rig):
    assert is_untouched(new_file) and len(new_file.objects) == 3
    assert bpy.ops.import_scene.frog(filepath=str(static_rig)) == {"FINISHED"}
    assert new_file.render.engine == "FROG" and new_file.camera.name == "cam00"
    assert (new_file.frame_start, new_file.frame_end) == (1, 10)
    assert new_file.render.fps / new_file.render.fps_base == pytest.approx(24.0)
    assert (new_file.render.resolution_x, new_file.render.resolution_y) == (96, 64)
    assert {"Cube", "Light", "Camera"} <= {obj.name for obj in new_file.objects}


def changed_cube(scene):
    bpy.data.objects["Cube"].location.x = 1.0


def another_engine(scene):
    scene.render.engine = "CYCLES"


def an_object(scene):
    scene.collection.objects.link(bpy.data.objects.new("Mine", None))


@pytest.mark.parametrize("change", [changed_cube, another_engine, an_object, users_scene])
def test_one_change_makes_it_the_users(new_file, static_rig, change):
    change(new_file)
    before, shading = values(new_file), [view.shading.type for view in views()]
    assert not is_untouched(new_file)
    assert bpy.ops.import_scene.frog(filepath=str(static_rig)) == {"FINISHED"}
    assert values(new_file) == before and [view.shading.type for view in views()] == shading


def test_one_capture_after_another(empty, capture, tmp_path):
    """Settings that came with a capture give way to the next one's; what the user changed since does not."""
    bpy.ops.import_scene.frog(filepath=str(write_scene(tmp_path / "b.frog", rig_of_three(), frame_count=20)))
    assert empty.frame_end == 20
    empty.frame_end = 15
    bpy.ops.import_scene.frog(filepath=str(write_scene(tmp_path / "c.frog", rig_of_three(), frame_count=30)))
    assert empty.frame_end == 15


def test_set_up_scene_is_one_step(empty, static_rig):
    users_scene(empty)
    bpy.ops.ed.undo_push(message="Mine")
    before = {path: getattr(value, "name", value) for path, value in values(empty).items()}
    bpy.ops.import_scene.frog("EXEC_DEFAULT", True, filepath=str(static_rig))
    assert bpy.ops.frog.set_up_scene("EXEC_DEFAULT", True) == {"FINISHED"}
    scene = bpy.context.scene
    assert (scene.frame_end, scene.render.engine, scene.camera.name) == (10, "FROG", "cam00")
    assert scene.view_settings.view_transform == "Standard" and bpy.data.worlds["My studio lights"].users == 1
    bpy.ops.ed.undo()
    after = {path: getattr(value, "name", value) for path, value in values(bpy.context.scene).items()}
    assert after == before and not bpy.data.worlds["My studio lights"].use_fake_user


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
    frames = [folder / f"{digit}.ply" for digit in range(3)]
    for digit, frame in enumerate(frames):
        write_frame(frame, ScenePlayer.load(static_rig).at_frame(digit))
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
