"""Reads the OpenEXR files that Blender writes with 32-bit floats and no compression: exactly what a render stored."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np

_MAGIC = b"\x76\x2f\x31\x01"
_MULTIPART = 0x1000
_TYPES = {0: "<u4", 1: "<f2", 2: "<f4"}


@dataclass
class _Part:
    """One image of a file: its channels in the order in which rows store them, and its data window."""

    channels: list[tuple[str, np.dtype]]
    window: tuple[int, int, int, int]


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
    found = {key.rsplit(".", 1)[1]: values for key, values in channels.items() if f".{name}." in key}
    return np.stack([found[each] for each in components], axis=-1) if components else found.popitem()[1]


@contextmanager
def _multilayer(settings: bpy.types.ImageFormatSettings) -> Iterator[None]:
    """Multilayer files inside; afterwards what was set before."""
    wanted = {"file_format": "OPEN_EXR_MULTILAYER", "color_depth": "32", "exr_codec": "NONE"}
    if hasattr(settings, "media_type"):  # which decides what formats there are
        wanted = {"media_type": "MULTI_LAYER_IMAGE", **wanted}
    names = ("media_type", "file_format", "color_mode", "color_depth")
    before = {name: getattr(settings, name) for name in names if hasattr(settings, name)}
    for name, value in wanted.items():
        setattr(settings, name, value)
    try:
        yield
    finally:
        for name, value in before.items():
            setattr(settings, name, value)


def read_exr(path: Path) -> dict[str, np.ndarray]:
    """(H, W) of each channel by its name, rows from the top."""
    content = path.read_bytes()
    assert content[:4] == _MAGIC, f"{path}: no OpenEXR file"
    (version,) = struct.unpack_from("<I", content, 4)
    parts, at = _parts(content, 8, bool(version & _MULTIPART))
    rows = sum(part.window[3] - part.window[1] + 1 for part in parts)
    images: dict[str, np.ndarray] = {}
    for part in parts:
        left, top, right, bottom = part.window
        for name, kind in part.channels:
            images[name] = np.empty((bottom - top + 1, right - left + 1), kind)
    for begin in struct.unpack_from(f"<{rows}Q", content, at):
        number = 0
        if version & _MULTIPART:
            (number,) = struct.unpack_from("<i", content, begin)
            begin += 4
        part = parts[number]
        (row,) = struct.unpack_from("<i", content, begin)
        begin += 8  # its number and its size
        width = part.window[2] - part.window[0] + 1
        for name, kind in part.channels:
            images[name][row - part.window[1]] = np.frombuffer(content, kind, width, begin)
            begin += width * kind.itemsize
    return images


def _parts(content: bytes, at: int, several: bool) -> tuple[list[_Part], int]:
    """The headers, and where the table of rows begins."""
    parts: list[_Part] = []
    while not parts or (several and content[at]):
        attributes: dict[str, bytes] = {}
        while content[at]:
            name, at = _word(content, at)
            _, at = _word(content, at)  # the type
            (size,) = struct.unpack_from("<i", content, at)
            attributes[name] = content[at + 4 : at + 4 + size]
            at += 4 + size
        at += 1
        assert attributes["compression"] == b"\0", "expected no compression"
        window = struct.unpack("<4i", attributes["dataWindow"])
        parts.append(_Part(list(_channels(attributes["channels"])), window))
    return parts, at + several


def _word(content: bytes, at: int) -> tuple[str, int]:
    """The text that begins there, and where it ends."""
    end = content.index(b"\0", at)
    return content[at:end].decode(), end + 1


def _channels(stored: bytes) -> Iterator[tuple[str, np.dtype]]:
    at = 0
    while stored[at]:
        name, at = _word(stored, at)
        (kind,) = struct.unpack_from("<i", stored, at)
        at += 16  # type, linearity, sampling
        yield name, np.dtype(_TYPES[kind])
