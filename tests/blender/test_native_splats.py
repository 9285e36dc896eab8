"""The point cloud in Blenders that draw splats themselves (from 5.3): ``make test-bpy53``."""

import bpy
import pytest
from support.small_scenes import plays, rig_of_three, write_scene

from frog_blender import point_cloud
from frog_blender.engine.playback.player import ScenePlayer

draws_them = pytest.mark.skipif(not point_cloud.draws_splats(), reason="this Blender draws no splats itself")


@draws_them
def test_attributes_are_those_of_blenders_own_splats(empty, capture, static_rig):
    assert capture.type == "POINTCLOUD" and not capture.modifiers[:]
    found = {name: (attribute.data_type, attribute.domain) for name, attribute in capture.data.attributes.items()}
    assert found == {
        "position": ("FLOAT_VECTOR", "POINT"),
        "scale": ("FLOAT_VECTOR", "POINT"),
        "rotation": ("QUATERNION", "POINT"),
        "radiance:base": ("FLOAT4", "POINT"),
        **{f"radiance:sh_{k}": ("FLOAT_VECTOR", "POINT") for k in range(3)},
    }
    plays(capture, static_rig, 6)


@draws_them
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


@pytest.mark.skipif(point_cloud.draws_splats(), reason="this Blender draws splats itself")
def test_what_is_refused_leaves_points(empty, static_rig, capfd):
    """By a Blender that knows no such type of point cloud."""
    obj = point_cloud.create("refused", ScenePlayer.load(static_rig).at_frame(0), as_splats=True)
    assert obj.type == "MESH" and point_cloud.count(obj) == 60
    assert not bpy.data.pointclouds[:] and "splats cannot be used" in capfd.readouterr().err
