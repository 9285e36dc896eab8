"""Splats by the graphics card: the FROG engine's image, behind what the scene has before them; points give way to them.

Drawing is tested where Blender has graphics without a window: 5.2 and later, with OpenGL, Vulkan or Metal.
"""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from support.blender_windows import viewport
from support.builders import scene_file
from support.small_scenes import lens, looking_at, rig_of_three, write_scene

from frog_blender import point_cloud, reported_once
from frog_blender.cameras import pose_of, view_camera
from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.evaluation.metrics import psnr
from frog_blender.engine.gaussians import joined
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.playback.transform import transform
from frog_blender.engine.rasterizer.mesh_depth import mesh_depth
from frog_blender.render.collect_instances import visible_captures
from frog_blender.scene_import.capture_objects import active_capture
from frog_blender.timeline import playback
from frog_blender.timeline.playback_cache import SceneTime
from frog_blender.viewport import clouds, drawing
from frog_blender.viewport.card import Canvas, GraphicsCard, Layer
from frog_blender.viewport.clouds import Clouds, starts_of, texels_of
from frog_blender.viewport.order import OrderRequest, Part
from frog_blender.viewport.projection import view_of

NEAR, FAR = 0.05, 200.0
LEAST = 38.0  # dB


@pytest.fixture(scope="module")
def card():
    gpu = pytest.importorskip("gpu")
    if not hasattr(gpu, "init"):
        pytest.skip("before Blender 5.2 there are no graphics without a window")
    try:
        gpu.init()
    except Exception as error:
        pytest.skip(f"no graphics here: {error}")
    return GraphicsCard()


def matrices(camera: Camera) -> tuple[np.ndarray, np.ndarray]:
    """The view and window matrices of a viewport that looks through a camera."""
    k, window = camera.intrinsics, np.zeros((4, 4))
    window[0, 0], window[1, 1] = 2 * k[0, 0] / camera.width, 2 * k[1, 1] / camera.height
    window[0, 2], window[1, 2] = 1 - 2 * k[0, 2] / camera.width, 2 * k[1, 2] / camera.height - 1
    window[2, 2], window[2, 3], window[3, 2] = -(FAR + NEAR) / (FAR - NEAR), -2 * FAR * NEAR / (FAR - NEAR), -1
    return np.linalg.inv(pose_of(camera)), window


def ring(count: int, middle: np.ndarray, distance: float) -> list[Camera]:
    """Cameras around a point that look at it."""
    cameras, moved = [], np.eye(4)
    moved[:3, 3] = -middle
    for k, angle in enumerate(2 * np.pi * np.arange(count) / count):
        eye = np.array([np.sin(angle), -np.cos(angle), 0.4 * np.cos(3 * angle)])
        eye *= distance / np.linalg.norm(eye)
        camera = looking_at(f"eye {k}", tuple(eye), (160, 110), lens(150.0, 140.0, 90.0, 50.0))
        cameras.append(replace(camera, world_to_camera=camera.world_to_camera @ moved))
    return cameras


def drawn(card, captures, camera, depth=None, through=0.0):
    """(H, W, 4) of several captures, each a player, a time and a matrix, by the graphics card, rows from the top."""
    view_matrix, window_matrix = matrices(camera)
    eye = view_camera(view_matrix, window_matrix, camera.width, camera.height)
    starts = starts_of([player.count for player, *_ in captures])
    parts, layers, kept = [], [], Clouds()
    for (player, time, matrix), start in zip(captures, starts, strict=True):
        view = view_of(eye, matrix, view_matrix, window_matrix)
        parts.append(Part(np.ascontiguousarray(player.at(time).means), view.plane, start))
        textures = kept.of(player, card).at(SceneTime(player, time))
        layers.append(Layer(textures, view, player.count, start, player.header.low_pass))
    numbers = OrderRequest("test", 0, tuple(parts)).sort().numbers
    canvas, hidden = Canvas(view.size), None
    if depth is not None:
        a, b, c, d = view.clip
        with np.errstate(invalid="ignore"):
            window_depth = np.where(np.isinf(depth), 1.0, 0.5 + 0.5 * (a * depth + b) / (c * depth + d))
        hidden = card.depth(window_depth[::-1])
    card.draw(canvas, layers, card.texture(texels_of(numbers, 1)), len(numbers), hidden, through)
    return np.array(canvas.textures[0].read(), np.float32).reshape(camera.height, camera.width, 4)[::-1]


