"""Where viewports look from: whether somebody moved one, a look through a camera of a rig, and the way back; and what
Blender draws over FROG's own picture.

Nothing of it is in the file: a viewport is known by its address while the file is open.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import bpy
import numpy as np
from bpy.app import handlers as on
from mathutils import Matrix

from .. import addon_state, app_handlers, redrawing
from ..cameras import SENSOR_WIDTH, pose_of
from ..engine.capture.camera import Camera

_SHORTEST, _LONGEST = 1.0, 250.0  # lenses of a viewport, millimetres
_OVER_PICTURES = ("show_floor", "show_axis_x", "show_axis_y", "show_ortho_grid", "show_extras")
"""Overlays that lie over a rendered picture, which has no depth for them: the grid, empties, cameras and lights."""


@dataclass(frozen=True)
class Pose:
    """How a viewport looks at a scene, in Blender's own terms."""

    perspective: str
    lens: float
    distance: float
    location: tuple[float, ...]
    rotation: tuple[float, ...]

    @classmethod
    def of(cls, space: bpy.types.SpaceView3D) -> "Pose":
        """The present one."""
        view = space.region_3d
        place = tuple(view.view_location), tuple(view.view_rotation)
        return cls(view.view_perspective, space.lens, view.view_distance, *place)

    def take(self, space: bpy.types.SpaceView3D) -> None:
        """Makes a viewport look so."""
        view = space.region_3d
        view.view_perspective, space.lens, view.view_distance = self.perspective, self.lens, self.distance
        view.view_location, view.view_rotation = self.location, self.rotation

    def is_as(self, other: "Pose | None") -> bool:
        """Whether it is the same, but for rounding."""
        if other is None or self.perspective != other.perspective:
            return False
        mine, theirs = ([pose.lens, pose.distance, *pose.location, *pose.rotation] for pose in (self, other))
        return bool(np.allclose(mine, theirs, rtol=1e-4, atol=1e-5))


class Views:
    """What is known of viewports, by their address.

    Attributes:
        untouched: how each looked when its file was opened, or a capture was chosen or imported.
        looks: how it looked before it looked through a rig's camera, and how it does so since.
        covering: which overlays were switched off for FROG's picture.
    """

    def __init__(self) -> None:
        self.untouched: dict[int, Pose] = {}
        self.looks: dict[int, tuple[Pose, Pose]] = {}
        self.covering: dict[int, list[str]] = {}


def _views() -> Views:
    return addon_state.get(Views)


def _spaces() -> Iterator[bpy.types.SpaceView3D]:
    """Of all viewports, those of workspaces that no window shows as well."""
    for screen in bpy.data.screens:
        yield from (area.spaces.active for area in screen.areas if area.type == "VIEW_3D")


def count_as_untouched() -> None:
    """How viewports look now is not what the user chose."""
    _views().untouched = {space.as_pointer(): Pose.of(space) for space in _spaces()}


def is_untouched(space: bpy.types.SpaceView3D) -> bool:
    """Whether nobody moved a viewport since ``count_as_untouched``."""
    return Pose.of(space).is_as(_views().untouched.get(space.as_pointer()))


def through(camera: Camera, distance: float, size: tuple[int, int]) -> Pose:
    """The pose that sees all that a camera does, in a viewport of a size in pixels.

    Args:
        distance: from the camera, of what is turned around.
    """
    matrix, widest = pose_of(camera), max(size)
    extents = camera.width / camera.intrinsics[0, 0] / size[0], camera.height / camera.intrinsics[1, 1] / size[1]
    lens = 2 * SENSOR_WIDTH / (widest * max(extents))  # twice: Blender's own factor for free views
    location = matrix[:3, 3] - distance * matrix[:3, 2]
    rotation = Matrix(matrix.tolist()).to_quaternion()
    return Pose("PERSP", min(max(lens, _SHORTEST), _LONGEST), distance, tuple(location.tolist()), tuple(rotation))


def look(space: bpy.types.SpaceView3D, pose: Pose) -> None:
    """Looks through a camera of a rig, and remembers the way back."""
    looks, address = _views().looks, space.as_pointer()
    before = looks[address][0] if is_through(space) else Pose.of(space)
    pose.take(space)
    looks[address] = before, Pose.of(space)  # as Blender rounds it


def is_through(space: bpy.types.SpaceView3D) -> bool:
    """Whether a viewport still looks as ``look`` left it."""
    look = _views().looks.get(space.as_pointer())
    return look is not None and Pose.of(space).is_as(look[1])


def back(space: bpy.types.SpaceView3D) -> None:
    """Looks as before ``look``."""
    if (look := _views().looks.pop(space.as_pointer(), None)) is not None:
        look[0].take(space)


def is_frog_picture(scene: bpy.types.Scene, space: bpy.types.SpaceView3D) -> bool:
    """Whether a viewport of a scene shows what the FROG engine draws."""
    return space.shading.type == "RENDERED" and scene.render.engine == "FROG"


def clear_picture(scene: bpy.types.Scene, space: bpy.types.SpaceView3D) -> None:
    """Has overlays that lie over FROG's picture switched off once, and on again where another one is shown. To be
    called when a viewport is drawn.
    """
    if is_frog_picture(scene, space) != (space.as_pointer() in _views().covering):
        app_handlers.later(_switch_overlays)


def _switch_overlays() -> None:
    covering = _views().covering
    for window in bpy.context.window_manager.windows:
        for area in window.screen.areas:
            if area.type != "VIEW_3D":
                continue
            space = area.spaces.active
            is_shown, address = is_frog_picture(window.scene, space), space.as_pointer()
            if is_shown and address not in covering:
                covering[address] = [name for name in _OVER_PICTURES if getattr(space.overlay, name)]
                _set(space, covering[address], False)
            elif not is_shown:
                _set(space, covering.pop(address, []), True)
    redrawing.viewports()


def _set(space: bpy.types.SpaceView3D, names: list[str], is_shown: bool) -> None:
    for name in names:
        setattr(space.overlay, name, is_shown)


def _show_overlays(*_: object) -> None:
    """All of them again: a file keeps what the user chose."""
    covering = _views().covering
    for space in _spaces():
        _set(space, covering.pop(space.as_pointer(), []), True)


def _on_load(*_: object) -> None:
    addon_state.put(Views())
    count_as_untouched()


HANDLERS = [(on.load_post, _on_load), (on.save_pre, _show_overlays)]


def register() -> None:
    if not bpy.app.background:
        app_handlers.later(count_as_untouched, persistent=True)


def unregister() -> None:
    app_handlers.not_later(count_as_untouched, _switch_overlays)
    _show_overlays()
