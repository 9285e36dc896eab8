"""Gaussians -> a Blender datablock that every render engine can draw.

Blender 5.3 draws Gaussian splats itself: there the Gaussians live in a point cloud of that type.  Before 5.3, and where
Blender refuses one, they are the vertices of a Mesh that Geometry Nodes turn into points (``splat_nodes``).

Attributes are named as those of 5.3 in both: ``position``, ``scale`` (linear), ``rotation`` (w, x, y, z),
``radiance:base`` (first SH coefficient and opacity) and ``radiance:sh_0`` ... (one per further SH coefficient).
Nothing outside this file knows attribute types.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np

from .nodes import ellipsoid_nodes, splat_nodes

if TYPE_CHECKING:
    from .engine.gaussians import GaussianArrays
    from .engine.playback.frame_delta import FrameDelta
    from .engine.playback.player import ScenePlayer

TYPES = ("MESH", "POINTCLOUD")
"""Of objects that can carry Gaussians, whatever Blender made the file that they are in."""
DATA_TYPES = (bpy.types.Mesh, bpy.types.PointCloud)
_MODIFIER = "Gaussians as points"
_HIDING = "Hidden in renders"
_SPLATS = "GAUSSIAN_SPLAT"  # Blender 5.3's type of a point cloud
_VALUE_KEY = {"FLOAT_VECTOR": "vector", "QUATERNION": "value", "FLOAT4": "vector", "FLOAT_COLOR": "color"}
_FIXED = {"scale": "FLOAT_VECTOR", "rotation": "QUATERNION"}
_BASE = {"MESH": "FLOAT_COLOR", "POINTCLOUD": "FLOAT4"}
# radiance:base is a FLOAT4 in Blender 5.3.  Before 5.2 that type does not exist, and no version's Mesh to Points and
# Attribute nodes are promised to carry it, while FLOAT_COLOR (four floats, never converted) works in all of them.

_COLUMNS = {"position": "means", "scale": "scales", "rotation": "quaternions", "radiance:base": "base"}
_SHOWN = "frog_shown"
"""A custom property of the mesh that says whose Gaussians at which time it holds.  What undo, copying or loading brings
back of the mesh brings it back as well, so that it is always right; see ``show`` for what it saves."""


def draws_splats() -> bool:
    """Whether this Blender draws Gaussian splats itself."""
    kind = bpy.types.PointCloud.bl_rna.properties.get("type")
    return kind is not None and _SPLATS in kind.enum_items.keys()  # noqa: SIM118


def create(name: str, gaussians: GaussianArrays) -> Any:
    """A new object that carries ``gaussians``, with its nodes and material, linked to no collection yet."""
    if draws_splats():
        cloud = bpy.data.pointclouds.new(name)
        try:
            make_splats(cloud)
            obj = bpy.data.objects.new(name, cloud)
            write(obj, gaussians)
        except (AttributeError, KeyError, RuntimeError, TypeError, ValueError) as error:
            print(f"FRoG: Blender's own splats cannot be used ({error}); points stand in for them.", file=sys.stderr)
            bpy.data.pointclouds.remove(cloud)  # and the object that has it
        else:
            return obj
    mesh = bpy.data.meshes.new(name)
    obj = bpy.data.objects.new(name, mesh)
    mesh.materials.append(splat_nodes.material())
    _add_modifier(obj, _MODIFIER, splat_nodes.points_group())
    write(obj, gaussians)
    return obj


def make_splats(cloud: Any) -> None:
    """Makes a point cloud one of Gaussian splats; AttributeError or TypeError where Blender knows none."""
    cloud.type = _SPLATS


def _add_modifier(obj: Any, name: str, group: Any) -> Any:
    modifier = obj.modifiers.new(name, "NODES")
    modifier.node_group = group
    modifier.show_group_selector = False
    return modifier


def is_original(shown: Any, original: Any) -> bool:
    """Whether an object that Blender lists is a carrier itself, not what Geometry Nodes make of it: they list points of
    a mesh as another type, and ellipsoids under the name of another mesh."""
    return shown.type == original.type and (shown.type != "MESH" or shown.data.name == original.data.name)


def display(obj: Any, kind: str) -> None:
    """Shows the Gaussians as "POINTS" (soft splats, by the material or by Blender) or as solid "ELLIPSOIDS"."""
    modifier = obj.modifiers.get(_MODIFIER)
    if obj.type == "POINTCLOUD":
        if kind == "POINTS" and modifier is not None:
            obj.modifiers.remove(modifier)
        elif kind == "ELLIPSOIDS" and modifier is None:
            _add_modifier(obj, _MODIFIER, ellipsoid_nodes.ellipsoids_group())
    elif modifier is not None:
        groups = {"POINTS": splat_nodes.points_group, "ELLIPSOIDS": ellipsoid_nodes.ellipsoids_group}
        modifier.node_group = groups[kind]()


def write(obj: Any, gaussians: GaussianArrays) -> None:
    """Put ``gaussians`` into the object's mesh; only a change of count or SH degree rebuilds the mesh."""
    mesh = obj.data
    invalidate(mesh)
    further = gaussians.sh.shape[1] - 1
    _fit(mesh, len(gaussians.means), further)
    base = np.concatenate([gaussians.sh[:, 0], gaussians.opacities[:, None]], axis=1)
    columns = {
        "position": gaussians.means,
        "scale": gaussians.scales,
        "rotation": gaussians.quaternions,
        "radiance:base": base,
    }
    columns |= {f"radiance:sh_{k}": gaussians.sh[:, k + 1] for k in range(further)}
    for name, values in columns.items():
        write_attribute(mesh, name, values)
    mesh.update_tag()


