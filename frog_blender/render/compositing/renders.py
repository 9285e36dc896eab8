"""Renders of composed images: complete, or stopped with a message.

Blender renders the scenes that a compositor shows after the scene that F12 was pressed in, by the first one's size and
region, and goes on whatever happens there. So what can be known is looked for before the first one starts, and stops
it; what comes later fills FRoG's image with a pattern that nobody takes for a result, and ends an animation. Blender
ends with exit status 0 whatever becomes of its images, so that a render farm would take them for results: here it does
not.
"""

import atexit
import os
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import bpy
from bpy.app import handlers as on

from ... import addon_state, app_handlers
from ...engine.errors import FrogError, listed
from ...timeline import playback
from ...timeline.render_thread import in_main_thread
from ...timeline.retiming import LAST_FRAME
from ..collect_instances import check_placement
from ..panoramic_camera import check_lens
from . import compositor, scenes

FAILED = 1
_RENDERING = {"-a", "--render-anim", "-f", "--render-frame"}


@dataclass
class _Render:
    """The current render, or what is left to tell of the last one.

    Attributes:
        scene: that F12 was pressed in; None while nothing is rendered.
        splats: the scene of captures that is to be laid over it.
        refusal: why there is to be no image; empty if nothing is wrong.
        kept: settings of the scene, while others take their place in order to stop the render.
        drawn: whether FRoG has drawn the present frame.
        failure: why it could not.
        frame: where the scene stood before the animation was ended.
        problems: a sentence each.
        film: that one was made, as a sentence.
    """

    scene: Any = None  # Any: a Scene that may be gone, which each access of it tells
    splats: bpy.types.Scene | None = None
    refusal: str = ""
    kept: dict[str, Any] = field(default_factory=dict)
    drawn: bool = False
    failure: str = ""
    frame: int | None = None
    problems: list[str] = field(default_factory=list)
    film: str = ""


def _current() -> _Render:
    return addon_state.get(_Render)


def problems() -> list[str]:
    """Problems of the last render, for the panel."""
    return _current().problems


def film() -> str:
    """Which film the last render has made, as a sentence; "" for none."""
    return _current().film


def leading(scene: bpy.types.Scene) -> bpy.types.Scene:
    """The scene whose render this scene is part of. Blender uses its size, region and time. The scene itself if it
    is rendered alone.
    """
    first = _current().scene
    with suppress(ReferenceError):  # that scene is gone, and the end of its render was not reported
        if first is not None and first.name:
            return first
    return scene.frog.composed_with or scene


def check(scene: bpy.types.Scene) -> None:
    """Raises FrogError if a scene that FROG is about to draw must not be rendered."""
    first = leading(scene)
    if refusal := _current().refusal:
        raise FrogError(refusal)
    if first != scene and scene.frog.composed_with not in (None, first):
        raise FrogError(foreign(first, scene))


def note_drawn(scene: bpy.types.Scene, has_captures: bool) -> None:
    """Notes that FROG has drawn an image."""
    render = _current()
    if scene != render.splats or render.drawn:
        return
    render.drawn = True
    if not has_captures and not problems():
        _report(
            f"{leading(scene).name} shows no capture at frame {leading(scene).frame_current}. The image has the "
            "objects only."
        )


def note_failure(scene: bpy.types.Scene, sentence: str) -> bool:
    """Notes why FROG could not draw. Returns whether the image is part of another scene's render."""
    _end_with_failure()
    if leading(scene) == scene:
        return False
    _current().failure = sentence
    return True


def _end_with_failure() -> None:
    """Lets a Blender that renders what its command line asks for end with ``FAILED``; does nothing in another one."""
    if bpy.app.background and not bpy.app.module and is_render(sys.argv):
        atexit.unregister(_end)
        atexit.register(_end)  # at once would lose what Blender has still to write


def is_render(arguments: Sequence[str]) -> bool:
    """Whether Blender's command line asks for frames; what follows ``--`` is not Blender's."""
    own = arguments[: arguments.index("--")] if "--" in arguments else arguments
    return not _RENDERING.isdisjoint(own)


def _end() -> None:
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(FAILED)


def _report(sentence: str) -> None:
    print(f"FRoG: {sentence}", file=sys.stderr)
    problems().append(sentence)


def _on_init(scene: bpy.types.Scene, *_: Any) -> None:
    _restore()
    render = _Render(scene)
    addon_state.put(render)
    if in_main_thread():
        scenes.follow_all()
    render.refusal = trouble(scene)
    render.splats = scenes.overlay_of(scene)
    if render.refusal and in_main_thread() and scene.render.engine != "FROG":
        _stop(render)


def _stop(render: _Render) -> None:
    """Stops a render before it begins. The only way is to let an engine refuse; compositor and sequencer are
    disabled because they might not call it.
    """
    instead = {"engine": "FROG", "use_compositing": False, "use_sequencer": False}
    settings = render.scene.render
    render.kept = {name: getattr(settings, name) for name in instead}
    for name, value in instead.items():
        setattr(settings, name, value)


def _on_pre(scene: bpy.types.Scene, *_: Any) -> None:
    render = _current()
    if scene == render.scene:
        render.drawn, render.failure = False, ""
        if in_main_thread() and not render.kept:
            scenes.follow_all(objects_changed=False)  # settings may be animated


def _on_post(scene: bpy.types.Scene, *_: Any) -> None:
    """Collects the problems of this frame."""
    render = _current()
    if scene != render.scene or render.kept:
        return
    failure = render.failure
    if not failure and render.splats is not None and not render.drawn:
        failure = f"{render.splats.name} was not rendered. The captures are missing from the image."
    if failure:
        _end_with_failure()
    if failure and failure not in problems():
        _report(failure)
    render.failure = failure


