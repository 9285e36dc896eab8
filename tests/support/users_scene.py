"""A scene that holds something of the user's: a world, a camera, an instance; and the viewports that show it."""

import bpy
from support.small_scenes import world_of


def users_scene(scene):
    """Settings of the user's own, and a world that nothing else uses."""
    world = world_of("My studio lights", (0.0509, 0.0509, 0.0509))
    world.node_tree.nodes.new("ShaderNodeTexEnvironment")
    scene.world, scene.view_settings.view_transform = world, "Filmic"
    scene.render.resolution_x, scene.render.fps, scene.frame_end = 1280, 25, 99
    return world


def eye_in(scene, place=(0.0, 0.0, 0.0), turn=(0.0, 0.0, 0.0), **lens):
    """The scene's camera, a new one with settings of its lens."""
    eye = scene.camera = bpy.data.objects.new("eye", bpy.data.cameras.new("eye"))
    eye.location, eye.rotation_euler = place, turn
    for name, value in lens.items():
        setattr(eye.data, name, value)
    scene.collection.objects.link(eye)
    return eye


def instance_in(holder, collection, place=(0.0, 0.0, 0.0)):
    """An empty in a collection that shows another one at a place."""
    instance = bpy.data.objects.new("instance", None)
    instance.instance_type, instance.instance_collection, instance.location = "COLLECTION", collection, place
    holder.objects.link(instance)
    return instance


def views():
    areas = [area for window in bpy.context.window_manager.windows for area in window.screen.areas]
    return [area.spaces.active for area in areas if area.type == "VIEW_3D"]