def show(obj: Any, scene: ScenePlayer, time: float, part: Callable[[], FrameDelta]) -> None:
    """Put a scene's Gaussians at a time in [0, 1] into the object's mesh.

    What the mesh holds already is not written again: nothing for the same moment, and only what changes in time for
    another moment of the same scene.

    Args:
        part: gives what ``scene.delta_at(time)`` does; called if there is something to write.
    """
    mesh = obj.data
    if getattr(mesh, "is_editmode", False):  # point clouds have none to tell
        invalidate(mesh)  # its vertices are elsewhere, and may come back as others
        return
    further = len(scene.columns) - len(_COLUMNS)
    shown, wanted = mesh.get(_SHOWN), f"{scene.token} {time!r}"
    whole = _fit(mesh, scene.count, further) or not (isinstance(shown, str) and shown.startswith(scene.token))
    if not whole and shown == wanted:
        return
    columns = _COLUMNS | {f"radiance:sh_{k}": f"sh_{k + 1}" for k in range(further)}
    moving = part()
    invalidate(mesh)  # until all is written
    for name, column in columns.items():
        if whole or column in moving.columns:
            write_attribute(mesh, name, scene.column(column, moving))
    mesh[_SHOWN] = wanted
    mesh.update_tag()


def invalidate(mesh: Any) -> None:
    """Whatever the mesh holds, ``show`` is to write all of it again."""
    if _SHOWN in mesh and mesh.library is None:
        del mesh[_SHOWN]


def write_attribute(mesh: Any, name: str, values: np.ndarray) -> None:
    """Writes one attribute of a datablock: (N, width) float32, whatever it held."""
    attribute = mesh.attributes[name]  # fetched anew: adding an attribute may move the others
    # 1-D, float32, contiguous: the only form that Blender copies instead of reading value by value.
    flat = np.ascontiguousarray(values, dtype=np.float32).ravel()
    attribute.data.foreach_set(_VALUE_KEY[attribute.data_type], flat)


def read(obj: Any) -> dict[str, np.ndarray]:
    """What the object carries: float32 arrays (N, width) by attribute name, for tests and exporters."""
    found: dict[str, np.ndarray] = {}
    for name, attribute in obj.data.attributes.items():
        key = _VALUE_KEY.get(attribute.data_type)
        if key is None:
            continue
        width = 3 if attribute.data_type == "FLOAT_VECTOR" else 4
        values = np.empty(len(attribute.data) * width, dtype=np.float32)
        attribute.data.foreach_get(key, values)
        found[name] = values.reshape(-1, width)
    return found


def draw_in_renders(obj: Any, shown: bool) -> None:
    """Whether other engines than FROG draw the Gaussians in their renders; FROG always does."""
    if obj.type == "POINTCLOUD":
        hiding = obj.modifiers.get(_HIDING)
        if shown and hiding is not None:
            obj.modifiers.remove(hiding)
        elif not shown and hiding is None:
            _add_modifier(obj, _HIDING, splat_nodes.nothing_group()).show_viewport = False
        return
    modifier = obj.modifiers.get(_MODIFIER)
    if modifier is not None:
        modifier.show_render = shown


def is_drawn_in_renders(obj: Any) -> bool:
    """Whether other engines than FROG draw the Gaussians in their renders: see ``draw_in_renders``."""
    if obj.type == "POINTCLOUD":
        return obj.modifiers.get(_HIDING) is None
    modifier = obj.modifiers.get(_MODIFIER)
    return modifier is None or modifier.show_render


def clear(obj: Any) -> None:
    """Drop the geometry; ``write`` brings it back."""
    invalidate(obj.data)
    _resize(obj.data, 0)
    obj.data.update_tag()


def count(obj: Any) -> int:
    """How many Gaussians the object carries now."""
    return _size(obj.data)


def _size(data: Any) -> int:
    return len(data.vertices if isinstance(data, bpy.types.Mesh) else data.points)


def _resize(data: Any, wanted: int) -> None:
    """``wanted`` vertices or points without any attributes but their position."""
    if isinstance(data, bpy.types.Mesh):
        data.clear_geometry()
        data.vertices.add(wanted)
        return
    for name in [name for name in data.attributes.keys() if name != "position"]:  # noqa: SIM118
        data.attributes.remove(data.attributes[name])
    data.resize(wanted)


def _fit(data: Any, wanted: int, further: int) -> bool:
    """Make the data hold ``wanted`` Gaussians and ``further`` SH attributes; all exist before any is written.

    Returns whether anything of it is new, and so empty.
    """
    base = _BASE["MESH" if isinstance(data, bpy.types.Mesh) else "POINTCLOUD"]
    types = _FIXED | {"radiance:base": base} | {f"radiance:sh_{k}": "FLOAT_VECTOR" for k in range(further)}
    there = {name: attribute.data_type for name, attribute in data.attributes.items()}
    stray = [name for name in there if name.startswith("radiance:") and name not in types]
    is_new = _size(data) != wanted or bool(stray)
    if is_new:
        _resize(data, wanted)
        there = {}
    for name, kind in types.items():
        if name not in there:
            data.attributes.new(name, kind, "POINT")
            is_new = True
    return is_new
