"""Make Proxy Mesh: the meshes on the timeline, in other programs' files, and the shadows of objects on splats."""

import bpy
import numpy as np
import pytest
from support.blender_windows import in_window
from support.builders import refuses, result_of
from support.composed_scene import compose, compose_anew
from support.small_scenes import cropped, imported, rig_of_three, write_scene
from support.still_scenes import write_still
from support.users_scene import eye_in

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.srgb import to_linear
from frog_blender.engine.surfaces.proxy import make_proxy
from frog_blender.lighting.proxy import proxies_of
from frog_blender.operators.make_proxy import FROG_OT_make_proxy
from frog_blender.render.compositing import compositor
from frog_blender.scene_import.capture_objects import active_capture

RESOLUTION = 12


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path / "scene.frog", rig_of_three(), count=200, frame_count=4)


@pytest.fixture
def floor(empty, tmp_path):
    """A square of flat splats in the plane z = 0."""
    steps = np.linspace(-1.5, 1.5, 21)
    x, y = (axis.ravel() for axis in np.meshgrid(steps, steps))
    means = np.stack([x, y, 0 * x], axis=1)
    still = write_still(tmp_path / "floor.frog", means, (0.15, 0.15, 0.004), np.full((len(means), 3), 0.8))
    return imported(still)


def make(**settings):
    assert bpy.ops.frog.make_proxy(**{"resolution": RESOLUTION} | settings) == {"FINISHED"}
    return proxies_of(active_capture(bpy.context))


def expected(path, frames):
    """What the engine makes of a scene's frames."""
    player = ScenePlayer.load(path)
    return result_of(make_proxy([lambda f=f: player.at_frame(f) for f in frames], player.header.cameras, RESOLUTION))[0]


def vertices_of(obj):
    """(V, 3) of an object as it is evaluated now, in its own space."""
    mesh = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).to_mesh()
    values = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", values)
    return values.reshape(-1, 3)


def sorted_rows(points):
    return points[np.lexsort(points.T.round(5))]


def count_of_data():
    return len(bpy.data.objects), len(bpy.data.meshes), len(bpy.data.collections)


def test_each_frame_shows_the_engines_mesh_of_it(empty, capture, path):
    empty.frame_set(3)
    made = make()
    assert empty.frame_current == 3
    engine = expected(path, range(4))
    assert len(engine.moving) == 4 and len({len(mesh.vertices) for mesh in engine.moving}) > 1
    moving = made[-1]
    for frame, index in ((1, 0), (2, 1), (4, 3), (9, 3), (-3, 0)):
        empty.frame_set(frame)
        np.testing.assert_allclose(
            sorted_rows(vertices_of(moving)), sorted_rows(engine.moving[index].vertices), atol=1e-5
        )
    still = [obj for obj in made if obj != moving]
    assert len(still) == (1 if len(engine.still.quads) else 0)


def test_it_moves_with_the_capture_and_replaces_the_earlier_one(empty, capture):
    (*_, moving) = make()
    capture.parent.location.x += 2.0
    bpy.context.view_layer.update()
    np.testing.assert_allclose(np.array(moving.matrix_world), np.array(capture.matrix_world), atol=1e-6)
    before = count_of_data()
    (*_, again) = make()
    assert count_of_data() == before
    np.testing.assert_allclose(np.array(again.matrix_world), np.array(capture.matrix_world), atol=1e-6)


def test_one_frame_is_one_mesh(empty, capture, path):
    empty.frame_set(3)
    (still,) = make(frames="CURRENT", use="PLAIN")
    engine = expected(path, [2])
    np.testing.assert_allclose(vertices_of(still), engine.still.vertices, atol=1e-5)
    assert still.visible_diffuse and still.visible_shadow and not still.is_shadow_catcher


def test_uses_differ_in_what_other_engines_show(empty, capture):
    for obj in make(use="SHADOWS"):
        assert obj.is_shadow_catcher and not obj.visible_diffuse and not obj.is_holdout
        assert obj.visible_shadow == ("Moving" in obj.name)
        meshes = [obj.data, *(mesh for mesh in bpy.data.meshes if mesh.name.startswith(f"{obj.name}.0"))]
        assert any(mesh.materials for mesh in meshes)
        targets = {node.target for node in bpy.data.materials["FRoG Proxy"].node_tree.nodes if hasattr(node, "target")}
        assert targets == {"CYCLES", "EEVEE"}, "EEVEE has no shadow catcher, and sees through the mesh"
    for obj in make(use="HOLDOUT"):
        assert obj.is_holdout and not obj.is_shadow_catcher and not obj.visible_shadow


