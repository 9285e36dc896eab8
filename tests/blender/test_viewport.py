"""The rendered viewport, as far as it goes without a window: its cameras, and when it draws how many pixels."""

from functools import partial
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from support import blender_windows
from support.observed_players import observed
from support.small_scenes import expected_png, rig_of_three, world_of, write_scene

from frog_blender import reported_once
from frog_blender.cameras import view_camera
from frog_blender.engine.errors import FrogError
from frog_blender.render import viewport
from frog_blender.render.collect_instances import gather, visible_captures
from frog_blender.render.world import background_node
from frog_blender.timeline import edits, playback

SIZE = (120, 70)


def test_a_mirrored_view_is_refused(empty):
    view = np.diag([-1.0, 1.0, 1.0, 1.0])
    with pytest.raises(FrogError, match="mirrored"):
        view_camera(view, np.eye(4), *SIZE)


def region_of(camera, size=SIZE, perspective="PERSP"):
    """What Blender gives of a region that looks through a camera."""
    window = camera.calc_matrix_camera(bpy.context.evaluated_depsgraph_get(), x=size[0], y=size[1])
    view = camera.matrix_world.inverted()
    return SimpleNamespace(view_matrix=view, window_matrix=window, view_perspective=perspective)


def drawn_in(memory, region, size=SIZE, space=None):
    return viewport.image_of(memory, bpy.context.evaluated_depsgraph_get(), region, size, space)


def sharp_viewport():
    """Sharp at once, however slow the machine is."""
    return viewport.Viewport(moving_seconds=1e6)


def test_coarse_while_things_move_and_sharp_when_still(empty, capture):
    # 1,600 pixels fit the time, and a machine that stalls does not make a second pass.
    memory, size = viewport.Viewport(seconds_per_pixel=1e-5, still_after=1e6), (96, 64)
    drawn = partial(drawn_in, memory, region_of(empty.camera, size), size)
    first = drawn()
    assert first.step == 2 and first.pixels.shape == (32, 48, 4)
    assert drawn() is first  # not yet still
    memory.changed_at -= 2 * memory.still_after
    sharp = drawn()
    assert sharp.step == 1 and sharp.pixels.shape == (64, 96, 4)
    assert drawn() is sharp
    memory.seconds_per_pixel = 1.0
    empty.frame_set(2)
    assert drawn().step == viewport.COARSEST
    memory.seconds_per_pixel = 1e-12
    empty.frame_set(3)
    assert drawn().step == 1  # fast enough to be sharp at once
    assert memory.seconds_per_pixel > 1e-12


def srgb(pixels):
    """Written out once more, so that the images do not depend on the code that made them."""
    return np.where(pixels <= 0.0031308, 12.92 * pixels, 1.055 * np.maximum(pixels, 1e-9) ** (1 / 2.4) - 0.055)


def test_another_background_is_another_image(empty, capture):
    """Without orbiting: the world's colour, its strength, a transparent film."""
    drawn = partial(drawn_in, sharp_viewport(), region_of(empty.camera))
    captured = drawn()
    assert drawn() is captured
    empty.world = world_of("sky", (0.8, 0.1, 0.2))
    shader = background_node(empty.world)
    red = drawn()
    np.testing.assert_allclose(red.pixels[0, 0], (0.8, 0.1, 0.2, 1.0), atol=1e-3)
    shader.inputs["Strength"].default_value = 0.5
    np.testing.assert_allclose(drawn().pixels[0, 0], (0.4, 0.05, 0.1, 1.0), atol=1e-3)
    empty.render.film_transparent = True
    assert drawn().pixels[0, 0, 3] == 0.0
    empty.render.film_transparent, shader.inputs["Strength"].default_value = False, 1.0
    np.testing.assert_array_equal(drawn().pixels, red.pixels)


