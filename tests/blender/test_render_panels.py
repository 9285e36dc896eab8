"""Panels of the Properties editor while FROG is the engine."""

import bpy
import numpy as np
import pytest
from support.training_panel import panel_says

from frog_blender.render import blur
from frog_blender.render.world import background_of
from frog_blender.ui import render_panels


@pytest.fixture
def frog(empty):
    """A scene that FROG renders."""
    empty.render.engine = "FROG"
    return empty


def said(panel, part="draw"):
    return panel_says(panel, part, engine=bpy.context.scene.render.engine)


def test_depth_of_field_is_the_cameras(frog):
    panel = render_panels.FROG_PT_depth_of_field
    assert said(panel) is None, "there is no camera"
    data = bpy.data.cameras.new("eye")
    frog.camera = bpy.data.objects.new("eye", data)
    assert said(panel, "draw_header") == "use_dof" and "as long as" not in said(panel)
    data.dof.use_dof, frog.frog.lens_samples = True, 24
    assert "focus_distance aperture_fstop lens_samples" in said(panel) and "as long as 24 without" in said(panel)
    frog.render.use_motion_blur, frog.frog.motion_samples = True, 30
    assert "as long as 30 without" in said(panel), "they share their samples"
    assert len(blur.samples(frog, 1.0, None)) == 30
    data.type = "PANO"
    assert said(panel) is None


def test_the_background_is_the_worlds(frog):
    panel = render_panels.FROG_PT_background
    assert panel.bl_context == "world"
    frog.world = None
    assert "the capture's own" in said(panel)
    frog.world = world = bpy.data.worlds.new("Mine")
    if bpy.app.version < (5, 0, 0):  # later worlds always have nodes
        world.use_nodes = True
    assert said(panel) == "default_value default_value"
    node = render_panels.background_node(world)
    node.inputs["Color"].default_value = (1.0, 0.0, 0.0, 1.0)
    np.testing.assert_allclose(background_of(frog, np.zeros(3)), (1.0, 0.0, 0.0), atol=1e-6)
    sky = world.node_tree.nodes.new("ShaderNodeTexSky")
    world.node_tree.links.new(sky.outputs[0], node.inputs["Color"])
    assert said(panel) == "color", "a sky is not drawn"
    frog.render.film_transparent = True
    assert "Transparent is on" in said(panel)
