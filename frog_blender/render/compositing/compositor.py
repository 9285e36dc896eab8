"""The compositor's nodes of a scene: which other scenes' images it shows, and the ones that lay FRoG's over it."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import bpy

_LABEL = "FRoG"  # of the node that lays one image over the other
_HAS_GROUPS = bpy.app.version >= (5, 0, 0)  # a scene's nodes are a data-block, which several scenes may share


def tree_of(scene: Any) -> Any | None:
    """The nodes that a scene's image goes through; None without any, or where compositing is switched off."""
    if not scene.render.use_compositing:
        return None
    if _HAS_GROUPS:
        return scene.compositing_node_group
    return scene.node_tree if scene.use_nodes else None


def shown_scenes(scene: Any) -> list[Any]:
    """The scenes whose images reach a scene's own: not those of nodes that are muted or not linked to the output."""
    tree = tree_of(scene)
    if tree is None:
        return []
    nodes = (node for node in _reaching(tree) if node.type == "R_LAYERS" and node.scene is not None)
    return list(dict.fromkeys(node.scene for node in nodes))


def rendered_scenes(scene: Any) -> list[Any]:
    """The scenes that Blender renders for a scene's compositor: it does not look into groups."""
    tree = tree_of(scene)
    nodes = () if tree is None else tree.nodes
    return [node.scene for node in nodes if node.type == "R_LAYERS" and not node.mute]


def _reaching(tree: Any) -> Iterator[Any]:
    """The nodes whose images reach a tree's output, those within groups included."""
    sockets = _outputs(tree)
    seen: set[int] = set()
    for socket in sockets:  # grows
        for link in socket.links:
            node = link.from_node
            if link.is_muted or not link.is_valid:
                continue
            if node.mute:
                sockets.extend(each.from_socket for each in node.internal_links if each.to_socket == link.from_socket)
                continue
            if node.as_pointer() in seen:  # which also ends a circle
                continue
            seen.add(node.as_pointer())
            yield node
            sockets.extend(node.inputs)
            if node.type == "GROUP" and node.node_tree is not None:
                sockets.extend(_outputs(node.node_tree))


def _outputs(tree: Any) -> list[Any]:
    """The sockets where a tree's image arrives."""
    ends = [node for node in tree.nodes if node.type in ("COMPOSITE", "GROUP_OUTPUT") and not node.mute]
    ends = [node for node in ends if getattr(node, "is_active_output", True)] or ends
    return [socket for node in ends for socket in node.inputs]


def lay_over(scene: Any, other: Any) -> None:
    """Lays another scene's image over what a scene's compositor shows besides.

    Whatever nodes are missing are made, and what is muted or unlinked comes back.
    """
    scene.render.use_compositing = True
    tree, output = own_tree(scene)
    over = next((node for node in tree.nodes if node.label == _LABEL and node.type == "ALPHAOVER"), None)
    if over is None:
        over = tree.nodes.new("CompositorNodeAlphaOver")
        over.label = _LABEL
    over.mute = False
    if over not in list(_reaching(tree)):
        target = output.inputs["Image"]
        shown = target.links[0].from_socket if target.is_linked else _layers(tree, scene).outputs["Image"]
        tree.links.new(shown, _images(over)[0])
        tree.links.new(over.outputs[0], target)
    above = _images(over)[1]
    layers = next((node for node in _before(above) if node.type == "R_LAYERS" and node.scene != scene), None)
    if layers is None:
        layers = _layers(tree, scene)
        tree.links.new(layers.outputs["Image"], above)
        _place(tree, over, output)
    layers.mute = False
    _read(layers, other)


def own_tree(scene: Any) -> tuple[Any, Any]:
    """The scene's compositor tree and its output node, made where there is none."""
    if _HAS_GROUPS:
        tree = scene.compositing_node_group
        if tree is None:
            tree = bpy.data.node_groups.new(scene.name, "CompositorNodeTree")
            tree.interface.new_socket("Image", in_out="OUTPUT", socket_type="NodeSocketColor")
        elif any(other != scene and other.compositing_node_group == tree for other in bpy.data.scenes):
            tree = tree.copy()  # the other one's image is to stay as it is
        scene.compositing_node_group = tree
        kind = "NodeGroupOutput"
    else:
        had_nodes, scene.use_nodes = scene.use_nodes, True
        tree, kind = scene.node_tree, "CompositorNodeComposite"
        if not had_nodes and len(tree.nodes) == 2:  # what Blender puts there: made anew below
            tree.nodes.clear()
    output = next((node for node in tree.nodes if node.bl_idname == kind), None)
    return tree, output if output is not None else tree.nodes.new(kind)


def _before(socket: Any) -> list[Any]:
    """The nodes that a socket's image comes from, the nearest first: the user may have put others between."""
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


def _layers(tree: Any, scene: Any) -> Any:
    node = tree.nodes.new("CompositorNodeRLayers")
    _read(node, scene)
    return node


def _read(node: Any, scene: Any) -> None:
    """Makes a Render Layers node show a scene's image."""
    node.scene, node.label = scene, scene.name
    used = (layer.name for layer in scene.view_layers if layer.use)
    node.layer = next(used, scene.view_layers[0].name)


def _place(tree: Any, over: Any, output: Any) -> None:
    """From left to right, the new layers one above the other."""
    over.location = (output.location.x - 250, output.location.y)
    layers = [node for node in tree.nodes if node.bl_idname == "CompositorNodeRLayers"]
    for number, node in enumerate(layers):
        node.location = (over.location.x - 350, over.location.y - 380 * number)
