"""A .frog file -> objects in a scene: a collection with a root, the Gaussians and the capture's cameras."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
import numpy as np
from mathutils import Matrix

from .. import carrier, playback
from ..blender_camera import apply_lens, lens_of, pose_of
from ..colors import into_working_space, to_linear
from ..engine.clips import camera_path, moves_alone
from .camera_clips import add_clips
from .imported import stored_path

if TYPE_CHECKING:
    from ..engine.capture.camera import Camera
    from ..engine.files import SceneHeader

_BACKGROUND_WORLD = "FRoG Background"
_LAYERS = 1024  # of splats that rays of Cycles go through: as many as it allows


def materialize(
    path: Path,
    scene: Any,
    *,
    start_frame: float = 1.0,
    set_up_scene: bool = True,
    use_frog_engine: bool = True,
    show_clips: bool = True,
) -> Any:
    """Add a trained scene to ``scene`` and return the object that carries its Gaussians.

    Everything hangs on an empty at the origin, so that the capture keeps its own coordinates and its cameras see what
    they saw; move, turn or scale the empty to place it.  Raises FrogError if the file cannot be played.
    """
    playable = playback.open_scene(path)
    header = playable.header
    collection = bpy.data.collections.new(path.stem)
    scene.collection.children.link(collection)
    root = bpy.data.objects.new(path.stem, None)
    collection.objects.link(root)

    obj = carrier.create(f"{path.stem} Gaussians", playable.at_frame(scene.frame_current_final - start_frame))
    _adopt(obj, root, collection)
    cameras = _add_cameras(header, start_frame, root, collection)
    if set_up_scene:
        _set_up(scene, header, start_frame, cameras)
    if use_frog_engine:
        scene.render.engine = "FROG"
        _look_at_it(scene, through_camera=set_up_scene and bool(cameras))
    # Last: setting them plays the capture, which needs the object in its scene.
    obj.frog.start_frame = start_frame
    obj.frog.filepath = stored_path(path)
    if show_clips:
        add_clips(obj)
    return obj


def _adopt(obj: Any, root: Any, collection: Any) -> None:
    obj.parent = root
    collection.objects.link(obj)


def _add_cameras(header: SceneHeader, start_frame: float, root: Any, collection: Any) -> list[Any]:
    """One Blender camera for each of the capture's, or a single animated one for a capture by a moving camera."""
    if not moves_alone(header):
        return [_add_camera(camera.name, camera, root, collection) for camera in header.cameras]
    path = camera_path(header)
    obj = _add_camera("Moving Camera", path[0][1], root, collection)
    _animate(obj, path, start_frame)
    return [obj]


def _add_camera(name: str, camera: Camera, root: Any, collection: Any) -> Any:
    data = bpy.data.cameras.new(name)
    apply_lens(data, camera)
    data.frog.capture_camera = camera.name
    obj = bpy.data.objects.new(name, data)
    obj.rotation_mode = "QUATERNION"
    obj.matrix_local = Matrix(pose_of(camera).tolist())
    center_distance = np.linalg.norm(camera.center)
    data.clip_start, data.clip_end = 0.01, 10_000.0  # for other engines; FROG draws all that is in front
    data.display_size = max(float(center_distance) * 0.05, 0.01)
    _adopt(obj, root, collection)
    return obj


def _animate(obj: Any, path: list[tuple[int, Camera]], start_frame: float) -> None:
    """Keyframe the pose at every picture, and the lens where it changes; straight lines between them."""
    lenses = np.array([list(lens_of(camera).values())[:3] for _, camera in path])
    changing = [
        name for name, spread in zip(("lens", "shift_x", "shift_y"), np.ptp(lenses, axis=0), strict=True) if spread
    ]
    edit = bpy.context.preferences.edit
    usual = edit.keyframe_new_interpolation_type
    edit.keyframe_new_interpolation_type = "LINEAR"
    try:
        before = None
        for frame, camera in path:
            location, rotation, _ = Matrix(pose_of(camera).tolist()).decompose()
            if before is not None:
                rotation.make_compatible(before)  # the near one of the two signs, or the camera spins between frames
            before = rotation
            obj.location, obj.rotation_quaternion = location, rotation
            for channel in ("location", "rotation_quaternion"):
                obj.keyframe_insert(channel, frame=start_frame + frame)
            apply_lens(obj.data, camera)
            for channel in changing:
                obj.data.keyframe_insert(channel, frame=start_frame + frame)
    finally:
        edit.keyframe_new_interpolation_type = usual


def _set_up(scene: Any, header: SceneHeader, start_frame: float, cameras: list[Any]) -> None:
    """Make the scene film what the capture filmed: time, size, camera, background, and colours as they are."""
    if header.frame_count > 1:  # a still capture leaves the scene its time
        scene.frame_start = round(start_frame)
        scene.frame_end = max(round(start_frame) + header.frame_count - 1, scene.frame_start)
        # Blender keeps a whole number of frames and a divisor: 29.97 is 30 over 1.001.
        whole = max(round(header.frames_per_second), 1)
        scene.render.fps, scene.render.fps_base = whole, whole / max(header.frames_per_second, 0.01)
    if cameras:
        look_through(scene, cameras[0])
    # Another scene's is of another capture.
    has_one = scene.world is not None and scene.world.name.startswith(_BACKGROUND_WORLD)
    world = scene.world if has_one else bpy.data.worlds.new(_BACKGROUND_WORLD)
    background = into_working_space(to_linear(np.array(header.background)))
    world.color = background
    if world.node_tree is not None:
        for node in world.node_tree.nodes:
            if node.type == "BACKGROUND":
                node.inputs["Color"].default_value = (*background.tolist(), 1.0)
                node.inputs["Strength"].default_value = 1.0
    scene.world = world
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"
    scene.render.dither_intensity = 0.0
    if hasattr(scene, "cycles"):  # rays that end at the usual 8 layers see a third of the light
        scene.cycles.transparent_max_bounces = max(scene.cycles.transparent_max_bounces, _LAYERS)
    # A window draws while a render evaluates frames in its own thread; locked, they do not share the Gaussians.
    scene.render.use_lock_interface = True


def _look_at_it(scene: Any, *, through_camera: bool) -> None:
    """Viewports of the scene that show surfaces only, of which Gaussians have none, become rendered ones."""
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas if window.scene == scene else ():
            space = area.spaces.active
            if area.type == "VIEW_3D" and space.shading.type in ("SOLID", "WIREFRAME"):
                space.shading.type = "RENDERED"
                if through_camera and scene.camera is not None:
                    space.region_3d.view_perspective = "CAMERA"


def look_through(scene: Any, camera: Any) -> None:
    """Make a camera the active one, at the size of the pictures that it took."""
    scene.camera = camera
    width, height = camera.data.frog.size
    if width and height:
        scene.render.resolution_x, scene.render.resolution_y = width, height
        scene.render.resolution_percentage = 100
        scene.render.pixel_aspect_x = scene.render.pixel_aspect_y = 1.0
