"""Sets a scene up for a capture, detects whether anything in it is the user's, and reverts what fails half way."""

from collections.abc import Collection, Iterator
from contextlib import contextmanager, suppress
from typing import Any

import bpy
import numpy as np

from ..color_spaces import into_working_space
from ..engine.scene.header import SceneHeader
from ..engine.srgb import to_linear
from ..timeline import playback
from .capture_objects import cameras_of, holders_of, root_of

SETTINGS = ("frames", "rate", "size", "camera", "colors", "background")
PARTS = (*SETTINGS, "engine")
"""What ``set_up`` can match: the frame range, the frame rate, the render size, the active camera, colours as they were
filmed, the world's colour; and that FROG renders, which rendered viewports then show.
"""
_BACKGROUND_WORLD = "FRoG Background"
_LAYERS = 1024  # transparent bounces of Cycles: its maximum
_ENGINES = ("BLENDER_EEVEE", "BLENDER_EEVEE_NEXT", "FROG")  # 4.5 has the longer name

_CHANGED = {
    "frame_start": 1,
    "frame_end": 250,
    "render.fps": 24,
    "render.fps_base": 1.0,
    "render.resolution_x": 1920,
    "render.resolution_y": 1080,
    "render.resolution_percentage": 100,
    "render.pixel_aspect_x": 1.0,
    "render.pixel_aspect_y": 1.0,
    "view_settings.view_transform": "AgX",
    "view_settings.look": "None",
    **dict.fromkeys(("camera", "world", "render.engine", "render.dither_intensity", "render.use_lock_interface")),
    "cycles.transparent_max_bounces": None,
}
"""Paths of all scene settings that ``set_up`` changes, with what Blender starts with where that tells a new file. The
start of the frame range comes before its end, as neither can pass the other.
"""
# The objects of a new file and their places, and the grey of its world.
_START_OBJECTS = {
    "Cube": ("MESH", (0.0, 0.0, 0.0)),
    "Light": ("LIGHT", (4.0762, 1.0055, 5.9039)),
    "Camera": ("CAMERA", (7.3589, -6.9258, 4.9583)),
}
_START_GREY = 0.0509


def is_untouched(scene: bpy.types.Scene) -> bool:
    """Whether the scene holds nothing of the user's: only Blender's default objects, or only captures and their
    settings.
    """
    ours = _of_captures(scene)
    if any(obj not in ours and not _is_of_start(obj) for obj in scene.objects):
        return False
    has_strips = scene.sequence_editor is not None and len(scene.sequence_editor.strips) > 0
    if not _is_plain(scene.world) or scene.timeline_markers or has_strips:
        return False
    if scene.frog.set_up_as and scene.frog.set_up_as == _fingerprint(scene):
        return True
    settings = values(scene)
    are_of_start = all(settings[path] == value for path, value in _CHANGED.items() if value is not None)
    return are_of_start and settings["render.engine"] in _ENGINES and _is_of_start_world(scene.world)


def is_set_up(scene: bpy.types.Scene) -> bool:
    """Whether the scene was set up for a capture, regardless of later changes."""
    return bool(scene.frog.set_up_as) or scene.render.engine == "FROG"


def start_cube(scene: bpy.types.Scene) -> bpy.types.Object | None:
    """The unchanged cube of a new file, where it is seen and may hide splats; None for none."""
    cube = scene.objects.get("Cube")
    seen = cube is not None and _is_of_start(cube) and not cube.hide_viewport and cube.visible_get()
    return cube if seen else None


def hide_start_cube(scene: bpy.types.Scene) -> None:
    """Hides the unchanged cube of a new file in viewports and renders, if it is seen."""
    if (cube := start_cube(scene)) is not None:
        cube.hide_viewport = cube.hide_render = True


def has_camera_of_its_own(scene: bpy.types.Scene) -> bool:
    """Whether somebody chose the scene's camera: it has one, and not the unchanged one of a new file."""
    return scene.camera is not None and not _is_of_start(scene.camera)


def has_world_of_its_own(scene: bpy.types.Scene) -> bool:
    """Whether somebody made the scene's world, or took it away: it is neither that of a new file nor the background
    that ``set_up`` makes.
    """
    world = scene.world
    is_ours = world is not None and world.name.startswith(_BACKGROUND_WORLD) and _is_plain(world)
    return world is None or not (is_ours or _is_of_start_world(world))


