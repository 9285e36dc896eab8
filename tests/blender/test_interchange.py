"""Export of frames, scenes and web pages, import of 3DGS splats: there and back is the same. In a window an export
writes one frame at a time, is stopped by Esc, and is at an end whatever happens meanwhile."""

import json
import re
from pathlib import Path
from types import SimpleNamespace

import bpy
import mathutils
import numpy as np
import pytest
from support.blender_windows import in_window
from support.foreign_takes import assert_equal_within
from support.small_scenes import animate, imported, rig_of_three, write_scene

from frog_blender import point_cloud
from frog_blender.engine.interchange.frame_files import write_frame
from frog_blender.engine.interchange.ply import read_splats
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.transform import transform
from frog_blender.operators import export_scene
from frog_blender.operators.export_scene import FROG_OT_export_frames
from frog_blender.operators.import_ply import FROG_OT_import_splats
from frog_blender.scene_import.capture_objects import active_capture
from frog_blender.timeline import playback


def assert_same(path, gaussians):
    """A .ply holds these Gaussians, to 1e-6."""
    assert_equal_within(read_splats(path).gaussians, gaussians, 1e-6)


def test_the_current_frame(empty, capture, static_rig, tmp_path):
    empty.frame_set(4, subframe=0.5)
    export = bpy.ops.export_scene.frog_frames
    assert export(filepath=str(tmp_path / "now.ply"), apply_transform=False) == {"FINISHED"}
    assert_same(tmp_path / "now.ply", ScenePlayer.load(static_rig).at_frame(3.5))


def test_a_range_goes_through_the_timeline(empty, capture, static_rig, tmp_path):
    """With the capture's own speed, and leaving the scene where it stood."""
    empty.frame_set(2)
    capture.frog.speed = 2.0
    options = {"frames": "CUSTOM", "first": 3, "last": 5, "apply_transform": False}
    bpy.ops.export_scene.frog_frames(filepath=str(tmp_path / "out" / "x.ply"), **options)
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["x_0003.ply", "x_0004.ply", "x_0005.ply"] and empty.frame_current == 2
    assert_same(tmp_path / "out" / "x_0004.ply", ScenePlayer.load(static_rig).at_frame(6))
    empty.frame_start, empty.frame_end = 2, 3
    bpy.ops.export_scene.frog_frames(filepath=str(tmp_path / "all" / "x.ply"), frames="SCENE")
    assert len(list((tmp_path / "all").iterdir())) == 2
    with pytest.raises(RuntimeError, match=r"The range is empty: .* ends at frame 3"):
        bpy.ops.export_scene.frog_frames(filepath=str(tmp_path / "x.ply"), frames="CUSTOM", first=5, last=3)


def test_applied_transform_of_an_animated_root(empty, capture, static_rig, tmp_path):
    root = capture.parent
    animate(root, "rotation_euler", (1, (0.3, 0.0, -0.4)), (5, (0.3, 1.2, -0.4)))
    root.scale, root.location = (2.0,) * 3, (1.0, -2.0, 0.5)
    options = {"frames": "CUSTOM", "first": 3, "last": 5, "apply_transform": True, "y_down": False}
    bpy.ops.export_scene.frog_frames(filepath=str(tmp_path / "x.ply"), **options)
    turn = mathutils.Euler((0.3, 1.2, -0.4)).to_matrix().to_4x4()
    inside = mathutils.Matrix.Scale(2.0, 4) @ capture.matrix_parent_inverse
    matrix = mathutils.Matrix.Translation(root.location) @ turn @ inside
    expected = transform(ScenePlayer.load(static_rig).at_frame(4), np.array(matrix))
    assert_same(tmp_path / "x_0005.ply", expected)
    root.scale = (1.0, 2.0, 1.0)
    with pytest.raises(RuntimeError, match="can only be scaled evenly, or be exported without Apply Transform"):
        bpy.ops.export_scene.frog_frames(filepath=str(tmp_path / "y.ply"))
    assert not (tmp_path / "y.ply").exists()


