"""Gaussians as solid ellipsoids, one instance each, to inspect a scene and to use in Geometry Nodes.

An instance's location, rotation and scale are the Gaussian's own; the sphere that is instanced has a radius of
``RADIUS`` standard deviations. Gaussians that are too transparent to be drawn as splats have none.
"""

from ..engine.native.options import ALPHA_MIN
from .node_builder import Builder, made_once
from .splat_nodes import display_color

MOST = 50_000
"""The largest number of Gaussians for which Blender still scrubs instances smoothly."""
RADIUS = 1.5


@made_once("node_groups", "FRoG Gaussians as Ellipsoids")
def ellipsoids_group(build: Builder) -> None:
    """The Geometry Nodes group."""
    source = build.node("NodeGroupInput")
    sphere = build.out("GeometryNodeMeshIcoSphere", {"Radius": RADIUS, "Subdivisions": 2})
    base = build.node("FunctionNodeSeparateColor", {"Color": build.named("radiance:base", "FLOAT_COLOR")})
    seen = {"A": base.outputs["Alpha"], "B": ALPHA_MIN}
    instances = {
        "Points": source.outputs[0],
        "Instance": build.out("GeometryNodeSetMaterial", {"Geometry": sphere, "Material": material()}),
        "Selection": build.out("FunctionNodeCompare", seen, data_type="FLOAT", operation="GREATER_EQUAL"),
        "Rotation": build.named("rotation", "QUATERNION"),
        "Scale": build.named("scale", "FLOAT_VECTOR"),
    }
    build.node("NodeGroupOutput", {0: build.out("GeometryNodeInstanceOnPoints", instances)})


@made_once("materials", "FRoG Ellipsoids")
def material(build: Builder) -> None:
    """An emission material of the Gaussians' base colors."""
    base, _ = build.attribute("radiance:base", "INSTANCER")
    glow = build.out("ShaderNodeEmission", {"Color": display_color(build, base)})
    build.node("ShaderNodeOutputMaterial", {"Surface": glow})