def test_a_crop_and_other_edits_count(empty, floor):
    (still,) = make()
    whole = np.ptp(vertices_of(still)[:, 0])
    assert whole > 3.0
    crop = cropped(floor)
    crop.location.x, crop.scale.x = 0.0, 0.5 / crop.empty_display_size
    bpy.context.view_layer.update()
    (still,) = make()
    assert np.ptp(vertices_of(still)[:, 0]) < 0.7 * whole


def test_it_never_hides_the_splats_that_it_is_made_of(empty, floor, rendered):
    empty.render.resolution_x, empty.render.resolution_y, empty.frog.hold_out = 48, 32, True
    before = rendered(empty)
    assert before[..., :3].max() > 150
    for use in ("SHADOWS", "HOLDOUT", "PLAIN"):
        make(use=use)
        np.testing.assert_array_equal(rendered(empty), before)


def test_escape_changes_nothing(empty, capture):
    before = count_of_data()
    with in_window(FROG_OT_make_proxy) as window:
        assert bpy.ops.frog.make_proxy(resolution=RESOLUTION) == {"RUNNING_MODAL"}
        assert window.send(times=6) == {"PASS_THROUGH"} and window.send("ESC", "PRESS") == {"CANCELLED"}
        assert window.said[-1][0] == "INFO" and window.started[-1][1].gi_frame is None
        assert count_of_data() == before and empty.frame_current == 1


def test_a_capture_that_nobody_sees_is_told(empty, capture):
    capture.frog_edits.grade.opacity = 0.0
    refuses("no surface", make)


def cube_and_sun(scene):
    """A cube above the floor, and the sun that shines on it from the side, at 45 degrees along x."""
    bpy.ops.mesh.primitive_cube_add(size=0.4, location=(0, 0, 0.5))
    cube = bpy.context.object
    sun = bpy.data.objects.new("sun", bpy.data.lights.new("sun", "SUN"))
    sun.data.angle, sun.data.energy, sun.rotation_euler = 0.0, 3.0, (0, -np.pi / 4, 0)
    scene.collection.objects.link(sun)
    eye_in(scene, (0, 0, 3), lens=36.0, sensor_width=36.0)
    scene.render.resolution_x = scene.render.resolution_y = 64
    scene.render.resolution_percentage = 100
    return cube


def shadow_on_floor():
    """Where the cube's shadow falls and the cube hides nothing, and where it falls at all: (64, 64) bool each."""
    pixels = (np.arange(64) + 0.5) / 64 - 0.5
    x, y = np.meshgrid(3 * pixels, -3 * pixels)
    shade = (x > 0.1) & (x < 0.9) & (np.abs(y) < 0.2)
    hidden = (np.abs(x) < 0.28) & (np.abs(y) < 0.28)
    return shade & ~hidden, hidden


def test_a_cubes_shadow_darkens_the_splats_below_it(empty, floor, rendered):
    cube = cube_and_sun(empty)
    bpy.context.view_layer.objects.active = floor.parent
    make(resolution=16)
    compose(empty)
    empty.cycles.samples = 2
    with_cube = to_linear(rendered(empty)[..., 0] / 255)
    cube.hide_render = True
    alone = to_linear(rendered(empty)[..., 0] / 255)
    shade, hidden = shadow_on_floor()
    filmed = (alone > 0.5 * alone.max()) & ~hidden
    assert filmed.mean() > 0.6
    dark = (with_cube < 0.75 * alone) & filmed  # the world, which is the capture's light, reaches the shade as well
    assert (dark & shade).sum() / (dark | shade).sum() > 0.8
    rest = filmed & ~dark & ~shade
    assert np.median(np.abs(with_cube - alone)[rest]) < 0.01


def shadow_nodes(scene):
    return sum(node.label == "FRoG Shadows" for node in compositor.tree_of(scene).nodes)


def test_shadows_follow_the_engine_and_the_proxy_and_are_multiplied_once(empty, floor):
    empty.render.engine = "BLENDER_WORKBENCH"
    compose(empty)
    empty.render.engine = "BLENDER_WORKBENCH"
    (mesh,) = make()
    bpy.context.view_layer.update()
    assert shadow_nodes(empty) == 0
    mesh.is_shadow_catcher = False
    empty.render.engine = "CYCLES"
    bpy.context.view_layer.update()
    assert shadow_nodes(empty) == 0
    mesh.is_shadow_catcher = True
    bpy.context.view_layer.update()
    assert shadow_nodes(empty) == 1
    assert all(layer.cycles.use_pass_shadow_catcher for layer in empty.view_layers)
    make()
    for composing in (compose, compose_anew):
        composing(empty)
        assert shadow_nodes(empty) == 1
