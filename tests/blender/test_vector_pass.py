"""The Vector pass: what Cycles says of a card, FROG says of a Gaussian in its place."""

import bpy
import numpy as np
import pytest
from support.builders import blobs
from support.exr import pass_of, render_channels
from support.small_scenes import animate, rig_of_three
from support.users_scene import eye_in

from frog_blender.cameras import engine_camera
from frog_blender.engine.native.options import RasterizeOptions
from frog_blender.engine.playback.passes import vector_pass
from frog_blender.render.collect_instances import gather
from frog_blender.render.compositing.compositor import own_tree

SIZE = (64, 48)


def moving_eye(scene):
    """A camera that slides to the right and upwards, and looks along +y at what lies 5 away."""
    eye = eye_in(scene, turn=(np.pi / 2, 0, 0))
    animate(eye, "location", (1, (0.0, -5.0, 0.0)), (2, (0.1, -5.0, 0.05)), (3, (0.4, -5.0, 0.2)))
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = *SIZE, 100
    scene.frame_set(2)


def frog_vectors(scene, path):
    """(H, W, 4) of a render with FROG."""
    scene.render.engine = "FROG"
    bpy.context.view_layer.use_pass_vector = True
    return pass_of(render_channels(scene, path), "Vector", "XYZW")


def cycles_vectors(scene, path):
    """(4,) at the middle of a still card 5 before the moving camera."""
    bpy.ops.mesh.primitive_plane_add(size=30, rotation=(np.pi / 2, 0, 0))
    scene.render.engine = "CYCLES"
    scene.cycles.device, scene.cycles.samples, scene.cycles.use_denoising = "CPU", 1, False
    bpy.context.view_layer.use_pass_vector = True
    tree, output = own_tree(scene)
    layers = tree.nodes.new("CompositorNodeRLayers")
    tree.links.new(layers.outputs["Vector"], output.inputs["Image"])
    settings = scene.render.image_settings
    settings.file_format, settings.color_depth, settings.color_mode = "OPEN_EXR", "32", "RGBA"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    pixels = np.array(bpy.data.images.load(str(path)).pixels[:]).reshape(SIZE[1], SIZE[0], 4)
    return pixels[SIZE[1] // 2, SIZE[0] // 2]


def test_it_is_what_cycles_says(empty, tmp_path):
    moving_eye(empty)
    wide = blobs([(0, 0, 0)], (5, 1e-3, 5), opacities=0.99)

    def snapshot_at(offset):
        empty.frame_set(2 + offset)
        return wide, engine_camera(empty.camera, empty.camera.matrix_world, empty.render, *SIZE)

    found = vector_pass(snapshot_at, RasterizeOptions())[SIZE[1] // 2, SIZE[0] // 2]
    expected = cycles_vectors(empty, tmp_path / "card.exr")
    assert expected[0] > 1 and expected[2] > 4
    count = 4 if expected[3] != 1.0 else 3  # before 5.0 the compositor's images have no room for the fourth
    np.testing.assert_allclose(found[:count], expected[:count], rtol=2e-3)


def test_a_still_scene_before_a_moving_camera(empty, capture, tmp_path):
    """5 away and 50 mm of 36 mm over 64 pixels: 0.1 to the right is 1.78 pixels to the left."""
    capture.frog.use_remap, capture.frog.shown_frame = True, 0.0
    moving_eye(empty)
    found = frog_vectors(empty, tmp_path / "vectors.exr")
    gaussians = gather(bpy.context.evaluated_depsgraph_get())[0]
    depths = 5.0 + gaussians.means[:, 1]
    unit = 50.0 / 36.0 * SIZE[0]
    seen = np.abs(found).sum(2) > 0.05
    assert seen.mean() > 0.1
    for columns, step in ((slice(0, 2), 0.1), (slice(2, 4), 0.3)):
        right, up = found[seen][:, columns].T
        assert unit / depths.max() * step < np.median(right) < unit / depths.min() * step
        assert np.median(up / right) == pytest.approx(0.5, abs=0.02)


def test_what_cannot_be_seen_a_frame_away_goes_on_as_it_came(empty):
    """It is not where its way leads then (see playback.deformation)."""
    camera = rig_of_three()[0]
    ahead = camera.rotation.T @ (np.array([0, 0, 4.0]) - camera.world_to_camera[:3, 3])
    aside = camera.rotation.T @ np.array([0.05, 0, 0])

    def snapshot(offset, opacity):
        return blobs([ahead + offset * aside], 0.5, opacities=opacity), camera

    def middle(before, after):
        snapshots = {-1: before, 1: after, 0: snapshot(0, 0.9)}
        pixels, _ = camera.project(np.float64([ahead]))
        column, row = pixels[0].astype(int)
        return vector_pass(snapshots.__getitem__, RasterizeOptions())[row, column]

    seen = middle(snapshot(-1, 0.9), snapshot(1, 0.9))
    assert seen[0] < -0.1 and seen[2] < -0.1 and abs(seen[0] - seen[2]) < 0.1
    for before, after in ((snapshot(40, 0.0), snapshot(1, 0.9)), (snapshot(-1, 0.9), snapshot(40, 0.0))):
        np.testing.assert_allclose(middle(before, after), seen, atol=0.1)
    np.testing.assert_allclose(middle(snapshot(40, 0.0), snapshot(40, 0.0)), 0, atol=1e-3)
    assert not vector_pass(lambda _: (None, camera), RasterizeOptions()).any(), "without captures nothing moves"
