"""Stores Gaussians in a Blender data-block that every render engine can draw.

Blender 5.3 draws Gaussian splats itself: there the Gaussians live in a point cloud of that type.  Before 5.3, and where
Blender refuses one, they are the vertices of a Mesh that Geometry Nodes turn into points (``splat_nodes``).

Attributes are named as those of 5.3 in both: ``position``, ``scale`` (linear), ``rotation`` (w, x, y, z),
``radiance:base`` (first SH coefficient and opacity) and ``radiance:sh_0`` ... (one per further SH coefficient).
Nothing outside this file knows attribute types.
"""

import sys
from collections.abc import Callable
from typing import Literal, TypeAlias

import bpy
import numpy as np

from .engine.gaussians import GaussianArrays
from .engine.playback.frame_delta import FrameDelta, column_view
from .engine.playback.player import ScenePlayer
from .nodes import splat_nodes
from .nodes.node_builder import set_input

TYPES = ("MESH", "POINTCLOUD")
"""Types of objects that can hold Gaussians, in files of any Blender version."""
Data: TypeAlias = "bpy.types.Mesh | bpy.types.PointCloud"
Place = Literal["render", "viewport"]
DATA_TYPES = (bpy.types.Mesh, bpy.types.PointCloud)
_MODIFIER = "Gaussians as points"
_HIDING = "Hidden"
_SPLATS = "GAUSSIAN_SPLAT"  # Blender 5.3's type of a point cloud
_VALUE_KEY = {"FLOAT_VECTOR": "vector", "QUATERNION": "value", "FLOAT4": "vector", "FLOAT_COLOR": "color"}
_FIXED = {"scale": "FLOAT_VECTOR", "rotation": "QUATERNION"}
_BASE = {"MESH": "FLOAT_COLOR", "POINTCLOUD": "FLOAT4"}
# radiance:base is a FLOAT4 in Blender 5.3.  Before 5.2 that type does not exist, and no version's Mesh to Points and
# Attribute nodes are promised to carry it, while FLOAT_COLOR (four floats, never converted) works in all of them.

_COLUMNS = {"position": "means", "scale": "scales", "rotation": "quaternions", "radiance:base": "base"}
_MOST = 0.01, 0.99  # quantiles of the positions; the rest may lie kilometres away
_NEARLY_ALL, _ROOM = (0.002, 0.998), 0.2  # quantiles, and a share of what lies between them on each side
_SHOWN = "frog_shown"
"""A custom property of the mesh: the token of the scene and the time of the Gaussians it holds. Undo, copying and
loading restore it together with the mesh, so it is always right. ``show`` uses it to skip writing.
"""


def draws_splats() -> bool:
    """Whether this Blender draws Gaussian splats itself."""
    kind = bpy.types.PointCloud.bl_rna.properties.get("type")
    return kind is not None and _SPLATS in kind.enum_items.keys()  # noqa: SIM118


def create(name: str, gaussians: GaussianArrays, *, as_splats: bool | None = None) -> bpy.types.Object:
    """A new object that holds ``gaussians``, with its nodes and material, not linked to a collection yet.

    Args:
        as_splats: whether to try Blender's own splats; None for where it draws them.
    """
    if draws_splats() if as_splats is None else as_splats:
        cloud = bpy.data.pointclouds.new(name)
        try:
            cloud.type = _SPLATS  # refused by a Blender that knows none
            obj = bpy.data.objects.new(name, cloud)
            write(obj, gaussians)
        except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
            print(f"FRoG: Blender's own splats cannot be used ({error}). Using points instead.", file=sys.stderr)
            bpy.data.pointclouds.remove(cloud)  # and the object that has it
        else:
            return obj
    mesh = bpy.data.meshes.new(name)
    obj = bpy.data.objects.new(name, mesh)
    mesh.materials.append(splat_nodes.material())
    modifier = _add_modifier(obj, _MODIFIER, splat_nodes.points_group())
    _limit_in_viewports(modifier, gaussians.means)
    write(obj, gaussians)
    return obj


def prepare() -> None:
    """Makes the nodes and the material that ``create`` needs, which takes as long as all the rest of it."""
    if not draws_splats():
        splat_nodes.material()
        splat_nodes.points_group()