PLACES = [
    mathutils.Matrix.LocRotScale((3.0, -40.0, 0.5), mathutils.Euler((2.0, -0.7, 3.0)), (0.02,) * 3),
    mathutils.Matrix.LocRotScale((-7.0, 0.1, 900.0), mathutils.Euler((-1.0, 0.4, -2.2)), (35.0,) * 3),
]


@pytest.mark.parametrize(("place", "sh_count"), list(zip(PLACES, (1, 16), strict=True)), ids=["small", "large"])
def test_every_gaussian_comes_back_to_its_place(empty, tmp_path, place, sh_count):
    """Turned, and its colours with it, wherever the root of the capture is."""
    path = write_scene(tmp_path / "figure.frog", rig_of_three(), sh_count=sh_count)
    before = imported(path)
    before.parent.matrix_world = place
    bpy.ops.export_scene.frog_frames(filepath=str(tmp_path / "still.ply"))
    bpy.ops.import_scene.frog_splats(filepath=str(tmp_path / "still.ply"))
    after = active_capture(bpy.context)
    bpy.context.view_layer.update()
    expected, returned = (
        transform(ScenePlayer.load(obj.frog.filepath).at_frame(0), np.array(obj.matrix_world))
        for obj in (before, after)
    )
    size = np.abs(expected.means).max()
    np.testing.assert_allclose(returned.means, expected.means, rtol=1e-4, atol=1e-6 * size)
    returned.means = expected.means
    assert_equal_within(returned, expected, 1e-4, 1e-4)


@pytest.mark.parametrize("file_format", [".compressed.ply", ".sog"])
def test_packed_frames_come_back_to_their_place(empty, capture, static_rig, tmp_path, file_format):
    """Which no such file names: they are turned to y down, and back again."""
    pytest.importorskip("cv2")
    capture.parent.location = (1.0, 2.0, 3.0)
    bpy.context.view_layer.update()
    expected = transform(ScenePlayer.load(static_rig).at_frame(0), np.array(capture.matrix_world)).means
    bpy.ops.export_scene.frog_frames(filepath=str(tmp_path / "x.ply"), file_format=file_format)
    assert Path(file_format).suffix in FROG_OT_import_splats.import_menu
    bpy.ops.import_scene.frog_splats(filepath=str(tmp_path / f"x{file_format}"))
    after = active_capture(bpy.context)
    bpy.context.view_layer.update()
    actual = transform(ScenePlayer.load(after.frog.filepath).at_frame(0), np.array(after.matrix_world)).means
    np.testing.assert_allclose(np.sort(actual, axis=0), np.sort(expected, axis=0), atol=0.02)


@pytest.mark.parametrize("name", ["x.ply", "x.compressed.ply", "x.SOG", "x"])
@pytest.mark.parametrize("file_format", [name for name, *_ in export_scene.FORMATS])
def test_the_browser_names_the_file_that_is_written(name, file_format):
    """Which it warns of where there is one; a folder without a name stays one."""
    dialog = SimpleNamespace(filepath=f"//v1.2/{name}", file_format=file_format)
    assert FROG_OT_export_frames.check(dialog, bpy.context) and dialog.filepath == f"//v1.2/x{file_format}"
    dialog.filepath = "//v1.2/"
    assert not FROG_OT_export_frames.check(dialog, bpy.context) and dialog.filepath == "//v1.2/"


def test_a_still_in_an_empty_scene(empty, static_rig, tmp_path):
    write_frame(tmp_path / "x.ply", ScenePlayer.load(static_rig).at_frame(2))
    camera = bpy.data.objects.new("mine", bpy.data.cameras.new("mine"))
    empty.collection.objects.link(camera)
    empty.camera, empty.frame_end = camera, 77
    target = tmp_path / "deep" / "named.frog"
    asked = {"compact": True, "set_up_scene": True}
    bpy.ops.import_scene.frog_splats(filepath=str(tmp_path / "x.ply"), scene_file=str(target), **asked)
    still = active_capture(bpy.context)
    assert (empty.camera, empty.frame_end, empty.render.engine) == (camera, 77, "FROG")
    assert Path(still.frog.filepath) == target and empty.view_settings.view_transform == "Standard"
    assert not [obj for obj in empty.objects if obj.type == "CAMERA" and obj is not camera]
    up = still.matrix_world.to_3x3() @ mathutils.Vector((0.0, -1.0, 0.0))
    assert up.z == pytest.approx(1.0, abs=1e-6)
    shown = point_cloud.read(still)["position"]
    empty.frame_set(40)
    np.testing.assert_array_equal(point_cloud.read(still)["position"], shown)
    bpy.ops.import_scene.frog_splats(filepath=str(tmp_path / "x.ply"), turn_upright=False)
    bpy.context.view_layer.update()
    assert active_capture(bpy.context).matrix_world == mathutils.Matrix.Identity(4)


