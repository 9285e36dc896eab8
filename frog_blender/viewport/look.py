"""What a scene's color management makes of splats' displayed colors, for the graphics card.

Exposure and gamma are arithmetic. View transforms, looks, curves and white balance are known to Blender alone, which
tells them by what it saves of an image of all colors: a table.
"""

import tempfile
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import bpy
import numpy as np
from mathutils import Color

from .. import reported_once
from ..color_spaces import into_working_space
from ..engine.srgb import to_linear
from .clouds import texels_of

SIDE = 33
"""Entries along each of red, green and blue. Between them AgX is straight to less than a step of 8 bits."""
_KEPT = 4  # tables: of the scenes and settings that one goes to and fro between
_PLAIN = "Standard"
_CURVES_OWN = ("black_level", "white_level", "clip_min_x", "clip_min_y", "clip_max_x", "clip_max_y", "use_clip", "tone")


@dataclass(frozen=True, eq=False)
class Look:
    """How displayed colors are shown.

    Attributes:
        factor: of linear colors, for exposure.
        exponent: of displayed colors, for gamma.
        table: a texture of ``SIDE`` ** 3 displayed colors by displayed colors, red the fastest; None for none. It has
            exposure and gamma in it.
    """

    factor: float = 1.0
    exponent: float = 1.0
    table: Any = None


class Looks:
    """The looks of scenes.

    Args:
        ask: has ``make`` called when Blender does not draw: a table is made by data-blocks, which drawing must not
            touch.
    """

    def __init__(self, ask: Callable[[], None]) -> None:
        self._ask = ask
        self._tables: OrderedDict[tuple[Any, ...], Any] = OrderedDict()  # None for one that cannot be made
        self._wanted: dict[tuple[Any, ...], int] = {}
        self._shown: dict[int, tuple[Any, ...]] = {}

    def of(self, scene: bpy.types.Scene, card: Any) -> Look:
        """A scene's look; until its table was made with the one that it had before, if any."""
        settings = scene.view_settings
        plain = Look(2.0**settings.exposure, 1.0 / max(settings.gamma, 1e-3))
        if is_plain(scene):
            return plain
        key, uid = _key(scene), scene.session_uid
        if key in self._tables:
            self._shown[uid] = key
        else:
            self._wanted[key] = uid
            self._ask()
            key = self._shown.get(uid, key)
        if key in self._tables:
            self._tables.move_to_end(key)
        if self._tables.get(key) is None:
            return plain
        if isinstance(self._tables[key], np.ndarray):  # made since
            self._tables[key] = card.texture(texels_of(self._tables[key], 4))
        return Look(table=self._tables[key])

    def make(self) -> None:
        """Makes the tables that were asked for."""
        asked, self._wanted = self._wanted, {}
        scenes = {scene.session_uid: scene for scene in bpy.data.scenes}
        self._shown = {uid: key for uid, key in self._shown.items() if uid in scenes}
        for key, uid in asked.items():
            scene = scenes.get(uid)
            if scene is None or _key(scene) != key:
                continue
            try:
                self._tables[key] = table_of(scene)
            except Exception as error:  # splats are shown without
                self._tables[key] = None
                reported_once.unexpected(f"the colors of {scene.name}", error)
        while len(self._tables) > _KEPT:
            self._tables.popitem(last=False)


def is_plain(scene: bpy.types.Scene) -> bool:
    """Whether a scene shows displayed colors as they are, but for exposure and gamma."""
    settings = scene.view_settings
    corrected = settings.use_curve_mapping or getattr(settings, "use_white_balance", False)
    return settings.view_transform == _PLAIN and settings.look == "None" and not corrected


def table_of(scene: bpy.types.Scene) -> np.ndarray:
    """(SIDE ** 3, 4) float32 what a scene shows of displayed colors, red the fastest."""
    steps = np.linspace(0.0, 1.0, SIDE, dtype=np.float32)
    blue, green, red = np.meshgrid(steps, steps, steps, indexing="ij")
    linear = np.ones((SIDE**3, 4), np.float32)
    linear[:, :3] = to_linear(np.stack([red, green, blue], axis=-1).reshape(-1, 3))
    return _shown_by(scene, into_working_space(linear))


def _shown_by(scene: bpy.types.Scene, linear: np.ndarray) -> np.ndarray:
    """(N, 4) float32 displayed colors of scene-linear ones, N a multiple of SIDE."""
    size = SIDE, len(linear) // SIDE
    source = bpy.data.images.new("FRoG colors", *size, alpha=True, float_buffer=True)
    saver, shown = bpy.data.scenes.new("FRoG colors"), None
    try:
        with tempfile.TemporaryDirectory(prefix="frog-colors-") as folder:
            source.pixels.foreach_set(linear.reshape(-1))
            path = str(Path(folder) / "colors.png")
            _copy_look(scene, saver)
            source.save_render(path, scene=saver)
            shown = bpy.data.images.load(path)
            shown.colorspace_settings.is_data = True
            colors = np.empty(len(linear) * 4, np.float32)
            shown.pixels.foreach_get(colors)
    finally:
        bpy.data.images.remove(source)
        bpy.data.scenes.remove(saver)
        if shown is not None:
            bpy.data.images.remove(shown)
    return colors.reshape(-1, 4)


def _copy_look(scene: bpy.types.Scene, target: bpy.types.Scene) -> None:
    """Makes a scene save images as another one shows them, in 16 bits and without dithering."""
    target.render.dither_intensity = 0.0
    image = target.render.image_settings
    image.file_format, image.color_mode, image.color_depth = "PNG", "RGBA", "16"
    target.display_settings.display_device = scene.display_settings.display_device
    for name in _settings_of(scene.view_settings):
        setattr(target.view_settings, name, getattr(scene.view_settings, name))
    if scene.view_settings.use_curve_mapping:
        mine, theirs = target.view_settings.curve_mapping, scene.view_settings.curve_mapping
        for name in _CURVES_OWN:
            setattr(mine, name, getattr(theirs, name))
        for copy, curve in zip(mine.curves, theirs.curves, strict=True):
            while len(copy.points) < len(curve.points):
                copy.points.new(0.5, 0.5)
            for point, original in zip(copy.points, curve.points, strict=False):
                point.location, point.handle_type = original.location, original.handle_type
        mine.update()


def _settings_of(settings: bpy.types.ColorManagedViewSettings) -> list[str]:
    """The names of plain settings, the view transform before the look, which depends on it."""
    names = [prop.identifier for prop in settings.bl_rna.properties if not prop.is_readonly and prop.type != "POINTER"]
    return sorted(names, key=lambda name: name != "view_transform")


def _key(scene: bpy.types.Scene) -> tuple[Any, ...]:
    """What determines a scene's table."""
    settings = scene.view_settings
    values = [getattr(settings, name) for name in _settings_of(settings)]
    plain = (tuple(value) if isinstance(value, Color) else value for value in values)
    points: tuple[Any, ...] = ()
    if settings.use_curve_mapping:
        mapping = settings.curve_mapping
        levels = (*mapping.black_level, *mapping.white_level)
        points = levels, *((*point.location, point.handle_type) for curve in mapping.curves for point in curve.points)
    working = bpy.data.colorspace.working_space if bpy.app.version >= (5, 0, 0) else ""
    return scene.display_settings.display_device, working, *plain, *points
