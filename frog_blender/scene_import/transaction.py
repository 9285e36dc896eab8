"""Reverts everything that an import has added and changed if it fails."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bpy

SETTINGS = (
    *("camera", "world", "frame_start", "frame_end"),
    *("render.engine", "render.fps", "render.fps_base", "render.resolution_x", "render.resolution_y"),
    *("render.resolution_percentage", "render.pixel_aspect_x", "render.pixel_aspect_y"),
    *("render.dither_intensity", "render.use_lock_interface"),
    *("view_settings.view_transform", "view_settings.look", "cycles.transparent_max_bounces"),
)
"""Paths of all scene settings that ``set_up`` changes. The start of the frame range comes before its end, as neither
can pass the other.
"""


@contextmanager
def all_or_nothing(scene: bpy.types.Scene) -> Iterator[None]:
    """Runs code that adds data-blocks and changes settings of ``scene``. Any exception reverts both and is raised
    again.

    Nothing else may add data-blocks meanwhile, which on Blender's main thread nothing does.
    """
    settings, newest = values(scene), _newest()
    try:
        yield
    except BaseException:
        _restore(scene, settings)
        bpy.data.batch_remove(_newer_than(newest))
        raise


def values(scene: bpy.types.Scene) -> dict[str, Any]:
    """SETTINGS of a scene by path, those that this Blender has."""
    found = {}
    for path in SETTINGS:
        try:
            found[path] = scene.path_resolve(path)
        except ValueError:  # Cycles is an add-on, which may be off
            continue
    return found


def _restore(scene: bpy.types.Scene, settings: dict[str, Any]) -> None:
    for path, value in settings.items():
        owner, _, name = path.rpartition(".")
        setattr(scene.path_resolve(owner) if owner else scene, name, value)


def _newest() -> int:
    """The last session_uid: each new data-block of a session gets a larger one."""
    text = bpy.data.texts.new("FRoG")
    newest = int(text.session_uid)
    bpy.data.texts.remove(text)
    return newest


def _newer_than(uid: int) -> list[bpy.types.ID]:
    lists = [getattr(bpy.data, kind.identifier) for kind in bpy.data.bl_rna.properties if kind.type == "COLLECTION"]
    return [block for blocks in lists for block in blocks if block.session_uid > uid]