def test_bad_splats_are_an_error_in_a_sentence(empty, tmp_path):
    (tmp_path / "mesh.ply").write_bytes(b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n")
    with pytest.raises(RuntimeError, match=r"mesh\.ply: found no y, z"):
        bpy.ops.import_scene.frog_splats(filepath=str(tmp_path / "mesh.ply"))
    assert not empty.objects[:] and not bpy.data.collections[:] and not list(tmp_path.glob("mesh*.frog"))


def test_a_blender_without_a_usd_library_says_so(empty, capture, tmp_path, monkeypatch):
    monkeypatch.setattr(export_scene, "find_spec", lambda name: None)
    with pytest.raises(RuntimeError, match="This Blender's Python has no USD library"):
        bpy.ops.export_scene.frog_usd(filepath=str(tmp_path / "x.usdc"))
    assert not list(tmp_path.glob("x.*"))


def described(path):
    (text,) = re.findall(r'id="description">(.*?)</script>', path.read_text(encoding="utf-16"))
    return json.loads(text)


def test_the_timelines_frames_at_its_rate(empty, capture, tmp_path):
    empty.frame_set(3)
    out = tmp_path / "out.html"
    options = {"frames": "CUSTOM", "first": 2, "last": 6}
    assert bpy.ops.export_scene.frog_web_page(filepath=str(out), **options) == {"FINISHED"}
    assert empty.frame_current == 3 and [path.name for path in tmp_path.glob("*.html")] == ["out.html"]
    description = described(out)
    assert description["frames"] == 5 and description["dynamic"] > 0
    assert description["frames_per_second"] == empty.render.fps / empty.render.fps_base
    assert bpy.ops.export_scene.frog_web_page(filepath=str(out), frames="CURRENT") == {"FINISHED"}
    assert described(out)["frames"] == 1


def test_edits_are_exported_and_animated_ones_at_every_frame(empty, capture, tmp_path):
    out, options = tmp_path / "out.html", {"frames": "CUSTOM", "first": 1, "last": 3}
    bpy.ops.export_scene.frog_web_page(filepath=str(out), **options)
    whole = described(out)
    bpy.ops.frog.select_gaussians(by="OPACITY", opacity=0.6)
    bpy.ops.frog.hide_gaussians()
    bpy.ops.export_scene.frog_web_page(filepath=str(out), **options)
    left = described(out)
    assert 0 < left["count"] < whole["count"] and left["dynamic"] <= whole["dynamic"]
    animate(capture.frog_edits.grade, "exposure", (1, 0.0), (3, 1.0))
    bpy.ops.export_scene.frog_web_page(filepath=str(out), **options)
    graded = described(out)
    assert graded["dynamic"] == graded["count"] == left["count"]  # light changes what rests as well


@pytest.fixture
def export(empty, static_rig, tmp_path):
    """A function that begins an export of frames 1 to 10 as the file browser does, and gives the running operator."""
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    empty.frame_set(4)

    def begin(**options):
        window.said.clear()
        assert bpy.ops.export_scene.frog_frames(
            filepath=str(tmp_path / "out" / "x.ply"), frames="SCENE", **options
        ) == {"RUNNING_MODAL"}
        window.folder = tmp_path / "out"
        return window

    with in_window(FROG_OT_export_frames) as window:
        yield begin


def written(running):
    """Names of the files, each of which can be read."""
    paths = sorted(path for path in running.folder.glob("*")) if running.folder.is_dir() else []
    assert all(len(read_splats(path).arrays["means"]) == 60 for path in paths)
    return [path.name for path in paths]


def is_over(running):
    return running.operator.timer is None and running.started[-1][1].gi_frame is None


def test_a_frame_each_time_until_all_are_there(empty, export, static_rig):
    running = export(apply_transform=False)
    assert written(running) == []
    for done in range(1, 11):
        assert running.send() == {"PASS_THROUGH"} and len(written(running)) == done
        assert running.send("MOUSEMOVE") == {"PASS_THROUGH"} and len(written(running)) == done
    assert running.send() == {"FINISHED"} and is_over(running)
    assert running.said == [("INFO", f"10 files written to {running.folder}.")]
    means = read_splats(running.folder / "x_0007.ply").arrays["means"]
    np.testing.assert_array_equal(means, ScenePlayer.load(static_rig).at_frame(6).means)
    assert empty.frame_current == 4


def test_it_is_stopped_and_files_stay(empty, export):
    running = export(apply_transform=True)
    running.send(times=3)
    assert empty.frame_current == 3
    assert running.send("RIGHTMOUSE", value="RELEASE") == {"PASS_THROUGH"}, "of a key that was pressed before"
    assert running.send("RIGHTMOUSE", value="PRESS") == {"CANCELLED"} and is_over(running)
    assert written(running) == ["x_0001.ply", "x_0002.ply", "x_0003.ply"] and empty.frame_current == 4
    assert running.said == [("INFO", f"The export was stopped. 3 of 10 files were written to {running.folder}.")]
    assert running.send() == {"CANCELLED"} and len(written(running)) == 3, "a late event does nothing"


def test_an_error_in_the_middle_ends_it_in_a_sentence(empty, export):
    running = export()
    running.send(times=2)
    (running.folder / "x_0003.ply").mkdir()  # where the next file goes
    assert running.send() == {"CANCELLED"} and is_over(running)
    (running.folder / "x_0003.ply").rmdir()
    assert len(written(running)) == 2
    ((kind, text),) = running.said
    assert kind == "ERROR" and "x_0003.ply" in text and text.count(". ") == 0
    assert text.endswith(f"2 of 10 files were written to {running.folder}.")


def test_the_capture_is_deleted_meanwhile(empty, export):
    running = export(apply_transform=True)
    running.send(times=2)
    name = active_capture(bpy.context).name
    bpy.data.objects.remove(next(playback.captures(empty.objects)))
    assert running.send() == {"CANCELLED"} and is_over(running) and len(written(running)) == 2
    ((kind, text),) = running.said
    assert kind == "ERROR" and text.startswith(f"{name}: this capture is no longer in the file; 2 of 10 files")
    assert empty.frame_current == 4


def test_another_scene_is_shown_then_the_first_is_deleted(empty, export, static_rig):
    running = export(apply_transform=True, y_down=False)
    running.send(times=2)
    bpy.context.window.scene = bpy.data.scenes.new("Other")
    assert running.send() == {"PASS_THROUGH"}
    means = read_splats(running.folder / "x_0003.ply").arrays["means"]
    np.testing.assert_allclose(means, ScenePlayer.load(static_rig).at_frame(2).means, atol=1e-6)
    capture = next(playback.captures(empty.objects))
    bpy.context.scene.collection.objects.link(capture)  # or it would go with its scene
    bpy.data.scenes.remove(empty)
    assert running.send() == {"CANCELLED"} and is_over(running) and len(written(running)) == 3
    assert "its scene was deleted during the export" in running.said[0][1]


def test_one_frame_and_a_repetition_are_written_at_once(empty, export, tmp_path, monkeypatch):
    assert bpy.ops.export_scene.frog_frames(filepath=str(tmp_path / "now.ply"), frames="CURRENT") == {"FINISHED"}
    running = export()
    assert running.operator.execute(bpy.context) == {"FINISHED"}, "Repeat Last comes to the same operator again"
    assert len(written(running)) == 10
    bpy.data.objects.remove(next(playback.captures(bpy.context.scene.objects)))
    assert running.operator.execute(bpy.context) == {"CANCELLED"}, "it was deleted while the file browser was open"
