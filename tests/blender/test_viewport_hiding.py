"""What hides splats in viewports: objects' surfaces, read seldom and put on the graphics card within limits."""

from types import SimpleNamespace

import bpy
import numpy as np
from support.blender_windows import viewport
from support.small_scenes import imported
from support.training_panel import panel_says
from support.users_scene import instance_in

from frog_blender import reported_once
from frog_blender.cameras import view_camera
from frog_blender.render import holdout
from frog_blender.ui import render_panel
from frog_blender.viewport import hiding, views
from frog_blender.viewport.projection import view_of


def mesh_object(name, *, triangles=1):
    """A fan of triangles around the origin, in a collection that nothing shows."""
    angles = np.linspace(0, 2 * np.pi, triangles + 1)
    points = [(0.0, 0.0, 0.0), *np.c_[np.cos(angles), np.sin(angles), angles].tolist()]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], [(0, k + 1, k + 2) for k in range(triangles)])
    return bpy.data.objects.new(name, mesh)


def test_instances_share_a_mesh_that_is_converted_once(empty, monkeypatch, capsys):
    reported_once.forget()
    inside = bpy.data.collections.new("inside")
    mesh, curve = mesh_object("fan"), bpy.data.objects.new("disk", bpy.data.curves.new("disk", "CURVE"))
    curve.data.dimensions, curve.data.fill_mode = "2D", "BOTH"
    spline = curve.data.splines.new("POLY")
    spline.points.add(2)
    spline.points.foreach_set("co", [0, 0, 0, 1, 1, 0, 0, 1, 0, 1, 0, 1])
    spline.use_cyclic_u = True
    mesh.location = (0, 0, 2)
    for obj in (mesh, curve):
        inside.objects.link(obj)
    for k in range(3):
        instance_in(empty.collection, inside, (k, 0, 0)).scale = (2, 2, 2)
    own = mesh_object("alone", triangles=5)
    empty.collection.objects.link(own)
    bpy.context.view_layer.update()
    converted, convert = [], holdout._mesh_of
    monkeypatch.setattr(holdout, "_mesh_of", lambda obj: converted.append((obj.name, obj.type)) or convert(obj))
    vertices, triangles = holdout.mesh_of(bpy.context.evaluated_depsgraph_get())
    # Blender gives a filled curve's mesh besides the curve.
    assert sorted(converted) == [("alone", "MESH"), ("disk", "CURVE"), ("disk", "MESH"), ("fan", "MESH")]
    seen = {tuple(place) for place in vertices[triangles].astype(float).mean(axis=1).round(2).tolist()}
    fans = {(k + 1.33, 0.0, 8.19) for k in range(3)}
    disks = {(round(k + 2 / 3, 2), 0.67, 0.0) for k in range(3)}
    assert fans | disks <= seen and len(triangles) == 3 * (1 + 2) + 5, "each where it stands"
    assert len(holdout.mesh_of(bpy.context.evaluated_depsgraph_get(), most=4)[1]) <= 4
    assert "hide no splats" in capsys.readouterr().err


def test_the_depth_of_surfaces_is_that_of_a_viewport(empty, monkeypatch):
    """Of the triangle (0, 0, 0), (1, 0, 0), (1, 0, 2 pi), 5 before an eye that looks along y; read once."""
    read, mesh_of = [], holdout.mesh_of
    monkeypatch.setattr(hiding, "mesh_of", lambda *given: read.append(1) or mesh_of(*given))
    empty.collection.objects.link(mesh_object("first"))
    bpy.context.view_layer.update()
    view, window = np.eye(4), np.zeros((4, 4))
    view[:3] = (1, 0, 0, -0.5), (0, 0, 1, -1.0), (0, -1, 0, -5.0)
    window[0, 0] = window[1, 1] = 1.5
    window[2, 2], window[2, 3], window[3, 2] = -1.01, -0.2, -1
    camera = view_camera(view, window, 60, 60)
    splats = view_of(camera, np.eye(4), view, window)
    context = SimpleNamespace(evaluated_depsgraph_get=bpy.context.evaluated_depsgraph_get, **viewport())
    surfaces = hiding.Surfaces()
    found = surfaces.depth(context, 0, camera, splats)
    expected = 0.5 + 0.5 * (window[2, 2] * -5 + window[2, 3]) / 5
    assert (found[0] == 1).any() and found.dtype == np.float32
    np.testing.assert_allclose(found[found < 1], expected, atol=1e-6)
    rows, columns = np.nonzero(found < 1)
    assert 20 < len(rows) < 1800 and columns.min() >= 30 - 0.5 * 1.5 / 5 * 30 - 1
    assert rows.min() >= 30 - 1.5 / 5 * 30 - 1, "the rows lie from the bottom"
    np.testing.assert_array_equal(surfaces.depth(context, 0, camera, splats), found)
    bpy.data.objects.remove(bpy.data.objects["first"])
    assert surfaces.depth(context, 1, camera, splats) is None and len(read) == 2


def test_the_cube_of_a_new_file_hides_nothing_and_what_frog_lacks_is_counted(new_file, static_rig):
    """And neither the grid nor empties lie over FROG's picture; the file keeps the overlays that were chosen."""
    view = viewport()
    space = view["space_data"]
    context = SimpleNamespace(scene=new_file, space_data=space, visible_objects=list(new_file.objects))
    cube = new_file.objects["Cube"]
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert not hiding.has_others(context) and holdout.mesh_of(depsgraph, space) is None
    assert holdout.mesh_of(depsgraph) is not None, "a render shows it"
    imported(static_rig, set_up_scene=False, use_frog_engine=True)
    space.shading.type, space.overlay.show_axis_x = "RENDERED", False
    assert hiding.undrawn(context) == ""
    cube.location.x = 1.0
    assert hiding.undrawn(context) == "1 object is not drawn" and hiding.has_others(context)
    assert "1 object is not drawn frog.compose" in panel_says(render_panel.FROG_PT_render, **vars(context))
    cube.hide_render = True
    assert hiding.undrawn(context) == "", "no render would show it"
    views._switch_overlays()
    overlay = space.overlay
    assert not (overlay.show_floor or overlay.show_extras or overlay.show_axis_x)
    views._show_overlays()
    assert overlay.show_floor and overlay.show_extras and not overlay.show_axis_x, "as a file is to keep them"
    views._switch_overlays()
    space.shading.type = "SOLID"
    assert hiding.undrawn(context) == ""
    views._switch_overlays()
    assert overlay.show_floor and overlay.show_extras and not overlay.show_axis_x
