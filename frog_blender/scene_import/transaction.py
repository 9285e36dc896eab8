"""All or nothing: what an import has added and set is taken back where it fails half way."""

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
"""Paths from a scene to whatever setting it up for a capture changes; the start of the range before its end, because
neither can be set beyond the other."""


@contextmanager
def all_or_nothing(scene: Any) -> Iterator[None]:
    """Runs what adds data-blocks and changes settings of ``scene``; any exception takes both back and goes on.

    Nothing else may add data-blocks meanwhile, which on Blender's main thread nothing does.
    """
    settings, newest = values(scene), _newest()
    try:
        yield
    except BaseException:
        _restore(scene, settings)
        bpy.data.batch_remove(_newer_than(newest))
        raise


def values(scene: Any) -> dict[str, Any]:
    """SETTINGS of a scene by path, those that this Blender has."""
    found = {}
    for path in SETTINGS:
        try:
            found[path] = scene.path_resolve(path)
        except ValueError:  # Cycles is an add-on, which may be off
            continue
    return found


def _restore(scene: Any, settings: dict[str, Any]) -> None:
    for path, value in settings.items():
        owner, _, name = path.rpartition(".")
        setattr(scene.path_resolve(owner) if owner else scene, name, value)


def _newest() -> int:
    """The session_uid that was given last: each new data-block of a session gets a larger one than all before it."""
    text = bpy.data.texts.new("FRoG")
    newest = int(text.session_uid)
    bpy.data.texts.remove(text)
    return newest


def _newer_than(uid: int) -> list[Any]:
    lists = [getattr(bpy.data, each.identifier) for each in bpy.data.bl_rna.properties if each.type == "COLLECTION"]
    return [block for blocks in lists for block in blocks if block.session_uid > uid]