def _on_write(scene: bpy.types.Scene, *_: Any) -> None:
    """Ends an animation whose image has failed, and notes the last image of a film."""
    render = _current()
    is_last = scene.render.is_movie_format and scene.frame_current + scene.frame_step > scene.frame_end
    if scene == render.scene and is_last and not render.problems:
        render.film = f"{Path(scene.render.frame_path()).name} is rendered."
    if scene == render.scene and render.failure and render.frame is None:
        render.frame, scene.frame_current = scene.frame_current, LAST_FRAME


def _on_end(scene: bpy.types.Scene, *_: Any) -> None:
    if scene == _current().scene:
        _restore()
        addon_state.put(_Render(problems=problems(), film=film()))


def _restore() -> None:
    """Restores the settings that were changed to stop the render."""
    render = _current()
    with suppress(ReferenceError):  # the scene is gone
        for name, value in render.kept.items():
            setattr(render.scene.render, name, value)
        if render.frame is not None and render.scene.frame_current == LAST_FRAME:
            render.scene.frame_current = render.frame
    render.kept, render.frame = {}, None


def _on_save_pre(*_: Any) -> None:
    if not bpy.app.is_job_running("RENDER"):
        _restore()


def _on_load_pre(*_: Any) -> None:
    addon_state.reset(_Render)


HANDLERS: app_handlers.Handlers = [
    (on.render_init, _on_init),
    (on.render_pre, _on_pre),
    (on.render_post, _on_post),
    (on.render_write, _on_write),
    (on.render_complete, _on_end),
    (on.render_cancel, _on_end),
    (on.save_pre, _on_save_pre),
    (on.load_pre, _on_load_pre),
]


def trouble(scene: bpy.types.Scene) -> str:
    """Why a scene cannot be rendered with its captures, in a sentence; empty if it can."""
    try:
        _check_layers(scene)
        splats = scenes.overlay_of(scene)
        if splats is not None:
            _check_settings(scene, splats)
            _check_captures(scene)
    except FrogError as error:
        return str(error)
    return ""


def _check_layers(scene: bpy.types.Scene) -> None:
    for other in compositor.shown_scenes(scene):
        if other.frog.composed_with not in (None, scene, other):
            raise FrogError(foreign(scene, other))
    if scene.render.engine == "FROG" or scenes.overlay_of(scene) is not None:
        return
    for obj in _rendered_captures(scene):
        if obj.frog.laid_over:
            raise FrogError(
                f"{obj.name} is not rendered in {scene.name}, because FRoG renders it in another scene of the same "
                f"objects. Run Render With My Objects in {scene.name} as well."
            )


def foreign(scene: bpy.types.Scene, splats: bpy.types.Scene) -> str:
    return (
        f"The compositor of {scene.name} shows {splats.name}, which follows {splats.frog.composed_with.name}. Run "
        f"Render With My Objects in {scene.name}."
    )


def _check_settings(scene: bpy.types.Scene, splats: bpy.types.Scene) -> None:
    if scene.render.engine == "FROG":
        raise FrogError(
            f"{scene.name} is rendered by FRoG, and {splats.name} is overlaid on it once more. Choose another engine "
            "or disable Compositing."
        )
    if scene.render.use_single_layer:
        raise FrogError(f"{scene.name} renders a single layer, without {splats.name}. Disable Render Single Layer.")
    if splats not in compositor.rendered_scenes(scene):
        raise FrogError(f"Blender does not render {splats.name} from within a node group. Ungroup its nodes.")
    shown = compositor.layers_shown_of(scene)
    if shown and shown.isdisjoint(layer.name for layer in scenes.rendered_layers(scene)):
        raise FrogError(
            f"The compositor of {scene.name} shows its view layer {listed(sorted(shown))}, which is not rendered. Use "
            "it for rendering, or choose another one in the node Render Layers."
        )
    cannot_follow = splats.library is not None or not in_main_thread()
    if cannot_follow and scenes.structural_changes(splats):
        raise FrogError(f"{splats.name} does not have the same objects as {scene.name}. Render again.")
    if scene.camera is not None:
        check_lens(scene.camera, scene.render)
    world = scene.rigidbody_world
    if world is not None and world.enabled and world.collection is not None:
        for obj in world.collection.objects:
            if obj.rigid_body is not None and obj.rigid_body.type == "ACTIVE" and not obj.rigid_body.kinematic:
                raise FrogError(
                    f"{obj.name} is moved by a simulation, which {splats.name} does not have. Bake it to keyframes "
                    "(Object > Rigid Body > Bake to Keyframes)."
                )


def _check_captures(scene: bpy.types.Scene) -> None:
    for obj in _rendered_captures(scene):
        playback.open_scene(playback.file_of(obj))
        if any(map(any, obj.matrix_world.to_3x3())):  # scaled to nothing, it is not drawn
            check_placement(obj.matrix_world, obj.name)


def _rendered_captures(scene: bpy.types.Scene) -> list[bpy.types.Object]:
    """The captures that renders of a scene show, as far as its collections tell."""
    objects: dict[bpy.types.Object, None] = {}
    to_look_at = [layer.layer_collection for layer in scenes.rendered_layers(scene)]
    for layer in to_look_at:  # grows
        if not layer.exclude and not layer.collection.hide_render:
            to_look_at.extend(layer.children)
            for obj in layer.collection.objects:
                if not obj.hide_render:
                    objects[obj] = None
                    if obj.instance_type == "COLLECTION" and obj.instance_collection is not None:
                        inside = obj.instance_collection.all_objects
                        objects |= dict.fromkeys(shown for shown in inside if not shown.hide_render)
    return list(playback.captures(objects))


def unregister() -> None:
    _restore()
