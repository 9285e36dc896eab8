"""Captures among the user's own objects: two scenes of the same objects, one for each engine, put together by F12.

The user's scene is rendered by Cycles or EEVEE. A second one, linked to the same collections, is rendered by FROG on a
transparent film, with splats that end where an object hides them (see holdout.py). The compositor lays it over the
first; Blender renders both when the first is rendered.
"""

# mypy: disable-error-code="valid-type"

from typing import Any

import bpy
from bpy.props import EnumProperty

from .. import carrier, playback

_LABEL = "FRoG"  # of the nodes that this file makes
_TAKEN_OVER = (
    *("resolution_x", "resolution_y", "resolution_percentage", "pixel_aspect_x", "pixel_aspect_y", "fps", "fps_base"),
    *("use_border", "use_crop_to_border", "border_min_x", "border_max_x", "border_min_y", "border_max_y"),
    *("frame_map_old", "frame_map_new", "use_motion_blur", "motion_blur_shutter", "motion_blur_position"),
)


class FROG_OT_compose(bpy.types.Operator):
    """Render your own objects with Cycles or EEVEE and the captures with FRoG, each hiding what is behind it, in one
    picture. Run it again after adding collections or changing the render settings"""

    bl_idname = "frog.compose"
    bl_label = "Render With My Objects"
    bl_options = {"REGISTER", "UNDO"}

    engine: EnumProperty(
        name="Objects",
        description="What renders the objects that are no captures",
        items=(
            ("CYCLES", "Cycles", "Path tracing: soft light and shadows, slow"),
            ("EEVEE", "EEVEE", "Rasterization: fast, needs a graphics card"),
        ),
        default="CYCLES",
    )

    @classmethod
    def poll(cls, context: Any) -> bool:
        is_splats = _is_splats(context.scene)
        asked = "Use it in the scene of your objects, or turn Hold Out off." if is_splats else "Import a capture first."
        cls.poll_message_set(asked)
        return not is_splats and next(playback.captures(context.scene.objects), None) is not None

    def execute(self, context: Any) -> set[str]:
        scene = context.scene
        layers = _splat_layers(scene)
        splats = _splat_scene(scene, layers.scene)
        layers.scene, layers.label = splats, splats.name
        scene.render.engine = _engine_name(self.engine)
        for obj in playback.captures(scene.objects):
            carrier.draw_in_renders(obj, False)
        self.report({"INFO"}, f"F12 in {scene.name} now renders {splats.name} as well and puts them together.")
        return {"FINISHED"}


def _engine_name(engine: str) -> str:
    """EEVEE had another name from 4.2 to 4.5."""
    if engine != "EEVEE":
        return engine
    known = bpy.types.RenderSettings.bl_rna.properties["engine"].enum_items.keys()
    return next((name for name in ("BLENDER_EEVEE_NEXT", "BLENDER_EEVEE") if name in known), "BLENDER_EEVEE")


def _is_splats(scene: Any) -> bool:
    return scene.frog.hold_out and scene.render.engine == "FROG"


def _splat_scene(scene: Any, composed: Any) -> Any:
    """The scene of the captures, made or brought up to date: the same objects, camera, time and picture size.

    Args:
        composed: the scene that the compositor reads now, which is the one if it is of captures, whatever its name.
    """
    name = f"{scene.name} FRoG"
    named = composed, bpy.data.scenes.get(name)
    known = (found for found in named if found is not None and _is_splats(found) and _is_of(found, scene))
    splats = next(known, None) or bpy.data.scenes.new(name)
    splats.frog.composed_with = scene
    for mine, theirs in (
        (splats.collection.children, scene.collection.children),
        (splats.collection.objects, scene.collection.objects),
    ):
        for item in set(mine) - set(theirs):
            mine.unlink(item)
        for item in set(theirs) - set(mine):
            mine.link(item)
    splats.camera, splats.world = scene.camera, scene.world
    splats.frame_start, splats.frame_end = scene.frame_start, scene.frame_end
    for setting in _TAKEN_OVER:
        setattr(splats.render, setting, getattr(scene.render, setting))
    splats.render.engine, splats.render.film_transparent, splats.frog.hold_out = "FROG", True, True
    splats.timeline_markers.clear()
    for marker in scene.timeline_markers:
        if marker.camera is not None:  # the timeline switches to it
            splats.timeline_markers.new(marker.name, frame=marker.frame).camera = marker.camera
    layer = splats.view_layers[0]
    layer.update()  # a new scene's has no collections before (Blender 5.2)
    _take_over_collections(layer.layer_collection, scene.view_layers[0].layer_collection)
    return splats


