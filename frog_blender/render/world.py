"""The background of captures: the color of Blender's world."""

import bpy
import numpy as np

from ..color_spaces import out_of_working_space, to_display


def background_of(scene: bpy.types.Scene, captured: np.ndarray) -> np.ndarray | None:
    """(3,) display-referred background color: the world's, otherwise the captured one; None for a transparent film.
    Textures and skies are not drawn.
    """
    if scene.render.film_transparent:
        return None
    world = scene.world
    if world is None:
        return captured
    linear = np.array(world.color, dtype=np.float32)
    shader = background_node(world)
    if shader is not None:
        linear = np.array(shader.inputs["Color"].default_value[:3]) * shader.inputs["Strength"].default_value
    return to_display(out_of_working_space(linear))


def background_node(world: bpy.types.World) -> bpy.types.ShaderNode | None:
    """The node whose color and strength are drawn; None where the world's own color is."""
    has_nodes = world.node_tree is not None and (bpy.app.version >= (5, 0, 0) or world.use_nodes)
    nodes = world.node_tree.nodes if has_nodes else ()
    shader = next((node for node in nodes if node.type == "BACKGROUND"), None)
    if shader is None or shader.inputs["Color"].is_linked or shader.inputs["Strength"].is_linked:
        return None
    return shader
