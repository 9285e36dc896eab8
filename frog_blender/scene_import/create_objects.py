"""A .frog file -> objects in a scene: a collection with a root, the Gaussians and the capture's cameras."""

from pathlib import Path

import bpy
import numpy as np
from mathutils import Matrix

from .. import point_cloud
from ..cameras import apply_lens, lens_of, pose_of
from ..engine.capture.camera import Camera
from ..engine.errors import FrogError, brief
from ..engine.scene.header import SceneHeader
from ..engine.source_media.clips import camera_path
from ..timeline import playback
from ..timeline.retiming import curves
from .capture_objects import HOLDS_CAMERAS, MADE_AS, stored_path
from .scene_setup import SETTINGS, all_or_nothing, set_up

_HANDLE = 0.25  # length of the root's axes, as a share of the capture's reach
_CAMERA = 0.03  # size of a drawn camera, as a share of its distance from the capture's middle


def import_scene(
    path: Path,
    scene: bpy.types.Scene,
    *,
    start_frame: float = 1.0,
    set_up_scene: bool = False,
    use_frog_engine: bool = False,
) -> bpy.types.Object:
    """Add a trained scene to ``scene`` and return the object that carries its Gaussians.

    Everything hangs on an empty in its middle, and stands where the capture's own coordinates say; move, turn or scale
    the empty to place it.

    Args:
        set_up_scene: match all of SETTINGS (see ``set_up``).
        use_frog_engine: render with FROG.

    Raises:
        FrogError: if the file cannot be played. Nothing of it is left in the scene then, nor in Blender's data.
    """
    try:
        with all_or_nothing(scene):
            obj, cameras = _add(path, scene, start_frame)
            header = playback.open_scene(path).header
            parts = (*(SETTINGS if set_up_scene else ()), *(("engine",) if use_frog_engine else ()))
            set_up(scene, header, start_frame, cameras, parts)
    except FrogError:
        raise
    except Exception as error:  # a header may contain anything
        raise FrogError(f"{path}: the scene could not be imported ({brief(repr(error))}).") from error
    return obj


def _add(path: Path, scene: bpy.types.Scene, start_frame: float) -> tuple[bpy.types.Object, list[bpy.types.Object]]:
    """The object with the Gaussians, playing, and the capture's cameras."""
    playable = playback.open_scene(path)
    header = playable.header
    collection = bpy.data.collections.new(path.stem)
    scene.collection.children.link(collection)
    time = playable.time_of(scene.frame_current_final - start_frame)
    gaussians = playable.at(time)
    root = _add_root(path.stem, gaussians.means, collection)
    obj = point_cloud.create(f"{path.stem} Gaussians", gaussians)
    point_cloud.holds(obj, playable, time)
    _adopt(obj, root, collection)
    # Moved alone they would leave their cameras.
    obj.lock_location = obj.lock_rotation = obj.lock_scale = (True, True, True)
    cameras = []
    if header.cameras:
        of_cameras = bpy.data.collections.new(f"{path.stem} Cameras")
        collection.children.link(of_cameras)
        holder = _add_holder(f"{path.stem} Rig", root, of_cameras)
        cameras = _add_cameras(header, start_frame, holder, of_cameras)
    for made in (collection, *collection.children, *collection.all_objects):
        made[MADE_AS] = made.name
    # Last: setting these plays the capture, which requires the object to be in its scene.
    obj.frog.start_frame = start_frame
    obj.frog.filepath = stored_path(path)
    return obj, cameras


def _add_root(name: str, means: np.ndarray, collection: bpy.types.Collection) -> bpy.types.Object:
    """What moves a capture: an empty in the middle of its points (N, 3), about which it turns and grows."""
    middle, reach = point_cloud.middle_of(means)
    root = bpy.data.objects.new(name, None)
    root.location = middle.tolist()
    root.empty_display_size = max(_HANDLE * reach, 0.01)
    collection.objects.link(root)
    return root


def _add_holder(name: str, root: bpy.types.Object, collection: bpy.types.Collection) -> bpy.types.Object:
    """What stands at the root between it and its cameras: Blender draws no lines to a parent that is not seen itself,
    as an object is that shows a collection in its place; and a dozen lines would cross the picture.
    """
    holder = bpy.data.objects.new(name, None)
    holder.instance_type = "COLLECTION"  # of none
    holder.show_instancer_for_viewport = holder.show_instancer_for_render = False
    holder.hide_render = True
    holder[HOLDS_CAMERAS] = True
    holder.matrix_basis = root.matrix_basis
    _adopt(holder, root, collection)
    return holder


def _adopt(obj: bpy.types.Object, parent: bpy.types.Object, collection: bpy.types.Collection) -> None:
    """Lets an object be moved by another at the root's place; it stays where it is."""
    obj.parent = parent
    obj.matrix_parent_inverse = parent.matrix_basis.inverted()
    collection.objects.link(obj)


def _add_cameras(
    header: SceneHeader, start_frame: float, holder: bpy.types.Object, collection: bpy.types.Collection
) -> list[bpy.types.Object]:
    """One Blender camera for each of the capture's cameras, or a single animated one for a moving camera."""
    if not header.is_moving:
        return [add_camera(camera.name, camera, holder, collection) for camera in header.cameras]
    path = camera_path(header)
    obj = add_camera("Moving Camera", path[0][1], holder, collection)
    animate(obj, path, start_frame)
    return [obj]


def add_camera(
    name: str, camera: Camera, holder: bpy.types.Object, collection: bpy.types.Collection
) -> bpy.types.Object:
    """A Blender camera that sees as one of the capture's would, and is moved by ``holder``."""
    data = bpy.data.cameras.new(name)
    apply_lens(data, camera)
    data.frog.capture_camera = camera.name
    obj = bpy.data.objects.new(name, data)
    obj.rotation_mode = "QUATERNION"
    obj.matrix_local = Matrix(pose_of(camera).tolist())
    data.clip_start, data.clip_end = 0.01, 10_000.0  # for other engines; FROG draws all that is in front
    data.display_size = max(_CAMERA * float(np.linalg.norm(camera.center - np.array(holder.location))), 0.01)
    _adopt(obj, holder, collection)
    return obj


def animate(obj: bpy.types.Object, path: list[tuple[int, Camera]], start_frame: float) -> None:
    """Keyframe the pose at every image, and the lens where it changes; straight lines between them."""
    lenses = [lens_of(camera) for _, camera in path]
    changing = [name for name in ("lens", "shift_x", "shift_y") if len({lens[name] for lens in lenses}) > 1]
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
    for animation in filter(None, (obj.animation_data, obj.data.animation_data)):
        for key in (key for curve in curves(animation) for key in curve.keyframe_points):
            key.interpolation = "LINEAR"  # whatever the user prefers for new keys