def _of_captures(scene: bpy.types.Scene) -> set[bpy.types.Object]:
    """The captures of a scene, their roots and cameras, without any in a mode other than Object Mode."""
    objects: set[bpy.types.Object] = set()
    for obj in playback.captures(scene.objects):
        objects |= {obj, root_of(obj), *holders_of(obj), *cameras_of(obj)}
    return {obj for obj in objects if obj.mode == "OBJECT"}


def _is_of_start(obj: bpy.types.Object) -> bool:
    """Whether an object is the unchanged cube, light or camera of a new file."""
    kind, location = _START_OBJECTS.get(obj.name, ("", ()))
    if obj.type != kind or obj.mode != "OBJECT" or obj.library is not None:
        return False
    if obj.modifiers or obj.constraints or obj.parent is not None or obj.children or obj.animation_data is not None:
        return False
    if kind == "MESH" and (len(obj.data.vertices), len(obj.data.polygons)) != (8, 6):
        return False
    return bool(np.allclose(obj.location, location, atol=1e-3) and np.allclose(obj.scale, 1.0))


def _is_plain(world: bpy.types.World) -> bool:
    """Whether a world is a plain color or missing; anything else was made by the user."""
    if world is None:
        return True
    if world.library is not None or world.animation_data is not None:
        return False
    return world.node_tree is None or {node.type for node in world.node_tree.nodes} <= {"BACKGROUND", "OUTPUT_WORLD"}


def _is_of_start_world(world: bpy.types.World) -> bool:
    if world is None:
        return True
    colors = [node.inputs["Color"].default_value[:3] for node in _backgrounds(world)]
    is_grey = all(np.allclose(color, _START_GREY, atol=1e-3) for color in [world.color, *colors])
    is_dimmed = any(node.inputs["Strength"].default_value != 1.0 for node in _backgrounds(world))
    return world.name == "World" and is_grey and not is_dimmed


def _backgrounds(world: bpy.types.World) -> list[bpy.types.ShaderNode]:
    nodes = world.node_tree.nodes if world.node_tree is not None else ()
    return [node for node in nodes if node.type == "BACKGROUND"]


def _fingerprint(scene: bpy.types.Scene) -> str:
    """The settings that set_up changes, as text."""
    return repr({path: getattr(value, "name", value) for path, value in values(scene).items()})


def set_up(
    scene: bpy.types.Scene,
    header: SceneHeader,
    start_frame: float,
    cameras: list[bpy.types.Object],
    parts: Collection[str],
) -> None:
    """Match the scene to a capture.

    Args:
        parts: which of PARTS. A static capture has neither frames nor a rate.
    """
    parts = set(parts) - ({"frames", "rate"} if header.frame_count <= 1 else set())
    # Before anything is set: a header may contain non-finite values.
    background = into_working_space(to_linear(np.array(header.background, dtype=np.float64)))
    if "frames" in parts:
        scene.frame_start, scene.frame_end = frame_range(header, start_frame)
    if "rate" in parts:
        # Blender keeps a whole number of frames and a divisor: 29.97 is 30 over 1.001.
        whole = max(round(header.frames_per_second), 1)
        scene.render.fps, scene.render.fps_base = whole, whole / max(header.frames_per_second, 0.01)
    if cameras and "camera" in parts:
        scene.camera = cameras[0]
    if cameras and "size" in parts:
        render_at_size_of(scene, cameras[0])
    if "colors" in parts:
        show_colors_unchanged(scene)
        if hasattr(scene, "cycles"):  # the default of 8 bounces loses two thirds of the light
            scene.cycles.transparent_max_bounces = max(scene.cycles.transparent_max_bounces, _LAYERS)
    if parts:
        # A window draws while a render evaluates frames in its own thread; locked, they do not share the Gaussians.
        scene.render.use_lock_interface = True
    if "background" in parts:
        set_background(scene, background)
    if "engine" in parts:
        scene.render.engine = "FROG"
        show_in_viewports(scene, through_camera=bool(cameras) and "camera" in parts)
    if parts >= {"camera", "size", "colors", "background"}:
        scene.frog.set_up_as = _fingerprint(scene)
        if is_untouched(scene):  # nobody put its cube there, which would stand in the picture
            hide_start_cube(scene)


