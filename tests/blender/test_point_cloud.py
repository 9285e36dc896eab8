"""The point cloud's own drawing: soft coloured blobs in Cycles, in the place where the engine puts them."""

import bpy
import mathutils
import numpy as np
import pytest
from support.builders import blobs
from support.small_scenes import lens, looking_at
from support.users_scene import eye_in

from frog_blender import point_cloud
from frog_blender.cameras import apply_lens, pose_of
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.render import draw
from frog_blender.nodes.node_builder import Builder, new_geometry_group
from frog_blender.render.collect_instances import visible_captures


def three_gaussians() -> GaussianArrays:
    """Red, long and tilted; green, upright; blue, round and half transparent."""
    turns = [(np.cos(0.4), 0.0, np.sin(0.4), 0.0), (1, 0, 0, 0), (1, 0, 0, 0)]
    scales = [(0.6, 0.1, 0.1), (0.1, 0.1, 0.4), (0.3, 0.3, 0.3)]
    places = [(0.0, 0.0, 0.0), (1.5, 0.0, 0.0), (-1.5, 0.0, 0.0)]
    return blobs(places, scales, colors=np.eye(3), opacities=[0.9, 0.9, 0.5], turns=turns)


def test_cycles_shows_what_the_engine_draws(empty, rendered):
    scene = empty
    camera = looking_at("eye", (0.0, -6.0, 0.0), (96, 54), lens(100.0, 100.0, 48.0, 27.0))
    eye = eye_in(scene)
    apply_lens(eye.data, camera)
    eye.matrix_world = mathutils.Matrix(pose_of(camera).tolist())
    scene.collection.objects.link(point_cloud.create("blobs", three_gaussians()))
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.transparent_max_bounces = "CPU", 64, 32
    scene.cycles.use_denoising = False
    scene.view_settings.view_transform = "Standard"
    pixels = rendered(scene, resolution_x=96, resolution_y=54, resolution_percentage=100, dither_intensity=0.0)
    drawing = draw(three_gaussians(), camera)
    # Cycles blends in linear light and the engine in display space: compare where the colours do not mix, by shape.
    for channel, name in enumerate(["red", "green", "blue"]):
        expected = drawing.rgb[..., channel]
        found = (pixels[..., channel] / 255.0) ** 2.2
        correlation = np.corrcoef(expected.ravel(), found.ravel())[0, 1]
        # Blender's own splats (5.3) fall off a little differently.
        assert correlation > (0.97 if point_cloud.draws_splats() else 0.98), f"{name}: {correlation:.3f}"
    assert drawing.alpha.max() > 0.85 and pixels[..., :3].max() > 200


def test_points_are_limited_in_viewports_alone(empty):
    gaussians = three_gaussians()
    gaussians.scales[0] = 1000.0
    obj = point_cloud.create("blobs", gaussians)
    empty.collection.objects.link(obj)
    if obj.type == "POINTCLOUD":
        pytest.skip("Blender's own splats have no radius")
    means = np.asarray(gaussians.means)
    box = np.linalg.norm(np.subtract(*np.quantile(means, (0.99, 0.01), axis=0)))
    limit = box / (2 * np.sqrt(3))

    geometry = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    radii = np.empty(len(geometry.pointcloud.points), np.float32)
    geometry.pointcloud.attributes["radius"].data.foreach_get("value", radii)
    assert radii.max() == pytest.approx(limit, rel=1e-3)


def test_frog_draws_a_capture_once_whatever_a_user_instances_on_it(empty, capture, rendered):
    before = rendered(empty)
    build = Builder(new_geometry_group("Balls"))
    balls = {"Points": build.node("NodeGroupInput").outputs[0], "Instance": build.out("GeometryNodeMeshIcoSphere")}
    build.node("NodeGroupOutput", {0: build.out("GeometryNodeInstanceOnPoints", balls)})
    capture.modifiers.new("Balls", "NODES").node_group = build.tree
    graph = bpy.context.evaluated_depsgraph_get()
    assert sum(instance.is_instance for instance in graph.object_instances) >= point_cloud.count(capture)
    assert [obj for obj, *_ in visible_captures(graph)] == [capture]
    np.testing.assert_array_equal(rendered(empty), before)


def test_points_that_are_not_finite_move_nothing():
    points = np.array([(np.inf, 0, 0), (1, 2, 3), (0, np.nan, 0)], np.float32)
    assert [point_cloud.middle_of(some)[0].tolist() for some in (points, points[:1])] == [[1, 2, 3], [0, 0, 0]]


def test_the_bounds_are_those_of_what_is_seen(empty):
    """Home and Dimensions show the room, not the few Gaussians that training left far outside it."""
    random = np.random.default_rng(0)
    means = random.uniform(-2.0, 2.0, (2000, 3)).astype(np.float32)
    means[:3] = [(8300.0, 0.0, 0.0), (0.0, -60.0, 0.0), (0.0, 0.0, 25.0)]
    obj = point_cloud.create("room", blobs(means, 0.01, opacities=1.0))
    empty.collection.objects.link(obj)
    if obj.type == "POINTCLOUD":
        pytest.skip("Blender's own splats are all drawn")

    geometry = obj.evaluated_get(bpy.context.evaluated_depsgraph_get()).evaluated_geometry()
    assert len(geometry.pointcloud.points) == 1997 and max(obj.dimensions) == pytest.approx(4.0, abs=0.1)
    assert point_cloud.count(obj) == 2000, "what FRoG draws is whole"
