"""The Geometry Nodes and the material that draw a point cloud's Gaussians in Cycles and EEVEE.

Geometry Nodes turn each vertex into a point whose sphere holds the Gaussian out to three standard deviations, and store
the rows of A = inverse(rotation * scale) and the centre.  The material evaluates the Gaussian along the ray that hit
the sphere: with p = A (hit - centre) and v = A ray / |A ray| the closest approach is d2 = |p|2 - (p . v)2, and the
point's alpha is opacity * exp(-d2 / 2).  Only the base colour is shown; the FROG engine draws the view-dependent part.

In viewports points are no larger than the modifier's ``LIMIT``: a few Gaussians reach farther than the whole scene, and
as spheres they would hide it, enlarge its bounding box and slow down every redraw. Those that lie outside ``LOW`` to
``HIGH`` are left out there, so that the bounding box is that of what one sees.
"""

from typing import Any

from ..engine.spherical_harmonics import SH_DC
from .node_builder import Builder, made_once

_RADIUS = 3.0  # standard deviations that a point's sphere reaches
LIMIT = "Largest Radius in Viewports"
"""The group's input: the largest radius of a point in a viewport, in the object's units; 0 for no limit."""
LOW, HIGH = "Lowest Corner in Viewports", "Highest Corner in Viewports"
"""The group's inputs: a box that points of a viewport lie in, in the object's units; none where it is empty."""
_SMALLEST = 1e-8  # scale below which a Gaussian is treated as flat, world units


@made_once("node_groups", "FRoG Gaussians as Near Points")
def points_group(build: Builder) -> None:
    """The Geometry Nodes group."""
    limit = build.tree.interface.new_socket(LIMIT, in_out="INPUT", socket_type="NodeSocketFloat")
    limit.subtype, limit.min_value, limit.default_value = "DISTANCE", 0.0, 0.0
    for name in (LOW, HIGH):
        build.tree.interface.new_socket(name, in_out="INPUT", socket_type="NodeSocketVector")
    source = build.node("NodeGroupInput").outputs

    scale = build.named("scale", "FLOAT_VECTOR")
    rotation = build.named("rotation", "QUATERNION")
    safe = build.vector("MAXIMUM", scale, (_SMALLEST,) * 3)
    x, y, z = build.separate(safe)
    largest = build.math("MAXIMUM", build.math("MAXIMUM", x, y), z)

    far = {"Geometry": source[0], "Selection": _outside(build, source[LOW], source[HIGH])}
    near = build.out("GeometryNodeDeleteGeometry", far)
    radius = _limited(build, build.math("MULTIPLY", largest, _RADIUS), source[LIMIT])
    geometry = build.out("GeometryNodeMeshToPoints", {"Mesh": near, "Radius": radius})
    # Row i of A is the Gaussian's i-th axis divided by its scale.  Stored after Mesh to Points, so on the points alone.
    for i, size in enumerate((x, y, z)):
        axis = {"Vector": tuple(float(i == j) for j in range(3)), "Rotation": rotation}
        row = build.vector("DIVIDE", build.out("FunctionNodeRotateVector", axis), size)
        geometry = build.store(geometry, f"frog_row_{i}", row)
    geometry = build.store(geometry, "frog_center", build.out("GeometryNodeInputPosition"))
    shown = build.out("GeometryNodeSetMaterial", {"Geometry": geometry, "Material": material()})
    build.node("NodeGroupOutput", {0: shown})


def _limited(build: Builder, radius: Any, limit: Any) -> Any:
    """The radius, in viewports at most ``limit`` unless that is 0."""
    applies = build.math("MULTIPLY", build.out("GeometryNodeIsViewport"), build.math("GREATER_THAN", limit, 0.0))
    smaller = build.math("SUBTRACT", radius, build.math("MINIMUM", radius, limit))
    return build.math("SUBTRACT", radius, build.math("MULTIPLY", applies, smaller))


def _outside(build: Builder, low: Any, high: Any) -> Any:
    """1 for points of a viewport that lie outside a box, otherwise 0."""
    position = build.out("GeometryNodeInputPosition")
    inside = build.vector("MINIMUM", build.vector("MAXIMUM", position, low), high)
    is_outside = build.math("GREATER_THAN", build.vector("DISTANCE", position, inside), 0.0)
    has_box = build.math("GREATER_THAN", build.vector("DISTANCE", low, high), 0.0)
    applies = build.math("MULTIPLY", build.out("GeometryNodeIsViewport"), has_box)
    return build.math("MULTIPLY", applies, is_outside)


@made_once("node_groups", "FRoG Nothing")
def nothing_group(build: Builder) -> None:
    """A Geometry Nodes group that outputs empty geometry."""
    build.node("NodeGroupInput")
    build.node("NodeGroupOutput")


@made_once("materials", "FRoG Gaussians")
def material(build: Builder) -> None:
    """The material."""
    surface = build.node("ShaderNodeNewGeometry")
    center, _ = build.attribute("frog_center")
    offset = build.vector("SUBTRACT", build.to_object(surface.outputs["Position"], "POINT"), center)
    ray = build.to_object(surface.outputs["Incoming"], "VECTOR")
    rows = [build.attribute(f"frog_row_{i}")[0] for i in range(3)]
    p = build.combine(*(build.vector("DOT_PRODUCT", row, offset) for row in rows))
    v = build.vector("NORMALIZE", build.combine(*(build.vector("DOT_PRODUCT", row, ray) for row in rows)))
    along = build.vector("DOT_PRODUCT", p, v)
    square = build.math("SUBTRACT", build.vector("DOT_PRODUCT", p, p), build.math("MULTIPLY", along, along))
    falloff = build.math("EXPONENT", build.math("MULTIPLY", square, -0.5))

    base, opacity = build.attribute("radiance:base")
    front = build.math("SUBTRACT", 1.0, surface.outputs["Backfacing"])
    alpha = build.math("MULTIPLY", build.math("MULTIPLY", opacity, falloff), front)

    glow = build.out("ShaderNodeEmission", {"Color": _display_color(build, base)})
    mixed = build.out("ShaderNodeMixShader", {0: alpha, 1: build.out("ShaderNodeBsdfTransparent"), 2: glow})
    build.node("ShaderNodeOutputMaterial", {"Surface": mixed})


def _display_color(build: Builder, base: Any) -> Any:
    """Scene-linear colour of a first SH coefficient, in a shader."""
    display = build.vector("MULTIPLY_ADD", base, (SH_DC,) * 3, (0.5,) * 3)
    return build.combine(*(_to_linear(build, channel) for channel in build.separate(display)))


def _to_linear(build: Builder, channel: Any) -> Any:
    """Display-referred sRGB to scene-linear, for one channel."""
    value = build.math("MAXIMUM", channel, 0.0)
    low = build.math("DIVIDE", value, 12.92)
    high = build.math("POWER", build.math("DIVIDE", build.math("ADD", value, 0.055), 1.055), 2.4)
    is_high = build.math("GREATER_THAN", value, 0.04045)
    return build.math("MULTIPLY_ADD", is_high, build.math("SUBTRACT", high, low), low)
