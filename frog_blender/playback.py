"""Timeline frame -> Gaussians: handlers that keep every imported capture showing the scene's current moment.

Nothing is accumulated from frame to frame, so scrubbing, jumping and farm rendering out of order all show the same.
A capture is an object whose ``frog.filepath`` is set; between frames only its properties are kept, never the object.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy
from bpy.app.handlers import persistent

from . import app_handlers, carrier, saved_elsewhere
from .engine.errors import FrogError
from .playing import density, playback_cache
from .playing.playback_cache import Moment
from .playing.retiming import capture_frame, is_known_late

if TYPE_CHECKING:
    from .engine.inference.bake import Bake
    from .engine.inference.scene import PlayableScene
    from .engine.rasterizer.arrays import GaussianArrays

_Stamp = tuple[int, int] | None  # modification time and size of a file; None where there is no file


class _Kept:
    """What was read from one file: read once for each version of it, while other files can be read as well."""

    def __init__(self) -> None:
        self.lock = threading.Lock()  # a render evaluates frames in its own thread
        self.version: Any = ()
        self.content: Any = None  # or the sentence that says why there is none

    def take(self, version: Any, read: Callable[[], Any]) -> Any:
        with self.lock:
            if self.version != version:
                self.content = read()
                self.version = version
                if isinstance(self.content, str):
                    print(f"FRoG: {self.content}", file=sys.stderr)  # once for each version, not once a frame
            return self.content


_scenes: dict[Path, _Kept] = {}
_bakes: dict[tuple[Path, Path], _Kept] = {}  # by bake and scene file


def file_of(obj: Any) -> Path:
    """The .frog file an object plays."""
    return Path(bpy.path.abspath(obj.frog.filepath, library=saved_elsewhere.library_of(obj)))


def bake_path(obj: Any) -> Path:
    """Where an object's baked playback is, or would be: beside its .frog file, or in the folder chosen for it."""
    file, folder, library = file_of(obj), obj.frog.bake_folder, saved_elsewhere.library_of(obj)
    return (Path(bpy.path.abspath(folder, library=library)) if folder else file.parent) / f"{file.stem}.frogbake"


def open_scene(path: Path) -> PlayableScene:
    """The scene in a file, read once for each version of the file; FrogError with one sentence if it is unusable."""
    if path not in _scenes:
        _let_go_of_unplayed()
    kept = _scenes.setdefault(path, _Kept())
    before = kept.content
    content = kept.take(_stamp(path), lambda: _read(path))
    if before is not content:
        _forget_frames(before)
    if isinstance(content, str):
        raise FrogError(content)
    return content


def open_bake(obj: Any, scene: PlayableScene) -> Bake | None:
    """What was baked of an object's file; None where nothing usable was, which ``bake_problem`` explains."""
    path, file = bake_path(obj), file_of(obj)
    stamp = _stamp(path)
    if stamp is None:
        let_go_of_bake(path)
        return None
    kept = _bakes.setdefault((path, file), _Kept())
    content = kept.take((stamp, scene.token), lambda: _read_bake(path, file, scene))
    return None if isinstance(content, str) else content


def version(path: Path) -> object:
    """Changes when the file does."""
    return _stamp(path)


def problem(path: Path) -> str:
    """Why a file could not be played when it was last needed, or an empty string."""
    content = _scenes[path].content if path in _scenes else None
    return content if isinstance(content, str) else ""


def is_missing(path: Path) -> bool:
    """True if there was no file when it was last needed."""
    return path in _scenes and _scenes[path].version is None


def baked(obj: Any) -> Bake | None:
    """The bake that was used when the object was last shown."""
    kept = _bakes.get((bake_path(obj), file_of(obj)))
    return kept.content if kept is not None and not isinstance(kept.content, str) else None


def bake_problem(obj: Any) -> str:
    """Why an object's baked playback is not used, or an empty string."""
    kept = _bakes.get((bake_path(obj), file_of(obj)))
    content = kept.content if kept is not None else None
    return content if isinstance(content, str) else getattr(content, "problem", "")


def let_go_of_bake(path: Path) -> None:
    """Closes a bake, so that it can be replaced or deleted; it is opened again when it is needed."""
    for key in [key for key in _bakes if key[0] == path]:
        content = _bakes.pop(key).content
        if content is not None and not isinstance(content, str):
            content.close()


def forget() -> None:
    """Drop every scene and bake that was read."""
    _scenes.clear()
    for path, _ in list(_bakes):
        let_go_of_bake(path)
    playback_cache.clear()


def _forget_frames(content: PlayableScene | str | None) -> None:
    """Drops the cached frames of what was kept of a file, if that was a scene."""
    if content is not None and not isinstance(content, str):
        playback_cache.frames.forget(content.token)


def _let_go_of_unplayed() -> None:
    """Drops scenes and bakes that no object plays any more, so that a day of trainings does not gather them."""
    if threading.current_thread() is not threading.main_thread():  # a render's, which must not look at bpy.data
        return
    played = {file_of(obj) for obj in captures(bpy.data.objects)}
    for path in [path for path in list(_scenes) if path not in played]:
        _forget_frames(_scenes.pop(path).content)
    for path in {path for path, file in list(_bakes) if file not in played}:
        let_go_of_bake(path)


def captures(objects: Any) -> Iterator[Any]:
    """The objects that play a .frog file, among ``objects`` (a scene's, or all of the file's)."""
    return (obj for obj in objects if obj.type in carrier.TYPES and obj.frog.filepath)


