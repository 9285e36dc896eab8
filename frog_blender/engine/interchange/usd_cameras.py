"""Cameras of anybody's USD stage as pinhole cameras, with z up."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import Array, Float64s
from ..capture.camera import MAX_SIDE, Camera
from ..scene.header import MOST_STANDING

if TYPE_CHECKING:
    from pxr import Usd

NAME, SIZE = "frog:camera", "frog:size"
"""Custom data of cameras that ``usd_export`` writes: the name in the capture, and pixels, of which USD has none."""
_WIDTH = 1920  # pixels, of other programs' cameras
_GL = np.diag([1.0, -1.0, -1.0, 1.0])  # USD's cameras look along -z, with y up
_LENS = {
    "focalLength": 50.0,
    "horizontalAperture": 20.955,
    "verticalAperture": 15.2908,
    "horizontalApertureOffset": 0.0,
    "verticalApertureOffset": 0.0,
}
"""What a lens is made of, with the schema's own values for what a file leaves out."""


def cameras_of(stage: Usd.Stage, time: float | None, up: Array) -> Iterator[Camera]:
    """The perspective cameras of a stage, at most MOST_STANDING; those that no pinhole camera can stand for are left
    out.

    Args:
        time: code at which they are looked at: one that moves is where it is then. None for no time.
        up: (4, 4) from the stage's world to one with z up.
    """
    from pxr import Usd, UsdGeom

    code = Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)
    cache, names = UsdGeom.XformCache(code), set[str]()
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.GetTypeName() != "Camera" or _value(prim, "projection", code) not in (None, "perspective"):
            continue
        name, number = str(prim.GetCustomDataByKey(NAME) or prim.GetName()), 1
        base = name
        while name in names:
            number += 1
            name = f"{base}_{number}"
        matrix = np.array(cache.GetLocalToWorldTransform(prim), np.float64).T  # rows are vectors in USD
        try:
            camera = _camera(prim, code, name, up @ matrix)
        except (ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError):
            continue
        names.add(name)
        yield camera
        if len(names) >= MOST_STANDING:
            return


def _camera(prim: Usd.Prim, code: Usd.TimeCode, name: str, to_world: Float64s) -> Camera:
    """ValueError or an error of arithmetic for what is no pinhole camera."""
    found = {each: _value(prim, each, code) for each in _LENS}
    lens = {each: _LENS[each] if value is None else float(value) for each, value in found.items()}
    across, down = lens["horizontalAperture"], lens["verticalAperture"]
    if not (all(map(np.isfinite, lens.values())) and min(across, down, lens["focalLength"]) > 0):
        raise ValueError("a lens of no size")
    width, height = _size(prim, down / across)
    k = np.array(
        [
            [lens["focalLength"] * width / across, 0, width * (0.5 - lens["horizontalApertureOffset"] / across)],
            [0, lens["focalLength"] * height / down, height * (0.5 + lens["verticalApertureOffset"] / down)],
            [0, 0, 1],
        ]
    )
    pose = to_world.copy()
    sizes = np.linalg.norm(pose[:3, :3], axis=0)  # a camera that is scaled sees the same
    if not (np.isfinite(pose).all() and sizes.min() > 0):
        raise ValueError("a place that is none")
    pose[:3, :3] /= sizes
    camera = Camera(name, width, height, k, np.linalg.inv(pose @ _GL))
    return Camera.from_json(camera.to_json())


def _size(prim: Usd.Prim, aspect: float) -> tuple[int, int]:
    """Pixels: those that the file names, or a usual width."""
    named = prim.GetCustomDataByKey(SIZE)
    if named is not None and len(named) == 2:
        return int(named[0]), int(named[1])
    return _WIDTH, int(np.clip(round(_WIDTH * aspect), 1, MAX_SIDE))


def _value(prim: Usd.Prim, name: str, code: Usd.TimeCode) -> Any:  # of pxr, which has no types
    attribute = prim.GetAttribute(name)
    return attribute.Get(code) if attribute else None
