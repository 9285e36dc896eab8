"""The box that a rig stands around, and the rig's cameras, as objects of a collection of their own."""

from contextlib import closing
from typing import Any

import bpy
import numpy as np
from mathutils import Matrix, Vector

from ..engine.arrays import Float64s
from ..engine.errors import FrogError
from ..timeline.frame_timing import evaluated_frames
from . import rig

NAME = "FRoG Rig"
_SHOWN = {"MESH", "CURVE", "SURFACE", "FONT", "META", "CURVES", "POINTCLOUD", "VOLUME"}
_SENSOR = 36.0  # millimetres
_MOMENTS = 16  # frames at which moving objects are looked at, at most
_NEAR, _FAR = 0.01, 100.0  # clipping, in distances to the box's middle
_SMALL = 0.06  # of a camera's drawn size, in distances


def fit_box(scene: bpy.types.Scene, layer: bpy.types.ViewLayer, settings: Any) -> bpy.types.Object:
    """The settings' box, created if there is none, around the selected objects over the scene's frames; around all that
    renders if none of them is selected.

    Args:
        settings: ``Scene.frog.rig``.

    Raises:
        FrogError: if nothing renders.
    """
    shown = [obj for obj in layer.objects if (obj.type in _SHOWN or obj.is_instancer) and not obj.hide_render]
    low, high = _bounds(scene, layer, [obj for obj in shown if obj.select_get()] or shown)
    box = settings.box
    if box is None or box.type != "EMPTY":
        box = settings.box = bpy.data.objects.new(f"{NAME} Box", None)
        collection_of(scene, settings).objects.link(box)
    box.empty_display_type, box.empty_display_size = "CUBE", 1.0
    box.matrix_world = Matrix.LocRotScale(Vector((low + high) / 2), None, Vector(np.maximum((high - low) / 2, 1e-6)))
    return box


def place(scene: bpy.types.Scene, settings: Any) -> list[bpy.types.Object]:
    """The rig's cameras, placed anew around the settings' box. Others in its collection stay.

    Raises:
        FrogError: without a box, or for one without a size.
    """
    middle, corners = _extent_of(settings.box)
    directions = rig.directions(settings.shape, settings.count, settings.arc)
    away = rig.distance(corners, directions, _SENSOR / 2 / settings.lens)
    collection = collection_of(scene, settings)
    _remove_placed(settings)
    cameras = []
    for index, direction in enumerate(directions):
        data = bpy.data.cameras.new(f"rig{index:02d}")
        data.sensor_fit, data.sensor_width, data.lens = "HORIZONTAL", _SENSOR, settings.lens
        data.clip_start, data.clip_end, data.display_size = _NEAR * away, _FAR * away, _SMALL * away
        camera = bpy.data.objects.new(data.name, data)
        data.frog.rig_camera = camera.name
        camera.matrix_world = Matrix(rig.pose(direction, middle, away).tolist())
        collection.objects.link(camera)
        cameras.append(camera)
    return cameras


def collection_of(scene: bpy.types.Scene, settings: Any) -> bpy.types.Collection:
    """The rig's collection, created and linked to the scene if there is none."""
    collection = settings.collection
    if collection is None:
        collection = settings.collection = bpy.data.collections.new(NAME)
    if collection not in scene.collection.children_recursive:
        scene.collection.children.link(collection)
    return collection


def cameras_of(settings: Any) -> list[bpy.types.Object]:
    """The cameras of the rig's collection, by name; a user may have moved, added or deleted some."""
    if settings.collection is None:
        return []
    cameras = [obj for obj in settings.collection.all_objects if obj.type == "CAMERA"]
    return sorted(cameras, key=lambda obj: obj.name)


def placed(settings: Any) -> list[bpy.types.Object]:
    """Those cameras of the rig's collection that ``place`` made. A copy of one, or one of another name, is the user's
    own.
    """
    return [obj for obj in cameras_of(settings) if obj.data.frog.rig_camera == obj.name]


def _remove_placed(settings: Any) -> None:
    """Deletes the cameras that ``place`` made with their data."""
    for obj in placed(settings):
        data = obj.data
        bpy.data.objects.remove(obj)
        if data.users == 0:
            bpy.data.cameras.remove(data)


def remove(settings: Any) -> None:
    """Deletes the rig: the cameras and the box that were made for it, and the collection if nothing else is in it."""
    collection, box = settings.collection, settings.box
    if collection is None:
        return
    _remove_placed(settings)
    if box is not None and box.type == "EMPTY" and collection.objects.get(box.name) == box:
        bpy.data.objects.remove(box)
    if not collection.all_objects:
        bpy.data.collections.remove(collection)


def _bounds(
    scene: bpy.types.Scene, layer: bpy.types.ViewLayer, objects: list[bpy.types.Object]
) -> tuple[Float64s, Float64s]:
    """Lowest and highest corner (3,) of objects over the scene's frames. The scene's frame is what it was afterwards.

    FrogError without any.
    """
    count = min(_MOMENTS, scene.frame_end - scene.frame_start + 1)
    frames = sorted({round(frame) for frame in np.linspace(scene.frame_start, scene.frame_end, count)})
    with closing(evaluated_frames(scene, frames, layer)) as graphs:
        corners = [corner for graph in graphs for corner in _corners(graph, set(objects))]
    if not corners:
        raise FrogError(f"Scene {scene.name}: found nothing that renders, expected an object to place cameras around.")
    points = np.concatenate(corners)
    return points.min(axis=0), points.max(axis=0)


def _corners(graph: bpy.types.Depsgraph, objects: set[bpy.types.Object]) -> list[Float64s]:
    """The corners (8, 3) of the evaluated objects' boxes, and of what they instance."""
    corners = []
    for instance in graph.object_instances:
        obj = instance.object
        owner = instance.parent.original if instance.is_instance and instance.parent else obj.original
        if owner not in objects or obj.type not in _SHOWN:
            continue
        matrix, box = np.array(instance.matrix_world), np.array([list(corner) for corner in obj.bound_box])
        corners.append(box @ matrix[:3, :3].T + matrix[:3, 3])
    return corners


def _extent_of(box: bpy.types.Object | None) -> tuple[Float64s, Float64s]:
    """Middle (3,) of a box object, and its corners (8, 3) from there."""
    if box is None:
        raise FrogError("The rig has no box, expected an object to place cameras around. Press Fit to Selection.")
    if box.type == "EMPTY":
        size = box.empty_display_size
        corners = np.array([[x, y, z] for x in (-size, size) for y in (-size, size) for z in (-size, size)])
        matrix = np.array(box.matrix_basis if box.parent is None else box.matrix_world)
    else:
        corners, matrix = np.array([list(corner) for corner in box.bound_box]), np.array(box.matrix_world)
    corners = corners @ matrix[:3, :3].T + matrix[:3, 3]
    middle: Float64s = (corners.min(axis=0) + corners.max(axis=0)) / 2
    if not np.isfinite(corners).all() or not np.ptp(corners, axis=0).any():
        raise FrogError(f"{box.name}: found a box without a size, expected one to place cameras around.")
    return middle, corners - middle
