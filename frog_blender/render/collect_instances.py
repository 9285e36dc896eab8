"""Collects the Gaussians of all visible captures at the evaluated frame, in world space."""

from typing import Any

import bpy
import numpy as np

from .. import point_cloud
from ..capture_files import is_capture
from ..engine.errors import FrogError
from ..engine.gaussians import GaussianArrays, joined
from ..engine.playback.transform import rotation_and_scale, transform
from ..timeline import playback
from ..timeline.playback_cache import SceneTime


def gather(
    depsgraph: bpy.types.Depsgraph,
    space: bpy.types.SpaceView3D | None = None,
    problems: list[str] | None = None,
    image_frame: float | None = None,
) -> tuple[GaussianArrays | None, np.ndarray]:
    """All visible captures at the evaluated frame, in world space, and the first one's display background (3,).

    Each keeps its own low-pass. None stands for no capture at all.  A capture that cannot be played raises FrogError: a
    render must not lie.

    Args:
        space: the 3D viewport that is drawn; None for a render.
        problems: takes a sentence for each capture that cannot be played, which is then left out instead of raising.
        image_frame: of a render's image, where the evaluated frame is a sample of its shutter time.
    """
    parts: list[GaussianArrays] = []
    background = np.zeros(3, dtype=np.float32)
    for obj, shown, matrix in visible_captures(depsgraph, space):
        try:
            part = placed(scene_time(depsgraph, obj, shown, space, image_frame).gaussians(), matrix, obj.name)
        except FrogError as error:
            if problems is None:
                raise
            problems.append(str(error))
            continue
        if not parts:
            background = np.asarray(playback.open_scene(playback.file_of(obj)).header.background, dtype=np.float32)
        parts.append(part)

    return (joined(parts) if parts else None), background


def scene_time(
    depsgraph: bpy.types.Depsgraph,
    obj: bpy.types.Object,
    evaluated: bpy.types.Object,
    space: bpy.types.SpaceView3D | None = None,
    image_frame: float | None = None,
) -> SceneTime:
    """What a capture shows at the evaluated frame; FrogError for one that cannot be played.

    Args:
        obj, evaluated: as ``visible_captures`` gives them.
        space: the 3D viewport that is drawn, which may show more than a render; None for a render.
        image_frame: see ``gather``.
    """
    frame, playing = depsgraph.scene.frame_current_final, playback.opened(obj, is_thinned=False)
    return playing.in_viewport(frame, evaluated) if space is not None else playing.whole(frame, evaluated, image_frame)


def visible_captures(
    depsgraph: bpy.types.Depsgraph, space: bpy.types.SpaceView3D | None = None
) -> list[tuple[bpy.types.Object, bpy.types.Object, np.ndarray]]:
    """The object, the evaluated object and the (4, 4) matrix of every visible capture, duplicates and instances
    included. Objects with zero scale are skipped.

    Of a duplicate it is the evaluated object that is duplicated: its own is only valid until the next one.
    """
    captures = []
    for instance in depsgraph.object_instances:
        shown, own = instance.object, instance.object.original
        if not is_capture(own) or not is_seen(instance, depsgraph.view_layer, space):
            continue
        if not point_cloud.is_original(shown, own) and (own.mode != "EDIT" or instance.is_instance):
            continue
        matrix = np.array(instance.matrix_world, dtype=np.float64)
        if matrix[:3, :3].any():
            captures.append((own, instance.instance_object if instance.is_instance else shown, matrix))
    return captures


def is_seen(
    instance: bpy.types.DepsgraphObjectInstance, layer: bpy.types.ViewLayer, space: bpy.types.SpaceView3D | None = None
) -> bool:
    """Whether an object of a depsgraph is visible to cameras, as in Cycles, and in a viewport."""
    shown, own = instance.object, instance.object.original
    if space is not None and not instance.is_instance and not own.visible_in_viewport_get(space):
        return False  # Local View, or a kind of object that the viewport hides
    return instance.show_self and shown.visible_camera and not own.indirect_only_get(view_layer=layer)


def pass_indices(depsgraph: bpy.types.Depsgraph) -> list[tuple[int, int]]:
    """Number of Gaussians and Pass Index of each visible capture, in the order of ``gather``."""
    captures = visible_captures(depsgraph)
    return [(scene_time(depsgraph, obj, shown).scene.count, obj.pass_index) for obj, shown, _ in captures]


def placed(gaussians: GaussianArrays, matrix: np.ndarray, name: str) -> GaussianArrays:
    """Gaussians transformed by a (4, 4) matrix of rotation, uniform scale and translation; FrogError for another
    matrix.
    """
    if np.array_equal(matrix, np.eye(4)):
        return gaussians  # the usual case, and bit for bit what the engine draws
    check_placement(matrix, name)
    return transform(gaussians, matrix)


def check_placement(matrix: Any, name: str) -> None:
    """Raises FrogError if Gaussians cannot be transformed by an object's matrix."""
    try:
        rotation_and_scale(np.array(matrix, dtype=np.float64))
    except FrogError as error:
        raise FrogError(f"{name}: {error}") from error
