"""Cameras of USD stages: a capture's written, and anybody's read as pinhole cameras with z up."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from ..arrays import Array, Float64s
from ..capture.camera import MAX_SIDE, Camera
from ..scene.header import MOST_STANDING, SceneHeader
from ..source_media.clips import camera_path

if TYPE_CHECKING:
    from pxr import Usd

_NAME, _PIXELS = "frog:camera", "frog:size"
"""Custom data of cameras that are written here: the name in the capture, and pixels, of which USD has none."""
_WIDTH = 1920  # pixels, of other programs' cameras
_APERTURE = 36.0  # tenths of a unit, as of a 35 mm film in millimetres
_GL = np.diag([1.0, -1.0, -1.0, 1.0])  # USD's cameras look along -z, with y up
_LENS = {
    "focalLength": 50.0,
    "horizontalAperture": 20.955,
    "verticalAperture": 15.2908,
    "horizontalApertureOffset": 0.0,
    "verticalApertureOffset": 0.0,
}
"""What a lens is made of, with the schema's own values for what a file leaves out."""


def add_cameras(stage: Usd.Stage, scope: str, header: SceneHeader, shown: Sequence[tuple[float, float]]) -> None:
    """The capture's cameras; one that moves is where it was at the frame that is shown.

    Args:
        shown: frame numbers, and the capture's frame at each.
    """
    if header.cameras:
        stage.DefinePrim(scope, "Scope")
    if header.is_moving:
        path = camera_path(header)
        filmed = np.array([frame for frame, _ in path])
        views = [(number, path[int(np.abs(filmed - time).argmin())][1]) for number, time in shown]
        _add_camera(stage, scope, "Moving Camera", views)
        return
    for camera in header.cameras:
        _add_camera(stage, scope, camera.name, [(None, camera)])


def _add_camera(stage: Usd.Stage, scope: str, name: str, views: Sequence[tuple[float | None, Camera]]) -> None:
    """One camera at its frame numbers, or without time samples where there is one view of number None."""
    from pxr import Gf, Tf

    identifier = _free_name(Tf.MakeValidIdentifier(name), lambda tried: bool(stage.GetPrimAtPath(f"{scope}/{tried}")))
    prim = stage.DefinePrim(f"{scope}/{identifier}", "Camera")
    prim.SetCustomDataByKey(_NAME, name)
    prim.SetCustomDataByKey(_PIXELS, Gf.Vec2i(views[0][1].width, views[0][1].height))
    put(prim, "clippingRange", "Float2", Gf.Vec2f(0.01, 10_000.0))
    put(prim, "projection", "Token", "perspective")
    lens = [put(prim, part, "Float") for part in _LENS]
    pose = transform_of(prim)
    for at, camera in views:
        time = time_code(at)
        for attribute, value in zip(lens, _lens_of(camera), strict=True):
            attribute.Set(value, time)
        pose.Set(usd_matrix(np.linalg.inv(camera.world_to_camera) @ _GL), time)


def _free_name(name: str, is_taken: Callable[[str], bool]) -> str:
    numbered = (f"{name}_{count}" for count in itertools.count(2))
    return next(tried for tried in itertools.chain([name], numbered) if not is_taken(tried))


def _lens_of(camera: Camera) -> tuple[float, ...]:
    """A pinhole camera's _LENS; an off-centre principal point is an offset of the aperture."""
    k, width, height = camera.intrinsics, camera.width, camera.height
    tall = _APERTURE * height / width * k[0, 0] / k[1, 1]
    offsets = _APERTURE * (0.5 - k[0, 2] / width), tall * (k[1, 2] / height - 0.5)
    return float(k[0, 0] * _APERTURE / width), _APERTURE, float(tall), *map(float, offsets)


def time_code(time: float | None) -> Usd.TimeCode:
    """The default one for None."""
    from pxr import Usd

    return Usd.TimeCode.Default() if time is None else Usd.TimeCode(time)