def frame_range(header: SceneHeader, start_frame: float) -> tuple[int, int]:
    """The frames of the timeline that show a capture."""
    first = round(start_frame)
    return first, max(first + header.frame_count - 1, first)


def are_colors_unchanged(scene: bpy.types.Scene) -> bool:
    """Whether the scene shows colors as they were filmed."""
    settings = scene.view_settings
    return settings.view_transform == "Standard" and settings.look == "None"


def show_colors_unchanged(scene: bpy.types.Scene) -> None:
    """Shows colors as they were filmed: no view transform, look or dithering."""
    for name, value in (("view_transform", "Standard"), ("look", "None")):
        with suppress(TypeError):  # a colour configuration of the user's own has none of that name
            setattr(scene.view_settings, name, value)
    scene.render.dither_intensity = 0.0


def set_background(scene: bpy.types.Scene, color: np.ndarray) -> None:
    """Gives the scene a world of this color (scene-linear RGB). Its previous world stays in the file."""
    before = scene.world
    # Another scene's world belongs to another capture.
    is_ours = before is not None and before.name.startswith(_BACKGROUND_WORLD)
    if is_ours and _is_plain(before) and before.users == 1:
        world = before
    else:
        world = bpy.data.worlds.new(_BACKGROUND_WORLD)
        if before is not None and before.library is None:
            before.use_fake_user = True  # otherwise Blender drops unused data when saving
    world.color = color
    for node in _backgrounds(world):
        node.inputs["Color"].default_value = (*color.tolist(), 1.0)
        node.inputs["Strength"].default_value = 1.0
    scene.world = world


def show_in_viewports(scene: bpy.types.Scene, *, through_camera: bool) -> None:
    """Switches Solid and Wireframe viewports of the scene, which show surfaces only, to Rendered."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas if window.scene == scene else ():
            space = area.spaces.active
            if area.type == "VIEW_3D" and space.shading.type in ("SOLID", "WIREFRAME"):
                space.shading.type = "RENDERED"
                space.overlay.show_relationship_lines = False  # one from each camera would cross the image
                if through_camera and scene.camera is not None:
                    space.region_3d.view_perspective = "CAMERA"


def look_through(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Make a camera active and set the render size to that of its captured images."""
    scene.camera = camera
    render_at_size_of(scene, camera)


def render_at_size_of(scene: bpy.types.Scene, camera: bpy.types.Object) -> None:
    """Set the render size to that of a camera's captured images."""
    width, height = camera.data.frog.size
    if width and height:
        scene.render.resolution_x, scene.render.resolution_y = width, height
        scene.render.resolution_percentage = 100
        scene.render.pixel_aspect_x = scene.render.pixel_aspect_y = 1.0


@contextmanager
def all_or_nothing(scene: bpy.types.Scene) -> Iterator[None]:
    """Runs code that adds data-blocks and changes settings of ``scene``. Any exception reverts both and is raised
    again.

    Nothing else may add data-blocks meanwhile, which on Blender's main thread nothing does.
    """
    settings = values(scene)
    text = bpy.data.texts.new("FRoG")
    newest = text.session_uid  # each new data-block of a session gets a larger one
    bpy.data.texts.remove(text)
    try:
        yield
    except BaseException:
        for path, value in settings.items():
            owner, _, name = path.rpartition(".")
            setattr(scene.path_resolve(owner) if owner else scene, name, value)
        kinds = [kind.identifier for kind in bpy.data.bl_rna.properties if kind.type == "COLLECTION"]
        blocks = [block for kind in kinds for block in getattr(bpy.data, kind) if block.session_uid > newest]
        bpy.data.batch_remove(blocks)
        raise


def values(scene: bpy.types.Scene) -> dict[str, Any]:
    """The settings of a scene that ``set_up`` changes by path, those that this Blender has."""
    settings = {}
    for path in _CHANGED:
        with suppress(ValueError):  # Cycles is an add-on, which may be off
            settings[path] = scene.path_resolve(path)
    return settings
