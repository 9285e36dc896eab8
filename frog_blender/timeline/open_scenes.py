"""Open .frog files, read once for each version of a file.

Nothing of Blender's is looked at here, so any thread may ask.
"""

import sys
import threading
from collections.abc import Callable, Container
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from .. import addon_state
from ..engine.errors import FrogError, brief
from ..engine.playback.player import ScenePlayer
from . import playback_cache
from .edited_scenes import EditedScenes

_Stamp = tuple[int, int] | None  # modification time and size of a file; None where there is no file


class _File:
    """The content of one file, read once for each version of it. Other files can be read at the same time."""

    def __init__(self) -> None:
        self.lock = threading.Lock()  # a render evaluates frames in its own thread
        self.version: Any = ()
        self.content: Any = None
        self.problem = ""  # why there is no content

    def take(self, version: Any, read: Callable[[], Any], problem: str) -> Any:
        """The content of a version, None if it is unusable.

        Args:
            problem: a phrase for an error that nobody foresaw.
        """
        with self.lock:
            if self.version != version:
                self.content, self.problem = None, ""
                try:
                    self.content = read()
                except FrogError as error:
                    self.problem = str(error)
                except Exception as error:  # one unusable file must not stop the timeline
                    self.problem = f"{problem} ({type(error).__name__}: {brief(error)})."
                self.version = version
                if self.problem:
                    print(f"FRoG: {self.problem}", file=sys.stderr)  # once for each version, not once a frame
            return self.content


@dataclass
class OpenScenes:
    """The files that were read.

    Attributes:
        scenes: by path.
        lock: of the dictionary.
        load_scene: reads a scene file; FrogError if it is unusable.
    """

    load_scene: Callable[[Path], ScenePlayer] = ScenePlayer.load
    scenes: dict[Path, _File] = field(default_factory=dict)
    lock: threading.Lock = field(default_factory=threading.Lock)


def paths() -> set[Path]:
    """Paths of the open scene files, readable or not."""
    return set(addon_state.get(OpenScenes).scenes)


def scene(path: Path) -> ScenePlayer:
    """The scene in a file; FrogError with one sentence if it is unusable."""
    files = addon_state.get(OpenScenes)
    with files.lock:
        kept = files.scenes.setdefault(path, _File())
    before = kept.content
    content = kept.take(version(path), lambda: files.load_scene(path), f"{path}: this scene cannot be played")
    if before is not content:
        _forget_frames(before)
    if content is None:
        raise FrogError(kept.problem)
    return content


def version(path: Path) -> _Stamp:
    """Modification time and size of a file; None if there is no file."""
    try:
        status = path.stat()
    except (OSError, ValueError):  # ValueError: for a path with a null character
        return None
    return status.st_mtime_ns, status.st_size


def problem(path: Path) -> str:
    """Why a file could not be played when it was last read, or an empty string."""
    return addon_state.get(OpenScenes).scenes.get(path, _File()).problem


def is_outdated(path: Path) -> bool:
    """True if the file has changed since it was last read, or was never read."""
    return addon_state.get(OpenScenes).scenes.get(path, _File()).version != version(path)


def is_missing(path: Path) -> bool:
    """True if there was no file when it was last read."""
    return addon_state.get(OpenScenes).scenes.get(path, _File()).version is None


def forget() -> None:
    """Drop every scene that was read."""
    forget_all_but(())
    playback_cache.clear()


def forget_all_but(kept: Container[Path]) -> None:
    """Drops scenes of other files, so that they do not accumulate."""
    files = addon_state.get(OpenScenes)
    with files.lock:
        dropped = [files.scenes.pop(path) for path in [path for path in files.scenes if path not in kept]]
    for closed in dropped:
        _forget_frames(closed.content)


def _forget_frames(content: ScenePlayer | None) -> None:
    """Drops the cached frames of a file's scene, and what was edited of it."""
    if content is not None:
        playback_cache.frames().forget(content.token)
        addon_state.get(EditedScenes).forget(content)
