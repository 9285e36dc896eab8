"""What hides splats in viewports: objects' surfaces, read seldom and put on the graphics card within limits."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from support.blender_windows import viewport

from frog_blender.render import holdout
from frog_blender.render.holdout import Surface
from frog_blender.viewport import drawing, hiding
from frog_blender.viewport.picture import Picture


def mesh_object(name, *, triangles=1):
    """A fan of triangles around the origin, in a collection that nothing shows."""
    angles = np.linspace(0, 2 * np.pi, triangles + 1)
    points = [(0.0, 0.0, 0.0), *np.c_[np.cos(angles), np.sin(angles), angles].tolist()]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(points, [], [(0, k + 1, k + 2) for k in range(triangles)])
    return bpy.data.objects.new(name, mesh)


def test_instances_share_a_mesh_that_is_converted_once(empty, monkeypatch):
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
        instance = bpy.data.objects.new(f"instance {k}", None)
        instance.instance_type, instance.instance_collection = "COLLECTION", inside
        instance.location, instance.scale = (k, 0, 0), (2, 2, 2)
        empty.collection.objects.link(instance)
    own = mesh_object("alone", triangles=5)
    empty.collection.objects.link(own)
    bpy.context.view_layer.update()
    converted, convert = [], holdout._mesh_of
    monkeypatch.setattr(holdout, "_mesh_of", lambda obj: converted.append((obj.name, obj.type)) or convert(obj))
    found = list(holdout.surfaces(bpy.context.evaluated_depsgraph_get()))
    # Blender gives a filled curve's mesh besides the curve.
    assert sorted(converted) == [("alone", "MESH"), ("disk", "CURVE"), ("disk", "MESH"), ("fan", "MESH")]
    assert len(found) == 10 and len({id(surface.vertices) for surface in found}) == 4
    places = {tuple(surface.placed().astype(np.float64).mean(axis=0).round(3).tolist()) for surface in found}
    fans = {(k + 1.333, 0.0, 8.189) for k in range(3)}
    disks = {(round(k + 2 / 3, 3), 0.667, 0.0) for k in range(3)}
    assert {place for place in places if place[2] > 5} == fans, "each where it stands"
    assert disks <= places


def test_too_many_triangles_are_boxes(capsys):
    random = np.random.default_rng(0)
    meshes = [random.normal(size=(count, 3)).astype(np.float32) for count in (30, 90, 60, 50)]
    turned = np.array(Matrix.Rotation(0.7, 4, "Z") @ Matrix.Translation((1, 2, 3)))
    found = [Surface(points, np.arange(len(points) // 3 * 3).reshape(-1, 3), turned) for points in meshes]
    whole = hiding.within(found)
    assert [len(points) for points, _ in whole] == [30, 90, 60, 50] and not capsys.readouterr().err
    parts = hiding.within(found, most=100)
    assert [len(points) for points, _ in parts] == [30, 8, 60, 8]
    assert "bounding boxes" in capsys.readouterr().err
    for k in (1, 3):
        points, corners = parts[k]
        local = (points - turned[:3, 3]) @ turned[:3, :3]
        np.testing.assert_allclose([local.min(0), local.max(0)], [meshes[k].min(0), meshes[k].max(0)], atol=1e-5)
        sides = local[corners]
        area = np.linalg.norm(np.cross(sides[:, 1] - sides[:, 0], sides[:, 2] - sides[:, 0]), axis=1).sum() / 2
        a, b, c = np.ptp(meshes[k], axis=0)
        assert area == pytest.approx(2 * (a * b + b * c + c * a), rel=1e-5), "closed"
    assert [len(points) for points, _ in hiding.within(found, most=100, most_boxes=0)] == [30]


@pytest.fixture
def read(empty, monkeypatch):
    """A function that brings a viewport's surfaces up to date, and how often they were read until then."""
    batches = []
    monkeypatch.setattr(hiding, "surface_batch", lambda _shader, found: batches.append(len(found)) or len(found))
    empty.collection.objects.link(mesh_object("first"))
    bpy.context.view_layer.update()

    def update(surfaces, looked_at, *, is_still=False):
        context = SimpleNamespace(evaluated_depsgraph_get=bpy.context.evaluated_depsgraph_get, **viewport())
        surfaces.update(None, context, looked_at, is_still=is_still)
        return len(batches)

    return update


def test_slow_surfaces_are_read_when_nothing_moves(read, monkeypatch):
    monkeypatch.setattr(hiding, "_QUICK", -1.0)
    surfaces = hiding.Surfaces()
    assert read(surfaces, 0) == 1 and not surfaces.is_outdated, "the first are waited for"
    assert read(surfaces, 0) == 1 and read(surfaces, 0, is_still=True) == 1, "nothing has changed"
    for frame in range(1, 5):
        assert read(surfaces, frame) == 1 and surfaces.is_outdated
    assert read(surfaces, 4, is_still=True) == 2 and not surfaces.is_outdated
    assert read(surfaces, 5) == 2 and read(surfaces, 4) == 2 and not surfaces.is_outdated, "as they were"
    monkeypatch.setattr(hiding, "_QUICK", 1e9)
    assert read(surfaces, 6) == 3 and not surfaces.is_outdated


def test_what_kinds_of_objects_a_viewport_shows_determines_its_surfaces(empty):
    """Blender tells of no change in the scene; and viewports do not have each other's."""
    splats, space = drawing.state(), viewport()["space_data"]
    context = SimpleNamespace(scene=empty, view_layer=bpy.context.view_layer, space_data=space)
    found = [drawing._looked_at(splats, context)]
    for kind in ("mesh", "curve", "surf", "meta", "font"):
        setattr(space, f"show_object_viewport_{kind}", False)
        found.append(drawing._looked_at(splats, context))
        setattr(space, f"show_object_viewport_{kind}", True)
    context.view_layer = empty.view_layers.new("other")
    found.append(drawing._looked_at(splats, context))
    assert len(set(found)) == len(found)
    assert Picture().surfaces is not Picture().surfaces


def test_how_much_is_seen_through_objects(empty):
    shading = viewport()["space_data"].shading
    shading.type, shading.show_xray, shading.xray_alpha = "SOLID", False, 0.3
    assert hiding.seen_through(shading) == 0.0
    shading.show_xray = True
    assert hiding.seen_through(shading) == pytest.approx(0.7)
    shading.type, shading.show_xray_wireframe, shading.xray_alpha_wireframe = "WIREFRAME", True, 0.0
    assert hiding.seen_through(shading) == 0.5, "the wires stay in sight"
    shading.xray_alpha_wireframe = 0.8
    assert hiding.seen_through(shading) == pytest.approx(0.2)
    shading.show_xray_wireframe = False
    assert hiding.seen_through(shading) == 0.0
    shading.type = "MATERIAL"
    assert hiding.seen_through(shading) == 0.0, "there Blender has no X-ray"


def test_where_blender_draws_no_depth(empty):
    space = viewport()["space_data"]
    found = {}
    for engine in ("BLENDER_WORKBENCH", "FROG"):
        empty.render.engine = engine
        for kind in ("SOLID", "RENDERED"):
            for overlays in (True, False):
                space.shading.type, space.overlay.show_overlays = kind, overlays
                found[engine, kind, overlays] = hiding.is_drawn_without_depth(empty, space)
    space.overlay.show_overlays = True
    assert [key for key, lacks in found.items() if lacks] == [("FROG", "RENDERED", False)]