def gaussians_at(obj: Any, scene_frame: float, evaluated: Any = None) -> GaussianArrays:
    """The Gaussians an object shows at a frame of the timeline (fractions are legal), in the object's own space."""
    return moment(obj, scene_frame, evaluated).gaussians()


def moment(obj: Any, scene_frame: float, evaluated: Any = None) -> Moment:
    """What an object shows at a frame of the timeline; FrogError for an unusable file.

    Args:
        evaluated: see ``capture_frame``.
    """
    scene = open_scene(file_of(obj))
    time = scene.time_of(capture_frame(obj, scene_frame, scene.header.frame_count, evaluated))
    return Moment(scene, time, open_bake(obj, scene))


def displayed(obj: Any, scene_frame: float, evaluated: Any = None) -> Moment:
    """What an object's points show of ``moment``: see density. FrogError for an unusable file."""
    whole = moment(obj, scene_frame, evaluated)
    fewer = density.thinned(obj, whole.scene)
    return whole if fewer is None else Moment(fewer[0], whole.time, whole.bake, fewer[1])


def shown_frame(obj: Any, scene_frame: float, evaluated: Any = None) -> float:
    """Which of its capture's frames an object shows at a frame of the timeline; FrogError for an unusable file."""
    return capture_frame(obj, scene_frame, open_scene(file_of(obj)).header.frame_count, evaluated)


def show(obj: Any, scene_frame: float, evaluated: Any = None) -> None:
    """Put the Gaussians of a frame of the timeline into an object; a file that cannot be read leaves it as it is.

    Geometry that is linked from another .blend cannot be written: such captures are drawn by the FROG engine alone.
    """
    if obj.data.library is not None or obj.data.override_library is not None:
        return
    try:
        shown = displayed(obj, scene_frame, evaluated)
    except FrogError:
        return  # said once by open_scene, shown by the panel
    carrier.show(obj, shown.scene, shown.time, shown.part)


def refresh(scene: Any) -> None:
    """Make every capture of a scene show its current frame."""
    for obj in captures(scene.objects):
        show(obj, scene.frame_current_final)


def _stamp(path: Path) -> _Stamp:
    try:
        status = path.stat()
    except OSError:
        return None
    return status.st_mtime_ns, status.st_size


def _read(path: Path) -> PlayableScene | str:
    try:
        from .engine.inference.scene import PlayableScene

        return PlayableScene.load(path)
    except FrogError as error:
        return str(error)
    except Exception as error:
        # Whatever is wrong with one file, the timeline must go on; the cause is told once.
        return f"{path}: this scene cannot be played ({type(error).__name__}: {error})."


def _read_bake(path: Path, file: Path, scene: PlayableScene) -> Bake | str:
    from .engine.inference.bake import Bake

    try:
        return Bake(path, file, scene)
    except FrogError as error:
        return str(error)


@persistent
def _on_frame(scene: Any, *_: Any) -> None:
    for obj in captures(scene.objects):
        if not is_known_late(obj):
            show(obj, scene.frame_current_final)


@persistent
def _on_frame_evaluated(scene: Any, depsgraph: Any) -> None:
    if depsgraph.mode == "RENDER" and scene.render.engine == "FROG":
        return  # it draws no points, and writing them makes Blender evaluate again, without the NLA
    for obj in captures(scene.objects):
        if is_known_late(obj):
            show(obj, scene.frame_current_final, obj.evaluated_get(depsgraph))


@persistent
def _on_load(*_: Any) -> None:
    forget()
    _refresh_all()


@persistent
def _refresh_all(*_: Any) -> None:
    for scene in bpy.data.scenes:
        refresh(scene)


@persistent
def _on_update(_scene: Any, depsgraph: Any) -> None:
    """Whoever changed the geometry outside of a frame's change, all of it is written again with the next frame."""
    for update in depsgraph.updates:
        if update.is_updated_geometry and isinstance(update.id, carrier.DATA_TYPES):
            carrier.distrust(update.id.original)


@persistent
def _on_save_pre(*_: Any) -> None:
    """Gaussians are in the .frog file; a .blend that repeats them grows by 60 bytes a Gaussian for nothing."""
    for obj in captures(bpy.data.objects):
        if obj.library is not None or getattr(obj.data, "is_editmode", False):
            continue  # Blender refuses to change what is being edited
        if _stamp(file_of(obj)) is not None and not problem(file_of(obj)):
            carrier.clear(obj)


def _handlers() -> app_handlers.Handlers:
    on = bpy.app.handlers
    return [
        (on.frame_change_pre, _on_frame),
        (on.frame_change_post, _on_frame_evaluated),
        (on.depsgraph_update_post, _on_update),
        (on.load_post, _on_load),
        (on.blend_import_post, saved_elsewhere.on_import_post),
        (on.blend_import_post, _refresh_all),
        (on.undo_post, _refresh_all),
        (on.redo_post, _refresh_all),
        (on.save_pre, _on_save_pre),
        (on.save_pre, saved_elsewhere.on_save_pre),  # after it, which looks for the files
        (on.save_post, saved_elsewhere.on_save_post),
        (on.save_post, _refresh_all),
        (on.save_post_fail, saved_elsewhere.on_save_post),
        (on.save_post_fail, _refresh_all),
    ]


def register() -> None:
    app_handlers.add(_handlers())


def unregister() -> None:
    app_handlers.remove(_handlers())
    forget()
