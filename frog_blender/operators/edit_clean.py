"""Selecting, hiding and cleaning up the Gaussians of a capture."""

# mypy: disable-error-code="valid-type"

from collections.abc import Callable
from functools import partial

import bpy
import numpy as np

from ..engine.editing import selections
from ..engine.editing.clean_up import CLEANING, CLUSTERS, LOOKING, CleanUp, clean_up
from ..engine.editing.selections import combined, grown
from ..engine.errors import FrogError
from ..engine.playback.player import ScenePlayer
from ..properties import choice, number, switch, whole
from ..tasks.scene_work import SceneWork
from ..timeline import playback
from ..ui.sidebar_panel import split
from .bases import UNDOABLE, KeyedOperator, TaskOperator, chosen_in, mark, scene_of, select
from .worked_out import Tell, Work, WorkedOutEdit, cluster_sizes_of, weights_of

CRITERIA = (
    ("OPACITY", "Faint", "Whose opacity is small at all times"),
    ("SIZE", "Large", "Whose largest standard deviation is large"),
    ("DISTANCE", "Far Away", "That are far from the 3D cursor"),
    ("CAMERAS", "Seen by Few Cameras", "That few of the capture's cameras see"),
    ("CLUSTER", "Floaters", "In small clusters that touch nothing else"),
    ("DYNAMIC", "Dynamic", "That change in time"),
    ("STATIC", "Static", "That do not change in time"),
    ("HIDDEN", "Hidden", "That are hidden now"),
)
_LIMITS = {"OPACITY": "opacity", "SIZE": "size", "DISTANCE": "distance", "CAMERAS": "cameras", "CLUSTER": "members"}
"""The property that a criterion asks for."""
_GROWING = "Finding what is near"
MODES = (
    ("SET", "Set", "Select these alone"),
    ("EXTEND", "Extend", "Select these as well"),
    ("SUBTRACT", "Subtract", "Deselect these"),
    ("INTERSECT", "Intersect", "Keep those of the selected that are among these"),
)


class FROG_OT_select_gaussians(WorkedOutEdit, bpy.types.Operator):
    """Select Gaussians of the capture by what they are"""

    bl_label = "Select Gaussians"
    bl_options = UNDOABLE  # what takes a while is found once, for whichever limit

    by: choice("By", "Which to select", CRITERIA, "CLUSTER")
    mode: choice("Mode", "What to do with those selected before", MODES, "SET")
    opacity: number("Opacity", "The largest opacity", 0.1, min=0.0, max=1.0, subtype="FACTOR")
    size: number("Size", "The least standard deviation, in the capture's units", 0.5, min=0.0)
    distance: number("Distance", "The least distance, in the capture's units", 5.0, min=0.0)
    cameras: whole("Fewer Than", "Cameras that see one", 2, min=1, soft_max=20)
    members: whole("Fewer Than", "Gaussians in a cluster", 50, min=2, soft_max=1000)

    def draw(self, _context: bpy.types.Context) -> None:
        layout = split(self.layout)
        layout.prop(self, "mode")
        if self.by in _LIMITS:
            layout.prop(self, _LIMITS[self.by])

    plan = ((LOOKING, 1.0), (CLUSTERS, 1.0))

    def work_out(self, context: bpy.types.Context, obj: bpy.types.Object, scene: ScenePlayer) -> Work:
        center, time = np.array(obj.matrix_world.inverted_safe() @ context.scene.cursor.location), _time(context, obj)
        opacity, size, distance, cameras, members = (getattr(self, name) for name in _LIMITS.values())
        criteria: dict[str, Callable[[Tell], np.ndarray]] = {
            "OPACITY": lambda _: selections.by_opacity(scene, opacity),
            "SIZE": lambda _: selections.by_size(scene, size),
            "DISTANCE": lambda _: selections.by_distance(scene, center, distance, time),
            "CAMERAS": lambda tell: selections.by_cameras(weights_of(scene, tell), cameras),
            "CLUSTER": lambda tell: cluster_sizes_of(scene, tell) < members,
            "DYNAMIC": lambda _: selections.dynamic(scene),
            "STATIC": lambda _: ~selections.dynamic(scene),
        }
        hidden = chosen_in(obj.frog_edits.hidden, scene)  # here, since it is Blender's
        return criteria.get(self.by, lambda _: hidden)

    def apply(self, _context: bpy.types.Context, obj: bpy.types.Object, result: np.ndarray) -> str:
        return select(obj, combined(chosen_in(obj.frog_edits.selection, scene_of(obj)), result, self.mode))