def triangles_of(mesh: bpy.types.Mesh) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) float32 vertices and (T, 3) int32 triangles."""
    mesh.calc_loop_triangles()
    vertices = np.empty((len(mesh.vertices), 3), np.float32)
    triangles = np.empty((len(mesh.loop_triangles), 3), np.int32)
    mesh.vertices.foreach_get("co", vertices.reshape(-1))
    mesh.loop_triangles.foreach_get("vertices", triangles.reshape(-1))
    return vertices, triangles


def _quantiles(points: np.ndarray, shares: tuple[float, float]) -> np.ndarray:
    """(2, 3) of those of (N, 3) points that are finite; zeros where there are none."""
    finite = points[np.isfinite(points).all(axis=1)]
    if not len(finite):
        return np.zeros((2, 3))
    return np.quantile(np.ascontiguousarray(finite.T), shares, axis=1)  # row by row would take ten times as long


def middle_of(means: np.ndarray) -> tuple[np.ndarray, float]:
    """(3,) the middle of the box that holds most of (N, 3) points, and half its longest side."""
    low, high = _quantiles(means, _MOST)
    return (low + high) / 2, float((high - low).max()) / 2


def _limit_in_viewports(modifier: bpy.types.Modifier, means: np.ndarray) -> None:
    """Sets the largest radius of points (N, 3) in viewports, with which they cover the box of most of them about once,
    and the box that nearly all lie in, with room for what moves.
    """
    radius = float(np.linalg.norm(np.ptp(_quantiles(means, _MOST), axis=0)) / (2.0 * np.sqrt(max(len(means), 1))))
    low, high = _quantiles(means, _NEARLY_ALL)
    room = _ROOM * (high - low)
    low, high = low - room, high + room
    limits = {splat_nodes.LIMIT: radius, splat_nodes.LOW: low.tolist(), splat_nodes.HIGH: high.tolist()}
    for name, value in limits.items():
        set_input(modifier, name, value)


def _add_modifier(obj: bpy.types.Object, name: str, group: bpy.types.GeometryNodeTree) -> bpy.types.Modifier:
    modifier = obj.modifiers.new(name, "NODES")
    modifier.node_group = group
    modifier.show_group_selector = False
    return modifier


def is_original(shown: bpy.types.Object, original: bpy.types.Object) -> bool:
    """Whether an object in a depsgraph is the capture itself and not the output of its Geometry Nodes: their points
    have another type, and what a user's nodes instance on them another mesh.
    """
    return shown.type == original.type and (shown.type != "MESH" or shown.data.name == original.data.name)


def write(obj: bpy.types.Object, gaussians: GaussianArrays) -> None:
    """Write ``gaussians`` to the object's mesh. Only a change of count or SH degree rebuilds the mesh."""
    mesh = obj.data
    invalidate(mesh)
    further = gaussians.sh.shape[1] - 1
    _fit(mesh, len(gaussians.means), further)
    for name, column in _columns(further).items():
        write_attribute(mesh, name, column_view(gaussians, column))
    mesh.update_tag()


def _columns(further: int) -> dict[str, str]:
    """By the names of attributes the columns of Gaussians with so many further SH coefficients."""
    return _COLUMNS | {f"radiance:sh_{k}": f"sh_{k + 1}" for k in range(further)}


def show(obj: bpy.types.Object, scene: ScenePlayer, time: float, part: Callable[[], FrameDelta]) -> None:
    """Write a scene's Gaussians at a time in [0, 1] to the object's mesh.

    What the mesh already holds is not written again: nothing at the same time, and only time-dependent attributes at
    another time of the same scene.

    Args:
        part: gives what ``scene.delta_at(time)`` does; called if there is something to write.
    """
    mesh = obj.data
    if getattr(mesh, "is_editmode", False):  # point clouds lack this attribute
        invalidate(mesh)  # Edit Mode may change its vertices
        return
    further = len(scene.columns) - len(_COLUMNS)
    shown, label = mesh.get(_SHOWN), _name_of(scene, time)
    whole = _fit(mesh, scene.count, further) or not (isinstance(shown, str) and shown.startswith(scene.token))
    if not whole and shown == label:
        return
    moving = part()
    invalidate(mesh)  # until all is written
    for name, column in _columns(further).items():
        if whole or column in moving:
            write_attribute(mesh, name, scene.column(column, moving))
    mesh[_SHOWN] = label
    mesh.update_tag()


def holds(obj: bpy.types.Object, scene: ScenePlayer, time: float) -> None:
    """Tells ``show`` that all of a scene's Gaussians at a time were written already."""
    obj.data[_SHOWN] = _name_of(scene, time)


def _name_of(scene: ScenePlayer, time: float) -> str:
    return f"{scene.token} {time!r}"


def invalidate(mesh: bpy.types.Mesh) -> None:
    """Makes ``show`` write everything again, whatever the mesh holds."""
    if _SHOWN in mesh and mesh.library is None:
        del mesh[_SHOWN]


