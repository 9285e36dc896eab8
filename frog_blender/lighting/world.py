"""A world that lights a scene's objects with a capture, made of the user's own, which cameras see as before."""

from __future__ import annotations

from typing import TYPE_CHECKING

import bpy
import numpy as np

if TYPE_CHECKING:
    from collections.abc import Iterator

_NAME = "FRoG Light"  # also the label of the nodes by which such a world is known
AHEAD = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""(4, 4) from the world to a camera that stands where it begins: ahead and up are where Blender's environment textures
have the middle and the upper edge of an image."""


def lit_scene(scene: bpy.types.Scene) -> bpy.types.Scene:
    """The scene whose world lights the objects: a scene of captures follows it (see render.compositing.scenes)."""
    return scene.frog.composed_with or scene


def is_lit(scene: bpy.types.Scene) -> bool:
    """Whether a capture lights the objects of a scene."""
    return scene.world is not None and light_node(scene.world) is not None


def light_node(world: bpy.types.World) -> bpy.types.ShaderNode | None:
    """The Background node whose strength is that of a capture's light; None in other worlds."""
    return next(_nodes(world, "BACKGROUND"), None)


def light_with(scene: bpy.types.Scene, light: np.ndarray, background: np.ndarray) -> None:
    """Lights the objects of a scene. Its own world is kept, and is what cameras and FROG see.

    Args:
        light: (H, W, 3) linear light with Rec. 709 primaries, equirectangular, rows from the top.
        background: (3,) scene-linear color that cameras see where the scene has no world.
    """
    world = scene.world
    if not is_lit(scene):
        before = scene.frog.own_world
        if before is not None and before.library is None:
            before.use_fake_user = True  # somebody replaced the lit world: without a user Blender drops the older one
        scene.frog.own_world, world = world, _with_light(world, background)
    elif world.library is not None:
        world = world.copy()
    texture = next(_nodes(world, "TEX_ENVIRONMENT"))
    texture.image = _image(light, texture.image)
    scene.world = world


def restore(scene: bpy.types.Scene) -> None:
    """Gives a scene its own world back."""
    scene.world, scene.frog.own_world = scene.frog.own_world, None


def _nodes(world: bpy.types.World, kind: str) -> Iterator[bpy.types.ShaderNode]:
    nodes = world.node_tree.nodes if world.node_tree is not None else ()
    return (node for node in nodes if node.label == _NAME and node.type == kind)


def _image(light: np.ndarray, former: bpy.types.Image | None) -> bpy.types.Image:
    """An image of the light, packed into the .blend; the former one, if that is of the same size."""
    height, width = light.shape[:2]
    if former is not None and former.library is None and tuple(former.size) == (width, height):
        image = former
    else:
        image = bpy.data.images.new(_NAME, width, height, alpha=False, float_buffer=True)
        image.colorspace_settings.name = "Linear Rec.709"
    pixels = np.ones((height, width, 4), np.float32)
    pixels[..., :3] = light[::-1]
    image.pixels.foreach_set(pixels.ravel())
    image.update()
    image.pack()
    return image


def _with_light(own: bpy.types.World | None, background: np.ndarray) -> bpy.types.World:
    """A copy of a world in which all rays but those of cameras see an image, which is still to be set."""
    if own is not None:
        world = own.copy()
        world.name, world.use_fake_user = _NAME, False
    else:
        world = bpy.data.worlds.new(_NAME)
        world.color = background
    has_nodes = world.node_tree is not None and (bpy.app.version >= (5, 0, 0) or world.use_nodes)
    if not has_nodes:
        world.use_nodes = True
    nodes, links = world.node_tree.nodes, world.node_tree.links
    if not has_nodes or own is None:
        nodes.clear()
        seen = nodes.new("ShaderNodeBackground")
        seen.inputs["Color"].default_value = (*world.color, 1.0)
        links.new(seen.outputs[0], nodes.new("ShaderNodeOutputWorld").inputs["Surface"])
    outputs = [node for node in nodes if node.type == "OUTPUT_WORLD"]
    output = next((node for node in outputs if node.is_active_output), None) or nodes.new("ShaderNodeOutputWorld")
    texture, lit, mix, rays = (
        nodes.new(f"ShaderNode{kind}") for kind in ("TexEnvironment", "Background", "MixShader", "LightPath")
    )
    for number, node in enumerate((rays, texture, lit, mix)):
        node.label, node.location = _NAME, (output.location.x - 200, output.location.y - 350 * (3 - number))
    links.new(texture.outputs["Color"], lit.inputs["Color"])
    links.new(rays.outputs["Is Camera Ray"], mix.inputs[0])
    links.new(lit.outputs[0], mix.inputs[1])
    surface = output.inputs["Surface"]
    if surface.is_linked:
        links.new(surface.links[0].from_socket, mix.inputs[2])
    links.new(mix.outputs[0], surface)
    return world