def put(prim: Usd.Prim, name: str, kind: str, value: Any = None, *, varies: bool = True) -> Usd.Attribute:
    """A new attribute of a type by its name, with a value where there is one."""
    from pxr import Sdf

    variability = Sdf.VariabilityVarying if varies else Sdf.VariabilityUniform
    attribute = prim.CreateAttribute(name, getattr(Sdf.ValueTypeNames, kind), False, variability)
    if value is not None:
        attribute.Set(value)
    return attribute


def transform_of(prim: Usd.Prim) -> Usd.Attribute:
    """A new attribute by which a prim is placed."""
    pose = put(prim, "xformOp:transform", "Matrix4d")
    put(prim, "xformOpOrder", "TokenArray", ["xformOp:transform"], varies=False)
    return pose


def usd_matrix(matrix: Array) -> Any:  # of pxr, which has no types
    """(4, 4) in USD's way, in which rows are vectors."""
    from pxr import Gf

    return Gf.Matrix4d(np.asarray(matrix, np.float64).T.tolist())


def world_matrix(cache: Any, prim: Usd.Prim) -> Float64s:
    """(4, 4) from a prim's space to the stage's."""
    return np.array(cache.GetLocalToWorldTransform(prim), np.float64).T


def cameras_of(stage: Usd.Stage, time: float | None, up: Array) -> Iterator[Camera]:
    """The perspective cameras of a stage, at most MOST_STANDING; those that no pinhole camera can stand for are left
    out.

    Args:
        time: code at which they are looked at: one that moves is where it is then. None for no time.
        up: (4, 4) from the stage's world to one with z up.
    """
    from pxr import Usd, UsdGeom

    code = time_code(time)
    cache, names = UsdGeom.XformCache(code), set[str]()
    for prim in stage.Traverse(Usd.TraverseInstanceProxies()):
        if prim.GetTypeName() != "Camera" or _value(prim, "projection", code) not in (None, "perspective"):
            continue
        name = _free_name(str(prim.GetCustomDataByKey(_NAME) or prim.GetName()), names.__contains__)
        try:
            camera = _camera(prim, code, name, up @ world_matrix(cache, prim))
        except (ValueError, TypeError, ArithmeticError, np.linalg.LinAlgError):
            continue
        names.add(name)
        yield camera
        if len(names) >= MOST_STANDING:
            return


def _camera(prim: Usd.Prim, code: Usd.TimeCode, name: str, to_world: Float64s) -> Camera:
    """ValueError or an error of arithmetic for what is no pinhole camera."""
    said = ((_value(prim, part, code), usual) for part, usual in _LENS.items())
    focal, across, down, right, up = (usual if value is None else float(value) for value, usual in said)
    if not (np.isfinite([focal, across, down, right, up]).all() and min(across, down, focal) > 0):
        raise ValueError("a lens of no size")
    width, height = _size(prim, down / across)
    x, y = width * (0.5 - right / across), height * (0.5 + up / down)
    k = np.array([[focal * width / across, 0, x], [0, focal * height / down, y], [0, 0, 1]])
    pose = to_world.copy()
    sizes = np.linalg.norm(pose[:3, :3], axis=0)  # a camera that is scaled sees the same
    if not (np.isfinite(pose).all() and sizes.min() > 0):
        raise ValueError("a place that is none")
    pose[:3, :3] /= sizes
    camera = Camera(name, width, height, k, np.linalg.inv(pose @ _GL))
    return Camera.from_json(camera.to_json())


def _size(prim: Usd.Prim, aspect: float) -> tuple[int, int]:
    """Pixels: those that the file names, or a usual width."""
    named = prim.GetCustomDataByKey(_PIXELS)
    if named is not None and len(named) == 2:
        return int(named[0]), int(named[1])
    return _WIDTH, int(np.clip(round(_WIDTH * aspect), 1, MAX_SIDE))


def _value(prim: Usd.Prim, name: str, code: Usd.TimeCode) -> Any:  # of pxr, which has no types
    attribute = prim.GetAttribute(name)
    return attribute.Get(code) if attribute else None
