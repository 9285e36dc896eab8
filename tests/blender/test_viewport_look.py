"""Colors of splats under a scene's color management: as Blender saves an image of them."""

from itertools import product
from types import SimpleNamespace

import bpy
import numpy as np
import pytest

from frog_blender.engine.srgb import to_linear
from frog_blender.viewport.look import SIDE, Looks, is_plain, table_of

CARD = SimpleNamespace(texture=lambda texels: texels)


def saved(scene: bpy.types.Scene, displayed: np.ndarray, folder) -> np.ndarray:
    """(N, 3) what a scene's own settings make of displayed colors."""
    image = bpy.data.images.new("colors", len(displayed), 1, float_buffer=True)
    linear = np.ones((len(displayed), 4), np.float32)
    linear[:, :3] = to_linear(displayed)
    image.pixels.foreach_set(linear.reshape(-1))
    scene.render.image_settings.file_format, scene.render.image_settings.color_depth = "PNG", "16"
    scene.render.dither_intensity = 0.0
    image.save_render(str(folder / "saved.png"), scene=scene)
    loaded = bpy.data.images.load(str(folder / "saved.png"))
    loaded.colorspace_settings.is_data = True
    return np.array(loaded.pixels[:], np.float32).reshape(-1, 4)[:, :3]


def looked_up(table: np.ndarray, colors: np.ndarray) -> np.ndarray:
    """What the shader does."""
    grid = table[:, :3].reshape(SIDE, SIDE, SIDE, 3)
    low = np.minimum((colors * (SIDE - 1)).astype(int), SIDE - 2)
    part, shown = colors * (SIDE - 1) - low, np.zeros_like(colors)
    for corner in product((0, 1), repeat=3):
        weight = np.where(corner, part, 1 - part).prod(axis=1, keepdims=True)
        shown += weight * grid[tuple((low + corner).T[::-1])]
    return shown


LOOKS = {
    "AgX, brighter": {"view_transform": "AgX", "exposure": 1.3, "gamma": 1.2},
    "a look": {"view_transform": "AgX", "look": "AgX - High Contrast"},
    "curves": {"view_transform": "Standard", "use_curve_mapping": True},
}


@pytest.mark.parametrize("name", LOOKS)
def test_a_table_has_what_blender_saves(empty, tmp_path, name):
    settings = empty.view_settings
    for setting, value in LOOKS[name].items():
        setattr(settings, setting, value)
    if settings.use_curve_mapping:
        settings.curve_mapping.curves[3].points.new(0.4, 0.6)
        settings.curve_mapping.update()
    scenes, images = len(bpy.data.scenes), len(bpy.data.images)
    table = table_of(empty)
    assert table.shape == (SIDE**3, 4)
    assert (len(bpy.data.scenes), len(bpy.data.images)) == (scenes, images), "nothing is left behind"
    colors = np.random.default_rng(3).uniform(0, 1, (400, 3)).astype(np.float32)
    error = np.abs(looked_up(table, colors) - saved(empty, colors, tmp_path))
    assert np.sqrt((error**2).mean()) < 0.5 / 255 and error.max() < 4 / 255
    assert np.abs(saved(empty, colors, tmp_path) - colors).max() > 8 / 255, "the settings do something"


def test_a_table_is_made_once_while_nothing_is_drawn(empty):
    asked = []
    looks = Looks(lambda: asked.append(1))
    empty.view_settings.view_transform = "Standard"
    empty.view_settings.exposure = 1.0
    assert is_plain(empty) and looks.of(empty, CARD).factor == 2.0 and not asked
    empty.view_settings.view_transform = "AgX"
    assert not is_plain(empty) and looks.of(empty, CARD).table is None and asked == [1]
    looks.make()
    table = looks.of(empty, CARD).table
    assert table is not None and looks.of(empty, CARD).table is table and len(asked) == 1
    empty.view_settings.exposure = 0.0
    assert looks.of(empty, CARD).table is table and len(asked) == 2, "the last one, until there is another"
    looks.make()
    after = looks.of(empty, CARD).table
    assert after is not table and len(asked) == 2
    assert Looks(lambda: None).of(bpy.data.scenes.new("other"), CARD).table is None