def _is_of(splats: Any, scene: Any) -> bool:
    """Whether a scene of captures is this scene's: the compositor of a copy still reads the original's."""
    return splats.frog.composed_with in (None, scene)


def _take_over_collections(mine: Any, theirs: Any) -> None:
    """What is excluded or holds out in the user's first view layer does so here."""
    for child in mine.children:
        like = theirs.children.get(child.name)
        if like is not None:
            child.exclude, child.holdout, child.indirect_only = like.exclude, like.holdout, like.indirect_only
            _take_over_collections(child, like)


def _splat_layers(scene: Any) -> Any:
    """The Render Layers node whose picture lies over what the scene's compositor shows besides, made where there is
    none."""
    tree, output = _compositor(scene)
    over = next((node for node in tree.nodes if node.label == _LABEL and node.type == "ALPHAOVER"), None)
    if over is None:
        target = output.inputs["Image"]
        shown = target.links[0].from_socket if target.is_linked else _layers(tree, scene).outputs["Image"]
        over = tree.nodes.new("CompositorNodeAlphaOver")
        over.label = _LABEL
        tree.links.new(shown, _images(over)[0])
        tree.links.new(over.outputs[0], target)
    above = _images(over)[1]
    layers = next((node for node in _before(above) if node.type == "R_LAYERS" and node.scene != scene), None)
    if layers is None:
        layers = _layers(tree, scene)
        tree.links.new(layers.outputs["Image"], above)
        _place(tree, over, output)
    return layers


def _before(socket: Any) -> list[Any]:
    """The nodes that a socket's picture comes from, the nearest first: the user may have put others between."""
    found: list[Any] = []
    sockets = [socket]
    for each in sockets:
        for node in (link.from_node for link in each.links):
            if node not in found:  # which also ends a circle
                found.append(node)
                sockets.extend(node.inputs)
    return found


def _images(over: Any) -> tuple[Any, Any]:
    """The sockets of what lies under and above; they have names of their own since 5.0."""
    if "Background" in over.inputs:
        return over.inputs["Background"], over.inputs["Foreground"]
    under, above = (socket for socket in over.inputs if socket.type == "RGBA")
    return under, above


def _compositor(scene: Any) -> tuple[Any, Any]:
    """The scene's compositor tree and its output node, made where there is none."""
    if hasattr(scene, "compositing_node_group"):  # since 5.0
        tree = scene.compositing_node_group
        if tree is None:
            tree = bpy.data.node_groups.new(scene.name, "CompositorNodeTree")
            tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
            scene.compositing_node_group = tree
        kind = "NodeGroupOutput"
    else:
        had_nodes, scene.use_nodes = scene.use_nodes, True
        tree, kind = scene.node_tree, "CompositorNodeComposite"
        if not had_nodes and len(tree.nodes) == 2:  # what Blender puts there: made anew below
            tree.nodes.clear()
    output = next((node for node in tree.nodes if node.bl_idname == kind), None)
    return tree, output if output is not None else tree.nodes.new(kind)


def _layers(tree: Any, scene: Any) -> Any:
    node = tree.nodes.new("CompositorNodeRLayers")
    node.scene, node.label = scene, scene.name
    return node


def _place(tree: Any, over: Any, output: Any) -> None:
    """From left to right, the new layers one above the other."""
    over.location = (output.location.x - 250, output.location.y)
    layers = [node for node in tree.nodes if node.bl_idname == "CompositorNodeRLayers"]
    for number, node in enumerate(layers):
        node.location = (over.location.x - 350, over.location.y - 380 * number)


register, unregister = bpy.utils.register_classes_factory((FROG_OT_compose,))
