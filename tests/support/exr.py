"""Reads the OpenEXR files that Blender writes with 32-bit floats: exactly what a render stored."""

import itertools
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import bpy
import numpy as np
import pytest


def render_channels(scene: bpy.types.Scene, path: Path) -> dict[str, np.ndarray]:
    """Renders the scene's current frame into a multilayer file.

    Returns:
        (H, W) of each channel, rows from the top, by a name such as ``"ViewLayer.Combined.R"``.
    """
    with _multilayer(scene.render.image_settings):
        before, scene.render.filepath = scene.render.filepath, str(path)
        bpy.ops.render.render(write_still=True, scene=scene.name)
        scene.render.filepath = before
    return read_exr(path)


def pass_of(channels: dict[str, np.ndarray], name: str, components: str = "") -> np.ndarray:
    """(H, W, components) of a pass of the only view layer; (H, W) of a pass of one component, whatever its name."""
    images = {key.rsplit(".", 1)[1]: values for key, values in channels.items() if f".{name}." in key}
    return np.stack([images[component] for component in components], axis=-1) if components else images.popitem()[1]


@contextmanager
def _multilayer(settings: bpy.types.ImageFormatSettings) -> Iterator[None]:
    """Multilayer files inside; afterwards what was set before."""
    multilayer = {"file_format": "OPEN_EXR_MULTILAYER", "color_depth": "32", "exr_codec": "NONE"}
    if hasattr(settings, "media_type"):  # which decides what formats there are
        multilayer = {"media_type": "MULTI_LAYER_IMAGE", **multilayer}
    names = ("media_type", "file_format", "color_mode", "color_depth")
    before = {name: getattr(settings, name) for name in names if hasattr(settings, name)}
    for name, value in multilayer.items():
        setattr(settings, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(settings, name, value)


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """(H, W) float32 of each channel by its name, rows from the top, by the library that Blender brings along."""
    bpy.utils.expose_bundled_modules()
    library = pytest.importorskip("OpenImageIO", reason="this Blender does not lend its OpenImageIO")
    file, images = library.ImageInput.open(str(path)), {}
    for part in itertools.count():
        if not file.seek_subimage(part, 0):
            return images
        pixels = file.read_image(part, 0, 0, file.spec().nchannels, library.FLOAT)
        images |= {name: pixels[..., index] for index, name in enumerate(file.spec().channelnames)}
