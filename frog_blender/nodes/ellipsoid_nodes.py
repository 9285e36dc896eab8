"""Gaussians as solid ellipsoids, one instance each, to inspect a scene and to use in Geometry Nodes.

An instance's location, rotation and scale are the Gaussian's own; the sphere that is instanced has a radius of
``RADIUS`` standard deviations. Gaussians that are too transparent to be drawn as splats have none.
"""

from __future__ import annotations

import bpy

from ..engine.native.options import ALPHA_MIN
from .node_builder import Builder, new_geometry_group, new_material
from .splat_nodes import display_color

_GROUP, _MATERIAL = "FRoG Gaussians as Ellipsoids", "FRoG Ellipsoids"
MOST = 50_000
"""The largest number of Gaussians for which Blender still scrubs instances smoothly."""
RADIUS = 1.5


def ellipsoids_group() -> bpy.types.GeometryNodeTree:
    """The Geometry Nodes group, made once per file."""
    group = bpy.data.node_groups.get(_GROUP)
    if group is not None:
        return group
    group = new_geometry_group(_GROUP)
    build = Builder(group)
    source, result = build.node("NodeGroupInput"), build.node("NodeGroupOutput")
    sphere = build.node("GeometryNodeMeshIcoSphere")
    sphere.inputs["Radius"].default_value, sphere.inputs["Subdivisions"].default_value = RADIUS, 2
    set_material = build.node("GeometryNodeSetMaterial")
    set_material.inputs["Material"].default_value = material()
    build.link(sphere.outputs["Mesh"], set_material.inputs["Geometry"])
    instances = build.node("GeometryNodeInstanceOnPoints")
    build.link(source.outputs[0], instances.inputs["Points"])
    build.link(set_material.outputs[0], instances.inputs["Instance"])
    base = build.node("FunctionNodeSeparateColor")
    build.link(build.named("radiance:base", "FLOAT_COLOR"), base.inputs["Color"])
    seen = build.node("FunctionNodeCompare")
    seen.data_type, seen.operation = "FLOAT", "GREATER_EQUAL"
    build.link(base.outputs["Alpha"], seen.inputs["A"])
    seen.inputs["B"].default_value = ALPHA_MIN
    build.link(seen.outputs["Result"], instances.inputs["Selection"])
    build.link(build.named("rotation", "QUATERNION"), instances.inputs["Rotation"])
    build.link(build.named("scale", "FLOAT_VECTOR"), instances.inputs["Scale"])
    build.link(instances.outputs[0], result.inputs[0])
    build.arrange()
    return group


def material() -> bpy.types.Material:
    """An emission material of the Gaussians' base colors; created once per file."""
    found = bpy.data.materials.get(_MATERIAL)
    if found is not None:
        return found
    made = new_material(_MATERIAL)
    build = Builder(made.node_tree)
    base, _ = build.attribute("radiance:base", "INSTANCER")
    glow, output = build.node("ShaderNodeEmission"), build.node("ShaderNodeOutputMaterial")
    build.link(display_color(build, base), glow.inputs["Color"])
    build.link(glow.outputs[0], output.inputs["Surface"])
    build.arrange()
    return made