def write_attribute(mesh: bpy.types.Mesh, name: str, values: np.ndarray) -> None:
    """Writes one attribute of a data-block: (N, width) float32."""
    attribute = mesh.attributes[name]  # fetched again: adding an attribute may reallocate the others
    # 1-D, float32, contiguous: the only form that Blender copies instead of reading value by value.
    flat = np.ascontiguousarray(values, dtype=np.float32).ravel()
    attribute.data.foreach_set(_VALUE_KEY[attribute.data_type], flat)


def read(obj: bpy.types.Object) -> dict[str, np.ndarray]:
    """The object's attributes as float32 arrays (N, width) by name, for tests and exporters."""
    attributes: dict[str, np.ndarray] = {}
    for name, attribute in obj.data.attributes.items():
        key = _VALUE_KEY.get(attribute.data_type)
        if key is None:
            continue
        width = 3 if attribute.data_type == "FLOAT_VECTOR" else 4
        values = np.empty(len(attribute.data) * width, dtype=np.float32)
        attribute.data.foreach_get(key, values)
        attributes[name] = values.reshape(-1, width)
    return attributes


def draw_in(where: Place, obj: bpy.types.Object, shown: bool) -> None:
    """Sets whether the Gaussians are drawn as an object: in renders of engines other than FROG, which always draws
    them, or in viewports, where the graphics card may draw them instead.

    Switches a modifier that leaves no geometry; without it a mesh's vertices would be seen.
    """
    switch, modifier = f"show_{where}", obj.modifiers.get(_MODIFIER)
    if modifier is not None:
        setattr(modifier, switch, shown)  # or it would be evaluated for nothing
    hiding, hidden = obj.modifiers.get(_HIDING), not shown
    if hiding is None and hidden:
        hiding = _add_modifier(obj, _HIDING, splat_nodes.nothing_group())
        hiding.show_viewport = hiding.show_render = False
    if hiding is not None:
        setattr(hiding, switch, hidden)
        if not (hiding.show_viewport or hiding.show_render):
            obj.modifiers.remove(hiding)


def is_drawn_in(where: Place, obj: bpy.types.Object) -> bool:
    """Whether the Gaussians are drawn as an object; see ``draw_in``."""
    hiding = obj.modifiers.get(_HIDING)
    return hiding is None or not getattr(hiding, f"show_{where}")


def clear(obj: bpy.types.Object) -> None:
    """Drop the geometry; ``write`` brings it back."""
    invalidate(obj.data)
    _resize(obj.data, 0)
    obj.data.update_tag()


def count(obj: bpy.types.Object) -> int:
    """Number of Gaussians that the object holds now."""
    return _size(obj.data)


def count_shown(obj: bpy.types.Object) -> int:
    """The same without those that are transparent, such as those that a crop leaves out at this frame alone."""
    base = obj.data.attributes.get("radiance:base")
    if base is None:
        return 0
    values = np.empty(4 * len(base.data), np.float32)
    base.data.foreach_get(_VALUE_KEY[base.data_type], values)
    return int(np.count_nonzero(values[3::4]))


def _size(data: Data) -> int:
    return len(data.vertices if isinstance(data, bpy.types.Mesh) else data.points)


def _resize(data: Data, size: int) -> None:
    """``size`` vertices or points without any attributes but their position."""
    if isinstance(data, bpy.types.Mesh):
        data.clear_geometry()
        data.vertices.add(size)
        return
    for name in [name for name in data.attributes.keys() if name != "position"]:  # noqa: SIM118
        data.attributes.remove(data.attributes[name])
    data.resize(size)


def _fit(data: Data, size: int, further: int) -> bool:
    """Make the data hold ``size`` Gaussians and ``further`` SH attributes; all exist before any is written.

    Returns whether anything of it is new, and so empty.
    """
    base = _BASE["MESH" if isinstance(data, bpy.types.Mesh) else "POINTCLOUD"]
    types = _FIXED | {"radiance:base": base} | {f"radiance:sh_{k}": "FLOAT_VECTOR" for k in range(further)}
    there = {name: attribute.data_type for name, attribute in data.attributes.items()}
    stray = [name for name in there if name.startswith("radiance:") and name not in types]
    is_new = _size(data) != size or bool(stray)
    if is_new:
        _resize(data, size)
        there = {}
    for name, kind in types.items():
        if name not in there:
            data.attributes.new(name, kind, "POINT")
            is_new = True
    return is_new
