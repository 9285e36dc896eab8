"""Make Proxy Mesh: what the capture shows in the scene's frames, as meshes that other engines and programs use."""

# mypy: disable-error-code="valid-type"

from functools import partial

import bpy

from ..engine.errors import FrogError
from ..engine.gaussians import NumpyGaussians
from ..engine.surfaces.proxy import make_proxy, steps_of
from ..lighting import proxy
from ..properties import choice, whole
from ..render.compositing import scenes
from ..scene_import.capture_objects import active_capture
from ..timeline import playback, retiming
from .bases import no_own_capture
from .modal_operator import Steps
from .timeline_visit import TimelineVisit, VisitsTimeline


class FROG_OT_make_proxy(VisitsTimeline, bpy.types.Operator):
    """Fuse what the capture's cameras see of it into a mesh that moves with it, in place of an earlier one. Crops and \
other edits count; after another edit or another timing, make it again. Press Esc or the right mouse button to stop"""

    bl_label = "Make Proxy Mesh"
    bl_options = {"UNDO"}  # not REGISTER: each change in the redo panel would fuse everything again

    use: choice(
        "For",
        "What the mesh is for",
        (
            (
                proxy.SHADOWS,
                "Shadows",
                "Catches shadows of your objects in Cycles; what moves casts shadows on them. Nothing else shows",
            ),
            (proxy.HOLDOUT, "Holdout", "Cuts holes where the capture hides your objects"),
            (proxy.PLAIN, "Mesh", "An ordinary mesh, for collisions and other programs"),
        ),
    )
    resolution: whole(
        "Resolution",
        "Voxels along the longest side of what the cameras see: twice as many take eight times as long",
        128,
        min=8,
        soft_min=32,
        soft_max=256,
        max=256,
    )
    frames: choice(
        "Frames",
        "Frames of the timeline in which to follow what moves",
        (
            ("SCENE", "Scene Range", "A mesh of what moves for each frame of the scene's frame range"),
            ("CURRENT", "Current Frame", "One mesh of everything, at the current frame"),
        ),
    )

    doing = "Making the proxy mesh: step {done:,} of {total:,}"
    stopped = "The proxy mesh was stopped. Nothing was changed."
    slice_seconds = 0.03

    @classmethod
    def problem(cls, context: bpy.types.Context) -> str:
        return no_own_capture(context)

    def invoke(self, context: bpy.types.Context, _event: bpy.types.Event) -> set[str]:
        self.is_interactive = True
        return context.window_manager.invoke_props_dialog(self, title="Make Proxy Mesh")

    def begin(self, context: bpy.types.Context) -> tuple[Steps, int]:
        obj, scene = active_capture(context), context.scene
        frames = list(range(scene.frame_start, scene.frame_end + 1))
        if self.frames == "CURRENT":
            frames = [scene.frame_current]
        frames = [frame for frame in frames if retiming.is_shown(obj, retiming.stretched(scene, frame))]
        if not frames:
            raise FrogError(f"{obj.name}: it is in none of these frames, as Limit in its timing says.")
        playing = playback.scene_time(obj, retiming.stretched(scene, frames[0])).scene
        if not playing.source.changing and not playback.needs_evaluation(obj):
            frames = frames[:1]
        visit = self.visiting(context, obj)
        return self._made(visit, frames, playing.keeps_identity), steps_of(len(frames))

    def _made(self, visit: TimelineVisit, frames: list[int], keeps_identity: bool) -> Steps:
        obj, _ = visit.found()
        cameras = playback.open_scene(playback.file_of(obj)).header.cameras
        gaussians = [partial(_gaussians_at, visit, frame) for frame in frames]
        made = yield from make_proxy(gaussians, cameras, self.resolution, keeps_identity=keeps_identity)
        obj, scene = visit.found()
        proxy.place(obj, scene, made, frames[0], self.use)
        scenes.follow_all()  # which sees what catches shadows
        quads = len(made.still.quads), [len(mesh.quads) for mesh in made.moving]
        moving = f", and {max(quads[1]):,} at most in {len(quads[1]):,} frames of what moves" if quads[1] else ""
        self.said = f"The proxy mesh has {quads[0]:,} faces{moving}; its detail is {made.voxel:.3g}."


def _gaussians_at(visit: TimelineVisit, frame: int) -> NumpyGaussians:
    """In the capture's own space."""
    return visit.at(frame).gaussians
