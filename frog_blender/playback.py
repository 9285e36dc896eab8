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

from . import carrier
from .engine.errors import FrogError
from .retiming import capture_frame

if TYPE_CHECKING:
    from .engine.inference.scene import PlayableScene
    from .engine.rasterizer.arrays import GaussianArrays

_Stamp = tuple[int, int] | None  # modification time and size of a file; None where there is no file
_lock = threading.Lock()  # a render evaluates frames in its own thread
_scenes: dict[Path, tuple[_Stamp, Any]] = {}  # what was read: a PlayableScene, or the sentence that says why not


def file_of(obj: Any) -> Path:
    """The .frog file an object plays."""
    return Path(bpy.path.abspath(obj.frog.filepath, library=obj.library))


def open_scene(path: Path) -> PlayableScene:
    """The scene in a file, read once for each version of the file; FrogError with one sentence if it is unusable."""
    with _lock:
        stamp = _stamp(path)
        known = _scenes.get(path)
        if known is None or known[0] != stamp:
            known = (stamp, _read(path))
            _scenes[path] = known
            if isinstance(known[1], str):
                print(f"FRoG: {known[1]}", file=sys.stderr)  # once for each version of the file, not once a frame
    if isinstance(known[1], str):
        raise FrogError(known[1])
    return known[1]


def version(path: Path) -> object:
    """Changes when the file does."""
    return _stamp(path)


def problem(path: Path) -> str:
    """Why a file could not be played when it was last needed, or an empty string."""
    content = _scenes.get(path, (None, None))[1]
    return content if isinstance(content, str) else ""


def forget() -> None:
    """Drop every scene that was read."""
    with _lock:
        _scenes.clear()


def captures(objects: Any) -> Iterator[Any]:
    """The objects that play a .frog file, among ``objects`` (a scene's, or all of the file's)."""
    return (obj for obj in objects if obj.type == "MESH" and obj.frog.filepath)


def gaussians_at(obj: Any, scene_frame: float) -> GaussianArrays:
    """The Gaussians an object shows at a frame of the timeline (fractions are legal), in the object's own space."""
    return open_scene(file_of(obj)).at_frame(shown_frame(obj, scene_frame))


def shown_frame(obj: Any, scene_frame: float) -> float:
    """Which of its capture's frames an object shows at a frame of the timeline; FrogError for an unusable file."""
    return capture_frame(obj, scene_frame, open_scene(file_of(obj)).header.frame_count)


def show(obj: Any, scene_frame: float) -> None:
    """Put the Gaussians of a frame of the timeline into an object; a file that cannot be read leaves it as it is.

    Geometry that is linked from another .blend cannot be written: such captures are drawn by the FROG engine alone.
    """
    if obj.data.library is not None or obj.data.override_library is not None:
        return
    try:
        gaussians = gaussians_at(obj, scene_frame)
    except FrogError:
        return  # said once by open_scene, shown by the panel
    carrier.write(obj, gaussians)


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


@persistent
def _on_frame(scene: Any, *_: Any) -> None:
    refresh(scene)


@persistent
def _on_load(*_: Any) -> None:
    forget()
    _refresh_all()


@persistent
def _refresh_all(*_: Any) -> None:
    for scene in bpy.data.scenes:
        refresh(scene)


@persistent
def _on_save_pre(*_: Any) -> None:
    """Gaussians are in the .frog file; a .blend that repeats them grows by 60 bytes a Gaussian for nothing."""
    for obj in captures(bpy.data.objects):
        if obj.library is None and _stamp(file_of(obj)) is not None and not problem(file_of(obj)):
            carrier.clear(obj)


def _handlers() -> list[tuple[list[Any], Callable[..., None]]]:
    on = bpy.app.handlers
    return [
        (on.frame_change_pre, _on_frame),
        (on.load_post, _on_load),
        (on.undo_post, _refresh_all),
        (on.redo_post, _refresh_all),
        (on.save_pre, _on_save_pre),
        (on.save_post, _refresh_all),
        (on.save_post_fail, _refresh_all),
    ]


def register() -> None:
    for handlers, function in _handlers():
        if function not in handlers:
            handlers.append(function)


def unregister() -> None:
    for handlers, function in _handlers():
        if function in handlers:
            handlers.remove(function)
    forget()
