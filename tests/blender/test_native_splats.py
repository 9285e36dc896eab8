"""The carrier of Blenders that draw splats themselves (5.3), as far as a Blender with its data can tell (5.2)."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from small_scenes import rig_of_three, write_scene

from frog_blender import point_cloud
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.render import collect_instances

NATIVE = point_cloud.draws_splats()
can_hold_them = pytest.mark.skipif(bpy.app.version < (5, 2, 0), reason="point clouds cannot be resized")


@pytest.fixture
def capture(empty, static_rig, monkeypatch):
    if not NATIVE:
        monkeypatch.setattr(point_cloud, "draws_splats", lambda: True)
        monkeypatch.setattr(point_cloud, "make_splats", lambda cloud: None)
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    return bpy.context.object


@can_hold_them
def test_attributes_are_those_of_blenders_own_splats(empty, capture, static_rig):
    assert capture.type == "POINTCLOUD" and not capture.modifiers[:]
    found = {name: (each.data_type, each.domain) for name, each in capture.data.attributes.items()}
    assert found == {
        "position": ("FLOAT_VECTOR", "POINT"),
        "scale": ("FLOAT_VECTOR", "POINT"),
        "rotation": ("QUATERNION", "POINT"),
        "radiance:base": ("FLOAT4", "POINT"),
        **{f"radiance:sh_{k}": ("FLOAT_VECTOR", "POINT") for k in range(3)},
    }
    empty.frame_set(6)
    shown, gaussians = point_cloud.read(capture), ScenePlayer.load(static_rig).at_frame(5)
    np.testing.assert_allclose(shown["position"], gaussians.means, atol=1e-5)
    np.testing.assert_allclose(shown["rotation"], gaussians.quaternions, atol=1e-5)
    np.testing.assert_allclose(shown["radiance:base"][:, :3], gaussians.sh[:, 0], atol=1e-5)
    np.testing.assert_allclose(shown["radiance:base"][:, 3], gaussians.opacities, atol=1e-5)
    np.testing.assert_allclose(shown["radiance:sh_1"], gaussians.sh[:, 2], atol=1e-5)


@can_hold_them
def test_frog_draws_it_once_however_it_is_shown(empty, capture, rendered):
    before = rendered(empty)
    assert before.std() > 10
    for kind in ("ELLIPSOIDS", "POINTS"):
        capture.frog.display = kind
        found = collect_instances.visible_captures(bpy.context.evaluated_depsgraph_get())
        assert [obj for obj, *_ in found] == [capture]
        np.testing.assert_array_equal(rendered(empty), before)
    point_cloud.draw_in_renders(capture, False)
    np.testing.assert_array_equal(rendered(empty), before)
    point_cloud.draw_in_renders(capture, True)
    assert not capture.modifiers[:]


@can_hold_them
def test_saved_thinned_and_changed(empty, capture, static_rig, tmp_path):
    capture.frog.density = 50
    assert point_cloud.count(capture) == 30
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
    assert point_cloud.count(capture) == 30
    name = capture.name
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "x.blend"))
    again = bpy.data.objects[name]
    assert again.type == "POINTCLOUD" and point_cloud.count(again) == 30
    write_scene(static_rig, rig_of_three(), count=44, sh_count=1)
    bpy.context.scene.frame_set(3)
    assert point_cloud.count(again) == 22 and "radiance:sh_0" not in point_cloud.read(again)


def test_what_is_refused_leaves_points(empty, static_rig, monkeypatch, capfd):
    """Here by a Blender that knows no such type of point cloud, or says so."""
    monkeypatch.setattr(point_cloud, "draws_splats", lambda: True)

    def refuse(cloud):
        raise TypeError("no such type")

    monkeypatch.setattr(point_cloud, "make_splats", refuse)
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    assert bpy.context.object.type == "MESH" and point_cloud.count(bpy.context.object) == 60
    assert not bpy.data.pointclouds[:] and "no such type" in capfd.readouterr().err
