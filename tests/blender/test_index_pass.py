"""The Object Index pass: every pixel names the capture whose surface it shows."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from support.exr import pass_of, render_channels
from support.small_scenes import imported, passes_of, rig_of_three, write_scene
from support.users_scene import eye_in

from frog_blender.engine.interchange.frame_files import write_frame
from frog_blender.engine.interchange.imports import import_scene
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.render import passes


def rendered_indices(scene, tmp_path):
    """(H, W) of a render."""
    bpy.context.view_layer.use_pass_object_index = True
    return pass_of(render_channels(scene, tmp_path / "indices.exr"), passes.INDEX)


def solid(path, seed):
    """A still capture without cameras, whose Gaussians are nearly opaque."""
    moving = write_scene(path.with_name("moving.frog"), rig_of_three(), count=60 - seed, seed=seed)
    gaussians = ScenePlayer.load(moving).at_frame(0)
    write_frame(path.with_suffix(".ply"), replace(gaussians, opacities=np.full(60 - seed, 0.98)))
    return import_scene(path.with_suffix(".ply"), path).path


@pytest.fixture
def pair(empty, capture, tmp_path):
    """Two captures, the second one smaller and nearer to the camera, with the indices 3 and 1000."""
    bpy.data.objects.remove(capture)  # of which the cameras are left
    made = []
    for name, seed, index in (("far", 0, 3), ("near", 1, 1000)):
        made.append(imported(solid(tmp_path / f"{name}.frog", seed)))
        made[-1].pass_index = index
    made[1].parent.location, made[1].parent.scale = (0.2, -1.5, 0.5), (0.3,) * 3
    return made


def alone(scene, captures, seen, tmp_path):
    """Depth of one of the captures."""
    for obj in captures:
        obj.hide_render = obj is not seen
    depth = passes_of(scene, tmp_path)[1]
    for obj in captures:
        obj.hide_render = False
    return depth


def test_the_nearer_surface_is_named(empty, pair, tmp_path):
    found = rendered_indices(empty, tmp_path)
    assert set(np.unique(found)) == {0.0, 3.0, 1000.0}
    behind, before = (alone(empty, pair, seen, tmp_path) for seen in pair)
    assert ((behind < 1e9) & (before < 1e9)).mean() > 0.02
    expected = np.where(before < behind, 1000, 3) * (np.minimum(before, behind) < 1e9)
    assert (found == expected).mean() > 0.97  # at edges the half may be that of one behind both


def test_motion_blur_and_a_region_keep_it(empty, pair, tmp_path):
    whole = rendered_indices(empty, tmp_path)
    empty.render.use_motion_blur = True
    empty.render.use_border, empty.render.border_min_x, empty.render.border_max_x = True, 0.25, 0.75
    empty.render.border_min_y, empty.render.border_max_y = 0.5, 1.0
    empty.render.use_crop_to_border = True
    part = rendered_indices(empty, tmp_path)
    np.testing.assert_array_equal(part, whole[:32, 24:72])


def test_it_has_the_name_that_cycles_gives_it(empty, tmp_path):
    empty.render.engine = "CYCLES"
    empty.cycles.samples = 1
    empty.render.resolution_x = empty.render.resolution_y = 8
    eye_in(empty)
    bpy.context.view_layer.use_pass_object_index = True
    channels = render_channels(empty, tmp_path / "cycles.exr")
    assert passes.INDEX in {name.split(".")[1] for name in channels}
