"""A mesh for each frame of the timeline, by Geometry Nodes: no handler, so it plays, renders and exports anywhere."""

from __future__ import annotations

import bpy

from .node_builder import Builder, new_geometry_group

_GROUP = "FRoG Proxy Frames"
FRAMES, FIRST, COUNT = "Frames", "First Frame", "Frame Count"
"""Inputs: a collection whose objects, by their names, are the frames; the frame of the timeline that shows the first
one; how many there are. Before and after them the first and the last are shown."""


def frames_group() -> bpy.types.GeometryNodeTree:
    """The Geometry Nodes group, made once per file: joins the frame of the timeline to an object's own mesh."""
    group = bpy.data.node_groups.get(_GROUP)
    if group is not None:
        return group
    group = new_geometry_group(_GROUP)
    for name, kind in ((FRAMES, "Collection"), (FIRST, "Int"), (COUNT, "Int")):
        group.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
    build = Builder(group)
    source, result = build.node("NodeGroupInput"), build.node("NodeGroupOutput")
    frames = build.node("GeometryNodeCollectionInfo")
    build.link(source.outputs[FRAMES], frames.inputs["Collection"])
    frames.inputs["Separate Children"].default_value = frames.inputs["Reset Children"].default_value = True
    passed = build.math("SUBTRACT", build.node("GeometryNodeInputSceneTime").outputs["Frame"], source.outputs[FIRST])
    latest = build.math("SUBTRACT", source.outputs[COUNT], 1.0)
    index = build.math("MAXIMUM", build.math("MINIMUM", build.math("ROUND", passed), latest), 0.0)
    instance = build.node("GeometryNodeInstanceOnPoints")
    build.link(build.node("GeometryNodePoints").outputs[0], instance.inputs["Points"])
    build.link(frames.outputs[0], instance.inputs["Instance"])
    instance.inputs["Pick Instance"].default_value = True
    build.link(index, instance.inputs["Instance Index"])
    shown, joined = build.node("GeometryNodeRealizeInstances"), build.node("GeometryNodeJoinGeometry")
    build.link(instance.outputs[0], shown.inputs[0])
    build.link(shown.outputs[0], joined.inputs[0])
    build.link(source.outputs[0], joined.inputs[0])
    build.link(joined.outputs[0], result.inputs[0])
    build.arrange()
    return group
