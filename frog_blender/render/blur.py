"""Depth of field and motion blur: an image is averaged over points of the lens and frames of the shutter time."""

import bpy
import numpy as np

from ..cameras import distance_added
from ..engine.errors import FrogError
from ..engine.playback.lens import Lens

SHUTTER_SAMPLES = 16  # frames that motion blur averages, unless the scene says otherwise
LENS_SAMPLES = 32  # points of the lens that depth of field averages
_LEAST_STOP = 1e-5  # as in Cycles
_GOLDEN = 0.618034  # of the number of samples: a step that spreads what follows one another


Sample = tuple[float | None, np.ndarray | None]
"""One image of an average: the frame of the scene, with its fraction, None for the rendered one; and the point (2,) of
the lens, right and up in world units, None for its middle."""


def sample_count(scene: bpy.types.Scene, has_lens: bool) -> int:
    """How many samples an image of a scene averages; 1 without either blur, which share them."""
    settings = scene.frog
    return max(settings.motion_samples if blurs_motion(scene.render) else 1, settings.lens_samples if has_lens else 1)


def blurs_motion(render: bpy.types.RenderSettings) -> bool:
    """Whether images are averaged over a shutter time."""
    return bool(render.use_motion_blur and render.motion_blur_shutter > 0)


def has_lens(camera: bpy.types.Object | None) -> bool:
    """Whether a camera has depth of field here; a panorama has none."""
    return camera is not None and camera.type == "CAMERA" and camera.data.type != "PANO" and camera.data.dof.use_dof


def samples(scene: bpy.types.Scene, frame: float, lens: Lens | None) -> list[Sample]:
    """The samples of one image; none without any blur.

    Args:
        scene: whose settings are in effect.
        frame: of the image.
        lens: of the camera, None for a pinhole.
    """
    moves, render = blurs_motion(scene.render), scene.render
    if not moves and lens is None:
        return []
    count = sample_count(scene, lens is not None)
    shutter = render.motion_blur_shutter, render.motion_blur_position
    frames = shutter_frames(frame, *shutter, count) if moves else [None] * count
    if lens is None:
        return [(frame, None) for frame in frames]
    # Neighbouring points of the lens must not be those of neighbouring times, or things would seem to be sheared.
    step = next(step for step in range(max(1, round(_GOLDEN * count)), 2 * count + 1) if np.gcd(step, count) == 1)
    points = lens.points(count)[np.arange(count) * step % count]
    return list(zip(frames, points, strict=True))


def shutter_frames(frame: float, shutter: float, position: str, samples: int) -> list[float]:
    """The frames sampled while a shutter is open for ``shutter`` frames, placed by Blender's "START", "CENTER" or
    "END" of the frame.
    """
    first = frame + {"START": 0.0, "CENTER": -0.5, "END": -1.0}[position] * shutter
    return [first + shutter * (index + 0.5) / samples for index in range(samples)]


def lens_of(eye: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> Lens | None:
    """The lens of an evaluated camera, in the engine camera's depths; None without depth of field. As in Cycles.

    Raises:
        FrogError: for a focus at the camera itself.
    """
    if not has_lens(eye):
        return None

    data, dof = eye.data, eye.data.dof
    focus, stop = _focus_distance(eye, depsgraph), max(dof.aperture_fstop, _LEAST_STOP)
    if not focus > 0:
        raise FrogError(f"Camera {eye.name}: found its focus at {focus:g}, expected it before the camera.")
    radius = (1.0 if data.type == "ORTHO" else data.lens * 1e-3) / (2 * stop)
    far = distance_added(data)
    return Lens(radius * (1 + far / focus), focus + far, dof.aperture_blades, dof.aperture_rotation, dof.aperture_ratio)


def _focus_distance(eye: bpy.types.Object, depsgraph: bpy.types.Depsgraph) -> float:
    dof = eye.data.dof
    if dof.focus_object is None:
        return float(dof.focus_distance)
    target = dof.focus_object.evaluated_get(depsgraph)
    matrix = target.matrix_world
    bone = target.pose.bones.get(dof.focus_subtarget) if target.pose is not None else None
    if bone is not None:
        matrix = matrix @ bone.matrix
    backwards = eye.matrix_world.col[2].to_3d().normalized()
    return float(abs(backwards.dot(eye.matrix_world.translation - matrix.translation)))