def assert_like(pixels: np.ndarray, rgb: np.ndarray, alpha: np.ndarray) -> None:
    assert psnr(pixels[..., :3], rgb) >= LEAST and psnr(pixels[..., 3], alpha) >= LEAST


SCENES = {
    "few large": lambda folder: ScenePlayer.load(write_scene(folder / "a.frog", rig_of_three(), count=60, sh_count=16)),
    "many, some moving": lambda _folder: ScenePlayer(scene_file(4000, seed=1, sh_count=4, moving=900)),
    "colours that change": lambda _folder: ScenePlayer(scene_file(700, seed=2, sh_count=9, deformed_sh=4)),
}


TURNED = np.linalg.inv(pose_of(ring(3, np.array([0.3, 1.0, -2.0]), 1.0)[1])) @ np.diag([1.7, 1.7, 1.7, 1.0])


def around(gaussians) -> tuple[np.ndarray, float]:
    """The middle of Gaussians, and how far they lie from it."""
    middle = gaussians.means.mean(axis=0).astype(np.float64)
    return middle, float(np.linalg.norm(gaussians.means - middle, axis=1).mean())


@pytest.mark.parametrize(("name", "matrix"), [*((name, np.eye(4)) for name in SCENES), ("few large", TURNED)])
def test_views_are_the_engine_s(card, tmp_path, name, matrix):
    player = SCENES[name](tmp_path)
    middle, spread = around(transform(player.at(0.0), matrix))
    for k, camera in enumerate(ring(6, middle, 2.5 * spread)):
        pixels = drawn(card, [(player, k / 5, matrix)], camera)
        expected = draw(transform(player.at(k / 5), matrix), camera)
        assert expected.alpha.mean() > 0.02, "there is something to see"
        assert_like(pixels, expected.rgb, expected.alpha)


def test_captures_that_stand_in_each_other_are_drawn_in_one_order(card, tmp_path):
    """The last one twice: an object that was duplicated."""
    few = SCENES["few large"](tmp_path)
    options = {"count": 50, "sh_count": 4, "seed": 7, "low_pass": 0.8}
    other = ScenePlayer.load(write_scene(tmp_path / "b.frog", rig_of_three(), **options))
    turned = np.linalg.inv(pose_of(ring(3, np.zeros(3), 0.2)[1]))
    turned[:3, :3] *= 0.8
    captures = [(few, 0.3, np.eye(4)), (other, 0.6, turned), (other, 0.1, np.eye(4))]
    parts = [transform(player.at(time), matrix) for player, time, matrix in captures]
    together = joined(parts)
    (middle, spread), apart = around(together), []
    for camera in ring(6, middle, 2.5 * spread):
        expected = draw(together, camera)
        assert_like(drawn(card, captures, camera), expected.rgb, expected.alpha)
        one_by_one = np.zeros_like(expected.rgb)
        for image in (draw(part, camera) for part in parts):
            one_by_one = image.rgb + one_by_one * (1 - image.alpha[..., None])
        apart.append(psnr(one_by_one, expected.rgb))
    assert max(apart) < LEAST, "one after the other they are another image"


def test_a_capture_that_is_gone_leaves_nothing_in_the_textures_of_all(card, tmp_path):
    """They are used again: for fewer splats, in other rows."""
    few, many = SCENES["few large"](tmp_path), SCENES["many, some moving"](tmp_path)
    camera = ring(3, around(few.at(0.0))[0], 4.0)[0]
    alone = drawn(card, [(few, 0.0, np.eye(4))], camera)
    drawn(card, [(many, 0.0, np.eye(4)), (few, 0.0, np.eye(4))], camera)
    np.testing.assert_array_equal(drawn(card, [(few, 0.0, np.eye(4))], camera), alone)


def test_a_mesh_hides_what_is_behind_it_to_the_pixel(card, tmp_path):
    player = SCENES["few large"](tmp_path)
    middle, spread = around(player.at(0.0))
    card_of_four, triangles = np.array([[-0.6, -0.5], [0.7, -0.4], [0.6, 0.8], [-0.5, 0.4]]), [[0, 1, 2], [0, 2, 3]]
    for camera in ring(5, middle, 2.5 * spread):
        right, down, forward = camera.rotation
        corners = middle + spread * (card_of_four @ np.stack([right, down]) - 0.2 * forward)
        depth = mesh_depth(corners, np.array(triangles), camera)
        pixels = drawn(card, [(player, 0.0, np.eye(4))], camera, depth)
        expected, free = draw(player.at(0.0), camera, depth_limit=depth), draw(player.at(0.0), camera)
        assert np.abs(free.alpha - expected.alpha).max() > 0.4, "the mesh hides something"
        assert psnr(pixels[..., :3], expected.rgb) >= LEAST
        far_off = np.abs(pixels[..., 3] - expected.alpha) > 0.1
        assert far_off.mean() < 0.002


