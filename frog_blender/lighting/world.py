"""A world that lights a scene's objects with a capture, made of the user's own, which cameras see as before."""

from collections.abc import Iterator
from contextlib import suppress
from typing import Any

import bpy
import numpy as np

from .. import point_cloud
from ..color_spaces import into_working_space
from ..engine.playback.environment import environment, free_place
from ..engine.srgb import to_linear
from ..nodes.node_builder import Builder
from ..render.collect_instances import placed
from ..timeline import playback

_NAME = "FRoG Light"  # also the label of the nodes by which such a world is known
_OURS = "frog_light"  # property of the images that are made here
_COLORS = ("Linear Rec.709", "Linear")  # names of linear light in configurations of OpenColorIO
AHEAD = np.array([[0.0, -1.0, 0.0, 0.0], [0.0, 0.0, -1.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""(4, 4) from the world to a camera that stands where it begins: ahead and up are where Blender's environment textures
have the middle and the upper edge of an image."""
WIDTH = 1024
"""Pixels of an environment image."""


def lit_scene(scene: bpy.types.Scene) -> bpy.types.Scene:
    """The scene whose world lights the objects: a scene of captures follows it (see render.compositing.scenes)."""
    return scene.frog.composed_with or scene


def is_lit(scene: bpy.types.Scene) -> bool:
    """Whether a capture lights the objects of a scene."""
    return scene.world is not None and light_node(scene.world) is not None


def light_node(world: bpy.types.World) -> bpy.types.ShaderNode | None:
    """The Background node whose strength is that of a capture's light; None in other worlds."""
    return next(_nodes(world, "BACKGROUND"), None)


def light_by(obj: bpy.types.Object, context: bpy.types.Context) -> None:
    """Lights the objects of a context's scene by what a capture shows from the place nearest its middle that nothing
    stands close to.

    Raises:
        FrogError: the capture cannot be shown.
    """
    evaluated = obj.evaluated_get(context.evaluated_depsgraph_get())
    shown = playback.scene_time(obj, context.scene.frame_current_final, evaluated)
    gaussians = placed(shown.gaussians(), np.array(evaluated.matrix_world, np.float64), obj.name)
    camera = AHEAD.copy()
    camera[:3, 3] = -camera[:3, :3] @ free_place(gaussians, *point_cloud.middle_of(gaussians.means))
    filmed = into_working_space(to_linear(np.array(shown.scene.header.background, np.float64)))
    light_with(lit_scene(context.scene), environment(gaussians, camera, WIDTH), filmed)


def light_with(scene: bpy.types.Scene, light: np.ndarray, background: np.ndarray) -> None:
    """Lights the objects of a scene. Its own world is kept, and is what cameras and FROG see. Other scenes stay as they
    are, but for one that follows it.

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
    elif world.library is not None or _others_with(scene, world):
        scene.frog.own_world, world = _own_world(scene), world.copy()
    texture = next(_nodes(world, "TEX_ENVIRONMENT"), None) or _new_texture(world, light_node(world))
    former, texture.image = texture.image, _image(light)
    scene.world = world
    if former is not None and former.users == 0 and former.get(_OURS):
        bpy.data.images.remove(former)
        texture.image.name = _NAME


def restore(scene: bpy.types.Scene) -> None:
    """Gives a scene its own world back. The lit one is kept if somebody changed more than its light."""
    lit, own = scene.world, _own_world(scene)
    if lit.library is None and (own is None or _content(lit) != _content(own)):  # which Blender would drop
        lit.use_fake_user = True
    scene.world, scene.frog.own_world = own, None


def _own_world(scene: bpy.types.Scene) -> bpy.types.World | None:
    """The world of a lit scene before; one that was given the lit world of another scene has that one's."""
    if scene.frog.own_world is not None:
        return scene.frog.own_world
    return next((own for other in _others_with(scene, scene.world) if (own := other.frog.own_world) is not None), None)


def _others_with(scene: bpy.types.Scene, world: bpy.types.World) -> list[bpy.types.Scene]:
    """The other scenes that have a world, without those that follow this scene."""
    others = (other for other in bpy.data.scenes if other.world == world and other != scene)
    return [other for other in others if other.frog.composed_with != scene]


def _content(world: bpy.types.World) -> list[tuple[object, ...]]:
    """The user's nodes of a world, and what their sockets hold."""
    nodes = world.node_tree.nodes if world.node_tree is not None else ()
    own = (node for node in nodes if node.label != _NAME)
    return [(node.bl_idname, node.mute, getattr(node, "image", None), *map(_value, node.inputs)) for node in own]


def _value(socket: bpy.types.NodeSocket) -> object:
    value: Any = getattr(socket, "default_value", None)  # Any: a number, a text or an array of Blender
    return tuple(value) if hasattr(value, "__len__") else value


def _nodes(world: bpy.types.World, kind: str) -> Iterator[bpy.types.ShaderNode]:
    nodes = world.node_tree.nodes if world.node_tree is not None else ()
    return (node for node in nodes if node.label == _NAME and node.type == kind)


def _new_texture(world: bpy.types.World, lit: Any) -> bpy.types.ShaderNode:  # Any: None as well, which is_lit excludes
    """The node of the light's image, which somebody has removed."""
    texture = world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    texture.label, texture.location = _NAME, (lit.location.x, lit.location.y - 350)
    world.node_tree.links.new(texture.outputs["Color"], lit.inputs["Color"])
    return texture


def _image(light: np.ndarray) -> bpy.types.Image:
    """An image of the light, packed into the .blend. Always a new one: undo brings no pixels back."""
    height, width = light.shape[:2]
    image = bpy.data.images.new(_NAME, width, height, alpha=False, float_buffer=True)
    image[_OURS] = True
    for name in _COLORS:
        with suppress(TypeError):  # the user's configuration of OpenColorIO has no such name
            image.colorspace_settings.name = name
            break
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
    nodes, links, build = world.node_tree.nodes, world.node_tree.links, Builder(world.node_tree)
    if not has_nodes or own is None:
        nodes.clear()
        seen = build.out("ShaderNodeBackground", {"Color": (*world.color, 1.0)})
        build.node("ShaderNodeOutputWorld", {"Surface": seen})
    outputs = [node for node in nodes if node.type == "OUTPUT_WORLD"]
    output = next((node for node in outputs if node.is_active_output), None) or nodes.new("ShaderNodeOutputWorld")
    surface = output.inputs["Surface"]
    rays, texture = build.node("ShaderNodeLightPath"), build.node("ShaderNodeTexEnvironment")
    lit = build.node("ShaderNodeBackground", {"Color": texture.outputs["Color"]})
    mix = build.node("ShaderNodeMixShader", {0: rays.outputs["Is Camera Ray"], 1: lit.outputs[0]})
    for index, node in enumerate((rays, texture, lit, mix)):
        node.label, node.location = _NAME, (output.location.x - 200, output.location.y - 350 * (3 - index))
    if surface.is_linked:
        links.new(surface.links[0].from_socket, mix.inputs[2])
    links.new(mix.outputs[0], surface)
    return world
