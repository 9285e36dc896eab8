"""Compositor nodes: which other scenes a scene shows, and the nodes that overlay FRoG's image."""

from collections.abc import Iterator

import bpy

_LABEL = "FRoG"  # of the node that lays one image over the other
_SHADOWS = "FRoG Shadows"  # of the node that darkens FRoG's image
_HAS_GROUPS = bpy.app.version >= (5, 0, 0)  # a scene's nodes are a data-block, which several scenes may share
_IMAGE = slice(1)  # of a tree's outputs: Blender shows the first one, whatever it is called


def tree_of(scene: bpy.types.Scene) -> bpy.types.NodeTree | None:
    """The compositor nodes of a scene; None if there are none or compositing is disabled."""
    if not scene.render.use_compositing:
        return None
    if _HAS_GROUPS:
        return scene.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


def shown_scenes(scene: bpy.types.Scene) -> list[bpy.types.Scene]:
    """The scenes whose images reach a scene's output. Muted and unlinked nodes are ignored."""
    return list(dict.fromkeys(node.scene for node in _shown_layers(scene)))


def layers_shown_of(scene: bpy.types.Scene) -> set[str]:
    """The view layers of its own whose images reach a scene's output."""
    return {node.layer for node in _shown_layers(scene) if node.scene == scene}


def _shown_layers(scene: bpy.types.Scene) -> Iterator[bpy.types.Node]:
    """The Render Layers nodes whose images reach a scene's output."""
    tree = tree_of(scene)
    shown = () if tree is None else _upstream(_outputs(tree, _IMAGE))
    return (node for node in shown if node.type == "R_LAYERS" and node.scene is not None)


def rendered_scenes(scene: bpy.types.Scene) -> list[bpy.types.Scene]:
    """The scenes that Blender renders for a scene's compositor. Blender does not look into node groups."""
    nodes = getattr(tree_of(scene), "nodes", ())
    return [node.scene for node in nodes if node.type == "R_LAYERS" and not node.mute]


def _upstream(sockets: list[bpy.types.NodeSocket], *, only_shown: bool = True) -> Iterator[bpy.types.Node]:
    """The nodes before sockets, nearest first.

    Args:
        only_shown: those whose image arrives there, including those in groups.
    """
    seen: set[int] = set()
    for socket in sockets:  # grows
        for link in socket.links:
            node = link.from_node
            if only_shown and (link.is_muted or not link.is_valid):
                continue
            if only_shown and node.mute:
                inside = (inner for inner in node.internal_links if inner.to_socket == link.from_socket)
                sockets.extend(inner.from_socket for inner in inside)
                continue
            if node.as_pointer() in seen:  # which also ends a circle
                continue
            seen.add(node.as_pointer())
            yield node
            sockets.extend(node.inputs)
            if only_shown and node.type == "GROUP" and node.node_tree is not None:
                sockets.extend(_outputs(node.node_tree))


def _outputs(tree: bpy.types.NodeTree, which: slice = slice(None)) -> list[bpy.types.NodeSocket]:
    """The sockets where what a tree gives arrives."""
    ends = [node for node in tree.nodes if node.type in ("COMPOSITE", "GROUP_OUTPUT") and not node.mute]
    ends = [node for node in ends if getattr(node, "is_active_output", True)] or ends
    return [socket for node in ends for socket in node.inputs[which]]


def overlay_scene(scene: bpy.types.Scene, other: bpy.types.Scene) -> None:
    """Overlays another scene's image on what a scene's compositor shows.

    Whatever nodes are missing are made, and what is muted or unlinked comes back.
    """
    scene.render.use_compositing = True
    tree, output = own_tree(scene)
    over = _over_node(tree)
    if over is None:
        over = tree.nodes.new("CompositorNodeAlphaOver")
        over.label = _LABEL
    over.mute = False
    if over not in list(_upstream(_outputs(tree, _IMAGE))):
        target = output.inputs[0]
        shown = target.links[0].from_socket if target.is_linked else _layers(tree, scene).outputs["Image"]
        tree.links.new(shown, _images(over)[0])
        tree.links.new(over.outputs[0], target)
    above = _images(over)[1]
    before = (node for node in _upstream([above], only_shown=False) if node.type == "R_LAYERS")
    layers = next((node for node in before if node.scene != scene), None)
    if layers is None:
        layers = _layers(tree, scene)
        tree.links.new(layers.outputs["Image"], above)
        _place(tree, over, output)
    layers.mute = False
    _read(layers, other)
    shadows = _shadow_node(over)
    if shadows is not None:
        shadows.mute = False


