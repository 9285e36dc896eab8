"""A scene that was composed, changes that a user makes to it and what is read of it, for the tests of composing."""

import bpy
from support.small_scenes import glowing

from frog_blender.render.compositing import compositor
from frog_blender.timeline import playback


def card(collection, location, size=0.4, color=(0.9, 0.1, 0.8)):
    """A glowing square in the plane x, z."""
    mesh = bpy.data.meshes.new("card")
    corners = [(-size, 0, -size), (size, 0, -size), (size, 0, size), (-size, 0, size)]
    mesh.from_pydata(corners, [], [(0, 1, 2, 3)])
    obj = bpy.data.objects.new("card", mesh)
    obj.location = location
    mesh.materials.append(glowing(color))
    collection.objects.link(obj)
    return obj


def collection_in(parent, name):
    made = bpy.data.collections.new(name)
    parent.children.link(made)
    return made


def compose(scene):
    assert bpy.ops.frog.compose(engine="CYCLES", light=False) == {"FINISHED"}
    scene.cycles.samples, scene.cycles.use_denoising = 1, False


def compose_anew(scene):
    """As if the button had not been pressed before."""
    for other in list(bpy.data.scenes):
        if other.frog.composed_with is not None:
            bpy.data.scenes.remove(other)
    if hasattr(scene, "compositing_node_group"):
        scene.compositing_node_group = None
    else:
        scene.node_tree.nodes.clear()
        scene.use_nodes = False
    compose(scene)


def the_capture():
    return next(playback.captures(bpy.data.objects))


def splats_of(scene):
    (splats,) = (other for other in bpy.data.scenes if other.frog.composed_with == scene)
    return splats


def cameras(scene):
    return sorted((obj for obj in scene.objects if obj.type == "CAMERA"), key=lambda obj: obj.name)


def nodes_of(scene, kind):
    return [node for node in compositor.tree_of(scene).nodes if node.type == kind]


def a_region(scene):
    scene.render.use_border = True
    scene.render.border_min_x, scene.render.border_max_x = 0.2, 0.7
    scene.render.border_min_y, scene.render.border_max_y = 0.1, 0.9


def the_node_muted(scene):
    (over,) = nodes_of(scene, "ALPHAOVER")
    over.mute = True


def is_striped(image):
    """Whether an image is the pattern that says that there is none."""
    magenta = (image[..., :3] == (255, 0, 255)).all(-1)
    black = (image[..., :3] == 0).all(-1)
    return (magenta | black).all() and 0.3 < magenta.mean() < 0.7


def name_of(change):
    return change.__name__