class FROG_OT_select_gaussians_all(KeyedOperator, bpy.types.Operator):
    """Select all Gaussians of the capture, none, or those that are not selected"""

    bl_label = "Select All Gaussians"

    action: choice(
        "Action",
        "",
        (("ALL", "All", "Select all"), ("NONE", "None", "Select none"), ("INVERT", "Invert", "Select the others")),
    )

    def edit(self, _context: bpy.types.Context, obj: bpy.types.Object) -> None:
        scene = scene_of(obj)
        if self.action == "INVERT":
            chosen = ~chosen_in(obj.frog_edits.selection, scene)
        else:
            chosen = np.full(scene.count, self.action == "ALL")
        select(obj, chosen)


class FROG_OT_grow_selection(KeyedOperator, WorkedOutEdit, bpy.types.Operator):
    """Select the Gaussians near selected ones as well, or deselect those near others"""

    bl_label = "Grow Selection"
    needs = "selection"
    plan = ((_GROWING, 1.0),)

    shrink: switch("Shrink", "Deselect those near others")
    distance: number("Distance", "How near, in the capture's units. 0 for its own Grow By", min=0.0, soft_max=1.0)

    def work_out(self, context: bpy.types.Context, obj: bpy.types.Object, scene: ScenePlayer) -> Work:
        time, shrink, distance = _time(context, obj), self.shrink, self.distance or obj.frog_edits.grow_distance
        chosen = chosen_in(obj.frog_edits.selection, scene) ^ shrink  # what grows where a selection shrinks

        def work(tell: Tell) -> np.ndarray:
            reach = distance or selections.spacing(scene, time)
            return grown(scene, chosen, reach, time, partial(tell, _GROWING)) ^ shrink

        return work

    def apply(self, _context: bpy.types.Context, obj: bpy.types.Object, result: np.ndarray) -> str:
        return select(obj, result)


class FROG_OT_hide_gaussians(KeyedOperator, bpy.types.Operator):
    """Hide the selected Gaussians at all times, in viewports, renders and exports. The .frog file keeps them"""

    bl_label = "Hide Gaussians"
    needs = "selection"

    unselected: switch("Unselected", "Hide those that are not selected")

    def edit(self, _context: bpy.types.Context, obj: bpy.types.Object) -> str:
        scene, settings = scene_of(obj), obj.frog_edits
        chosen = chosen_in(settings.selection, scene)
        chosen = ~chosen if self.unselected else chosen
        if not chosen.any():
            raise FrogError(f"{obj.name}: found no Gaussian to hide, expected a selection.")
        mark(settings.hidden, scene, chosen_in(settings.hidden, scene) | chosen)
        if not self.unselected:
            select(obj, np.zeros(scene.count, bool))
        return f"{np.count_nonzero(chosen_in(settings.hidden, scene)):,} of {scene.count:,} Gaussians are hidden."


class FROG_OT_restore_gaussians(KeyedOperator, bpy.types.Operator):
    """Show the hidden Gaussians that are selected, or all if none of them is selected"""

    bl_label = "Restore Gaussians"
    needs = "hidden"

    all: switch("All", "Show those that are not selected as well")

    def edit(self, _context: bpy.types.Context, obj: bpy.types.Object) -> str:
        scene, settings = scene_of(obj), obj.frog_edits
        hidden, chosen = chosen_in(settings.hidden, scene), chosen_in(settings.selection, scene)
        left = hidden & ~chosen if (hidden & chosen).any() and not self.all else np.zeros(scene.count, bool)
        mark(settings.hidden, scene, left)
        return f"{np.count_nonzero(hidden & ~left):,} Gaussians are shown again."


class FROG_OT_clean_up(WorkedOutEdit, bpy.types.Operator):
    """Hide what no training image misses, and what hangs alone. Surfaces that only one camera sees stay. Esc stops"""

    bl_label = "Clean Up"
    stopped = "Clean Up was stopped. Nothing is hidden."
    plan = CLEANING

    def work_out(self, _context: bpy.types.Context, obj: bpy.types.Object, scene: ScenePlayer) -> Work:
        strength = obj.frog_edits.clean_strength
        return lambda tell: clean_up(scene, strength, weights_of(scene, tell), tell)

    def apply(self, _context: bpy.types.Context, obj: bpy.types.Object, result: CleanUp) -> str:
        scene, settings = scene_of(obj), obj.frog_edits
        mark(settings.hidden, scene, chosen_in(settings.hidden, scene) | result.hidden)
        return f"Hid {result.unmissed:,} Gaussians that no image misses, and {result.floaters:,} that hang alone."


class FROG_OT_cancel_edit(TaskOperator, bpy.types.Operator):
    """Stop what is worked out. Nothing has changed yet"""

    kind = SceneWork


def _time(context: bpy.types.Context, obj: bpy.types.Object) -> float:
    return playback.scene_time(obj, context.scene.frame_current_final).time