def multiply_shadows(scene: bpy.types.Scene) -> None:
    """Darkens the image that is laid over a scene's own by what Cycles' shadow catchers lose of their light there.

    A node that does so already stays as the user left it.
    """
    tree = tree_of(scene)
    over = None if tree is None else _over_node(tree)
    if tree is None or over is None or _shadow_node(over) is not None:
        return
    for layer in scene.view_layers:
        layer.cycles.use_pass_shadow_catcher = True
    target = _images(over)[1]
    if _HAS_GROUPS:
        mix = tree.nodes.new("ShaderNodeMix")
        mix.data_type = "RGBA"
    else:
        mix = tree.nodes.new("CompositorNodeMixRGB")
    mix.blend_type, mix.label = "MULTIPLY", _SHADOWS
    mix.location = (over.location.x - 180, over.location.y - 200)
    factor, image, shadow = (socket for socket in mix.inputs if socket.enabled)
    factor.default_value = 1.0
    shadow.default_value = (1.0, 1.0, 1.0, 1.0)  # other engines have no such pass, and nothing is to be darkened
    own = (node for node in tree.nodes if node.type == "R_LAYERS" and node.scene == scene)
    layers = next(own, None) or _layers(tree, scene)
    if target.is_linked:
        tree.links.new(target.links[0].from_socket, image)
    tree.links.new(layers.outputs["Shadow Catcher"], shadow)
    tree.links.new(next(socket for socket in mix.outputs if socket.enabled), target)


def _over_node(tree: bpy.types.NodeTree) -> bpy.types.Node | None:
    """The node that lays FRoG's image over another one; None where there is none."""
    return next((node for node in tree.nodes if node.label == _LABEL and node.type == "ALPHAOVER"), None)


def _shadow_node(over: bpy.types.Node) -> bpy.types.Node | None:
    """The node that darkens the image that this one lays over another; None where nothing does."""
    before = _upstream([_images(over)[1]], only_shown=False)
    return next((node for node in before if node.label == _SHADOWS), None)


def own_tree(scene: bpy.types.Scene) -> tuple[bpy.types.NodeTree, bpy.types.Node]:
    """The scene's compositor tree and its output node, made where there is none."""
    if _HAS_GROUPS:
        tree = scene.compositing_node_group
        if tree is None:
            tree = bpy.data.node_groups.new(scene.name, "CompositorNodeTree")
        elif tree.library or any(other != scene and other.compositing_node_group == tree for other in bpy.data.scenes):
            tree = tree.copy()  # the other one's image is to stay as it is
        scene.compositing_node_group = tree
        given = [item for item in tree.interface.items_tree if getattr(item, "in_out", "") == "OUTPUT"]
        if not given or given[0].socket_type != "NodeSocketColor":  # of which Blender shows nothing
            image = tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
            tree.interface.move(image, 0)
        kind = "NodeGroupOutput"
    else:
        had_nodes, scene.use_nodes = scene.use_nodes, True
        tree, kind = scene.node_tree, "CompositorNodeComposite"
        if not had_nodes and len(tree.nodes) == 2:  # what Blender puts there: made anew below
            tree.nodes.clear()
    output = next((node for node in tree.nodes if node.bl_idname == kind), None)
    return tree, output if output is not None else tree.nodes.new(kind)


def _images(over: bpy.types.Node) -> tuple[bpy.types.NodeSocket, bpy.types.NodeSocket]:
    """The background and foreground sockets, whose names changed in 5.0."""
    if "Background" in over.inputs:
        return over.inputs["Background"], over.inputs["Foreground"]
    under, above = (socket for socket in over.inputs if socket.type == "RGBA")
    return under, above


def _layers(tree: bpy.types.NodeTree, scene: bpy.types.Scene) -> bpy.types.Node:
    node = tree.nodes.new("CompositorNodeRLayers")
    _read(node, scene)
    return node


def _read(node: bpy.types.Node, scene: bpy.types.Scene) -> None:
    """Makes a Render Layers node show a scene's image."""
    node.scene, node.label = scene, scene.name
    used = (layer.name for layer in scene.view_layers if layer.use)
    node.layer = next(used, scene.view_layers[0].name)


def _place(tree: bpy.types.NodeTree, over: bpy.types.Node, output: bpy.types.Node) -> None:
    """From left to right, the new layers one above the other."""
    over.location = (output.location.x - 250, output.location.y)
    layers = [node for node in tree.nodes if node.bl_idname == "CompositorNodeRLayers"]
    for index, node in enumerate(layers):
        node.location = (over.location.x - 350, over.location.y - 380 * index)
