"""Gaussians -> a Blender datablock that every render engine can draw.

A point cloud would be the natural carrier, but before 5.1 Blender cannot resize one, so the Gaussians live in a Mesh of
vertices that Geometry Nodes turn into points (``splat_nodes``).  Attributes are named as Blender 5.3's own splats:
``position``, ``scale`` (linear), ``rotation`` (w, x, y, z), ``radiance:base`` (first SH coefficient and opacity) and
``radiance:sh_0`` ... (one per further SH coefficient).  Nothing outside this file knows attribute types.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np

from . import ellipsoid_nodes, splat_nodes

if TYPE_CHECKING:
    from .engine.inference.moving_part import MovingPart
    from .engine.inference.scene import PlayableScene
    from .engine.rasterizer.arrays import GaussianArrays

_MODIFIER = "Gaussians as points"
_VALUE_KEY = {"FLOAT_VECTOR": "vector", "QUATERNION": "value", "FLOAT4": "vector", "FLOAT_COLOR": "color"}
_FIXED = {"scale": "FLOAT_VECTOR", "rotation": "QUATERNION", "radiance:base": "FLOAT_COLOR"}
# radiance:base is a FLOAT4 in Blender 5.3.  Before 5.2 that type does not exist, and no version's Mesh to Points and
# Attribute nodes are promised to carry it, while FLOAT_COLOR (four floats, never converted) works in all of them.


_COLUMNS = {"position": "means", "scale": "scales", "rotation": "quaternions", "radiance:base": "base"}
_SHOWN = "frog_shown"
"""A custom property of the mesh that says whose Gaussians at which time it holds.  What undo, copying or loading brings
back of the mesh brings it back as well, so that it is always right; see ``show`` for what it saves."""


def create(name: str, gaussians: GaussianArrays) -> Any:
    """A new object that carries ``gaussians``, with its nodes and material, linked to no collection yet."""
    mesh = bpy.data.meshes.new(name)
    obj = bpy.data.objects.new(name, mesh)
    mesh.materials.append(splat_nodes.material())
    modifier = obj.modifiers.new(_MODIFIER, "NODES")
    modifier.node_group = splat_nodes.points_group()
    modifier.show_group_selector = False
    write(obj, gaussians)
    return obj


def display(obj: Any, kind: str) -> None:
    """Shows the Gaussians as "POINTS" that the material turns into soft splats, or as solid "ELLIPSOIDS"."""
    modifier = obj.modifiers.get(_MODIFIER)
    if modifier is not None:
        groups = {"POINTS": splat_nodes.points_group, "ELLIPSOIDS": ellipsoid_nodes.ellipsoids_group}
        modifier.node_group = groups[kind]()


def write(obj: Any, gaussians: GaussianArrays) -> None:
    """Put ``gaussians`` into the object's mesh; only a change of count or SH degree rebuilds the mesh."""
    mesh = obj.data
    distrust(mesh)
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
        _set(mesh, name, values)
    mesh.update_tag()


def show(obj: Any, scene: PlayableScene, time: float, part: Callable[[], MovingPart]) -> None:
    """Put a scene's Gaussians at a time in [0, 1] into the object's mesh.

    What the mesh holds already is not written again: nothing for the same moment, and only what changes in time for
    another moment of the same scene.

    Args:
        part: gives what ``scene.part_at(time)`` does; called if there is something to write.
    """
    mesh = obj.data
    if mesh.is_editmode:
        distrust(mesh)  # its vertices are elsewhere, and may come back as others
        return
    further = len(scene.columns) - len(_COLUMNS)
    shown, wanted = mesh.get(_SHOWN), f"{scene.token} {time!r}"
    whole = _fit(mesh, scene.count, further) or not (isinstance(shown, str) and shown.startswith(scene.token))
    if not whole and shown == wanted:
        return
    columns = _COLUMNS | {f"radiance:sh_{k}": f"sh_{k + 1}" for k in range(further)}
    moving = part()
    distrust(mesh)  # until all is written
    for name, column in columns.items():
        if whole or column in moving.columns:
            _set(mesh, name, scene.column(column, moving))
    mesh[_SHOWN] = wanted
    mesh.update_tag()


def distrust(mesh: Any) -> None:
    """Whatever the mesh holds, ``show`` is to write all of it again."""
    if _SHOWN in mesh and mesh.library is None:
        del mesh[_SHOWN]


def _set(mesh: Any, name: str, values: np.ndarray) -> None:
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
    """Whether other engines than FROG draw the Gaussians as points in their renders; FROG always does."""
    modifier = obj.modifiers.get(_MODIFIER)
    if modifier is not None:
        modifier.show_render = shown


def clear(obj: Any) -> None:
    """Drop the geometry; ``write`` brings it back."""
    distrust(obj.data)
    obj.data.clear_geometry()
    obj.data.update_tag()


def count(obj: Any) -> int:
    """How many Gaussians the object carries now."""
    return len(obj.data.vertices)


def _fit(mesh: Any, wanted: int, further: int) -> bool:
    """Make the mesh hold ``wanted`` vertices and ``further`` SH attributes; all exist before any is written.

    Returns whether anything of it is new, and so empty.
    """
    types = _FIXED | {f"radiance:sh_{k}": "FLOAT_VECTOR" for k in range(further)}
    there = {name: attribute.data_type for name, attribute in mesh.attributes.items()}
    stray = [name for name in there if name.startswith("radiance:") and name not in types]
    is_new = len(mesh.vertices) != wanted or bool(stray)
    if is_new:
        mesh.clear_geometry()
        mesh.vertices.add(wanted)
        there = {}
    for name, kind in types.items():
        if name not in there:
            mesh.attributes.new(name, kind, "POINT")
            is_new = True
    return is_new