@pytest.mark.parametrize("through", [0.3, 1.0])
def test_in_x_ray_a_share_of_what_is_hidden_is_seen(card, tmp_path, through):
    """Of all of it together, below what lies before."""
    player = SCENES["few large"](tmp_path)
    camera = ring(3, around(player.at(0.0))[0], 5.0)[1]
    depth = np.full((camera.height, camera.width), 5.0)
    captures = [(player, 0.0, np.eye(4))]
    pixels = drawn(card, captures, camera, depth, through)
    gaussians = player.at(0.0)
    before = draw(gaussians, camera, depth_limit=depth.astype(np.float32))
    whole = draw(gaussians, camera)
    hidden = whole.rgb - before.rgb, whole.alpha - before.alpha  # what shows of it through what lies before
    assert hidden[1].max() > 0.2 and before.alpha.max() > 0.2
    assert_like(pixels, before.rgb + through * hidden[0], before.alpha + through * hidden[1])


def test_points_give_way_in_viewports_and_stay_in_renders(empty, capture):
    bpy.context.view_layer.update()

    def seen():
        depsgraph = bpy.context.evaluated_depsgraph_get()
        parts = [instance.object for instance in depsgraph.object_instances if instance.object.original == capture]
        return sum(len(part.data.points if part.type == "POINTCLOUD" else part.data.vertices) for part in parts)

    before, modifiers = seen(), len(capture.modifiers)
    assert before and point_cloud.is_drawn_in("viewport", capture)
    point_cloud.draw_in("viewport", capture, False)
    bpy.context.view_layer.update()
    assert not point_cloud.is_drawn_in("viewport", capture) and point_cloud.is_drawn_in("render", capture)
    assert seen() == 0, "neither points nor loose vertices"
    found = visible_captures(bpy.context.evaluated_depsgraph_get())
    assert [obj for obj, *_ in found] == [capture], "it is drawn all the same"
    point_cloud.draw_in("render", capture, False)
    point_cloud.draw_in("viewport", capture, True)
    bpy.context.view_layer.update()
    assert point_cloud.is_drawn_in("viewport", capture) and not point_cloud.is_drawn_in("render", capture)
    assert seen() == before
    point_cloud.draw_in("render", capture, True)
    assert point_cloud.is_drawn_in("render", capture) and len(capture.modifiers) == modifiers


def test_without_a_window_nothing_is_drawn(empty, capture):
    for choice in ("AUTO", "CARD", "POINTS"):
        empty.frog.viewport_drawing = choice
        assert not drawing.is_wanted(empty) and point_cloud.is_drawn_in("viewport", active_capture(bpy.context))
    assert drawing.state().handler is None


def test_too_many_splats_are_points_and_the_panel_says_so(empty, static_rig, monkeypatch, capsys):
    for _ in range(3):
        assert bpy.ops.import_scene.frog(filepath=str(static_rig)) == {"FINISHED"}
    captures, splats = playback.captures_in(empty), drawing.state()
    monkeypatch.setattr(drawing, "is_possible", lambda: not splats.problem)
    monkeypatch.setattr(drawing, "draw_in", lambda _context: starts_of([60, 60, 60]))
    empty.frog.viewport_drawing = "CARD"
    drawing.apply()
    assert not any(point_cloud.is_drawn_in("viewport", obj) for obj in captures)
    monkeypatch.setattr(clouds, "MOST", 2 * clouds.ROW)
    reported_once.forget()
    there = viewport()
    there["space_data"].shading.type = "SOLID"
    with bpy.context.temp_override(**there):
        drawing._draw()
        drawing._draw()
    drawing.apply()  # which a timer does
    assert all(point_cloud.is_drawn_in("viewport", obj) for obj in captures)
    assert "180 splats in 3 captures" in drawing.problem(empty)
    assert capsys.readouterr().err.count("Points are shown") == 1
    empty.frog.viewport_drawing = "CARD"  # chosen again
    assert not drawing.problem(empty) and not any(point_cloud.is_drawn_in("viewport", obj) for obj in captures)
