"""A mesh for each frame of the timeline, by Geometry Nodes: no handler, so it plays, renders and exports anywhere."""

from __future__ import annotations

import bpy

from .node_builder import Builder, new_geometry_group

_GROUP = "FRoG Proxy Frames"
FRAMES, FIRST, COUNT = "Frames", "First Frame", "Frame Count"
"""Inputs: a collection whose objects, by their names, are the frames; the frame of the timeline, after Time Stretching,
that shows the first one; how many there are. Before and after them the first and the last are shown."""
STRETCH, FROM, UNTIL = "Time Stretching", "From", "Until"
"""Inputs: how many frames pass while Time Stretching has one pass; the first frame, after Time Stretching, at which
there is anything, and the first after that at which there is nothing."""
_INPUTS = {FRAMES: "Collection", FIRST: "Float", COUNT: "Int", STRETCH: "Float", FROM: "Float", UNTIL: "Float"}
_ROUNDING = 1e-3  # frames


def frames_group() -> bpy.types.GeometryNodeTree:
    """The Geometry Nodes group, made once per file: joins the frame of the timeline to an object's own mesh."""
    for known in bpy.data.node_groups:  # one that a user has changed may not do
        if known.name.startswith(_GROUP) and known.library is None and plays_frames(known):
            return known
    group = new_geometry_group(_GROUP)
    for name, kind in _INPUTS.items():
        group.interface.new_socket(name, in_out="INPUT", socket_type=f"NodeSocket{kind}")
    build = Builder(group)
    source, result = build.node("NodeGroupInput"), build.node("NodeGroupOutput")
    frames = build.node("GeometryNodeCollectionInfo")
    build.link(source.outputs[FRAMES], frames.inputs["Collection"])
    frames.inputs["Separate Children"].default_value = frames.inputs["Reset Children"].default_value = True
    now = build.node("GeometryNodeInputSceneTime").outputs["Frame"]
    passed = build.math("MULTIPLY", build.math("SUBTRACT", now, source.outputs[FIRST]), source.outputs[STRETCH])
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
    begun = build.math("GREATER_THAN", build.math("ADD", now, _ROUNDING), source.outputs[FROM])
    ended = build.math("LESS_THAN", build.math("ADD", now, _ROUNDING), source.outputs[UNTIL])
    limited = build.node("GeometryNodeSwitch")
    limited.input_type = "GEOMETRY"
    build.link(build.math("MULTIPLY", begun, ended), limited.inputs["Switch"])
    build.link(joined.outputs[0], limited.inputs["True"])
    build.link(limited.outputs[0], result.inputs[0])
    build.arrange()
    return group


def plays_frames(group: bpy.types.NodeTree | None) -> bool:
    """Whether a group, if there is one, has the inputs of that which plays frames."""
    return group is not None and all(name in group.interface.items_tree for name in _INPUTS)