def test_it_follows_edits_and_shows_what_is_selected(empty, capture, monkeypatch):
    space = blender_windows.viewport()["space_data"]
    drawn = partial(drawn_in, sharp_viewport(), region_of(empty.camera), space=space)
    plain = drawn()
    assert drawn() is plain
    capture.frog_edits.grade.exposure = 1.0
    brighter = drawn()
    assert brighter.pixels[..., :3].mean() > plain.pixels[..., :3].mean() and drawn() is brighter
    bpy.ops.frog.add_crop(shape="SPHERE")
    cropped = drawn()
    capture.frog_edits.crops[0].object.location.x += 100.0
    assert np.ptp(drawn().pixels, axis=(0, 1)).max() < 1e-6 < np.ptp(cropped.pixels, axis=(0, 1)).max()
    capture.frog_edits.use = False
    np.testing.assert_array_equal(drawn().pixels, plain.pixels)
    bpy.ops.frog.select_gaussians(by="SIZE", size=0.3)
    with_window = SimpleNamespace(app=SimpleNamespace(background=False))
    monkeypatch.setattr(edits, "bpy", with_window)
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert not np.array_equal(drawn().pixels, plain.pixels)
    assert not np.array_equal(gather(depsgraph, space)[0].sh, gather(depsgraph)[0].sh), "a render shows no selection"
    capture.frog_edits.show_selection = False
    np.testing.assert_array_equal(drawn().pixels, plain.pixels)


def test_without_memory_it_is_a_sentence_in_the_header(empty, capture, capfd):
    def exhausted(player, time):
        raise MemoryError("60 Gaussians ran out of memory")

    reported_once.forget()
    header = []
    engine = SimpleNamespace(viewport=None, update_stats=lambda *texts: header.append(texts[1]))
    region = SimpleNamespace(width=SIZE[0], height=SIZE[1])
    context = SimpleNamespace(region=region, region_data=region_of(empty.camera), space_data=None)
    with observed(giving=exhausted):
        for _ in range(2):
            viewport.draw(engine, context, bpy.context.evaluated_depsgraph_get())
    assert len(header) == 2 and header[0] == header[1] and header[0].startswith("Out of memory (60 Gaussians")
    assert capfd.readouterr().err.count("Out of memory") == 1


def test_one_capture_that_is_refused_hides_no_other_and_mended_it_is_forgotten(empty, capture, tmp_path):
    bpy.ops.import_scene.frog(filepath=str(write_scene(tmp_path / "other.frog", rig_of_three(), seed=5)))
    first, second = playback.captures(empty.objects)
    memory, header = sharp_viewport(), []
    region = region_of(empty.camera)
    engine = SimpleNamespace(update_stats=lambda *texts: header.append(texts))

    def drawn():
        image = drawn_in(memory, region)
        viewport.show_problems(engine, memory.problems)
        return image.pixels

    both = drawn()
    assert header[-1] == ("", "")
    second.hide_set(True)
    alone = drawn()
    second.hide_set(False)
    for obj in (first, second):
        obj.scale = (1.0, 1.0, 2.0)
    assert np.ptp(drawn()[..., :3], axis=(0, 1)).max() < 1e-6, "nothing but background"
    assert "scaled unevenly" in header[-1][1] and "1 more" in header[-1][1]
    first.scale = (1.0, 1.0, 1.0)
    np.testing.assert_array_equal(drawn(), alone)
    assert second.name in header[-1][1] and "more" not in header[-1][1]
    second.scale = (1.0, 1.0, 1.0)
    np.testing.assert_array_equal(drawn(), both)
    assert header[-1] == ("", "")
    with pytest.raises(FrogError, match="scaled unevenly"):  # a render must not lie
        second.scale = (1.0, 1.0, 2.0)
        gather(bpy.context.evaluated_depsgraph_get())


def test_pixels_that_are_not_square_through_the_camera(empty, capture, static_rig):
    """As F12 has them, though Blender's matrices do not."""
    camera = empty.camera = bpy.data.objects["cam02"]
    assert camera.data.frog.focal_ratio < 0.96
    region, space = region_of(camera, (80, 64), "CAMERA"), blender_windows.viewport()["space_data"]
    empty.frame_set(4)
    pixels = drawn_in(sharp_viewport(), region, (80, 64), space).pixels[::-1]
    display = srgb(pixels)
    np.testing.assert_allclose(255 * display[..., :3], expected_png(static_rig, rig_of_three()[2], 3.0), atol=1.5)


def test_local_view(empty, capture):
    there = blender_windows.viewport()
    space = there["space_data"]
    bpy.ops.mesh.primitive_cube_add()
    assert [obj for obj, *_ in visible_captures(bpy.context.evaluated_depsgraph_get(), space)] == [capture]
    with bpy.context.temp_override(**there):
        bpy.ops.view3d.localview()
    depsgraph = bpy.context.evaluated_depsgraph_get()
    assert not visible_captures(depsgraph, space) and len(visible_captures(depsgraph)) == 1
    capture.hide_set(True)
    assert not visible_captures(bpy.context.evaluated_depsgraph_get())
