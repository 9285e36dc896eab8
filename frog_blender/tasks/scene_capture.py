"""Rendering a scene's capture in a Blender beside this one, watched by a worker thread."""

from __future__ import annotations

import atexit
import json
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import bpy

from .. import addon_state
from ..engine.errors import FrogError, brief, how_it_ended
from ..scene_capture import capture_folder
from ..scene_capture.request import RenderRequest, command
from .background_task import BackgroundTask, TaskHolder, end_ticking
from .scene_capture_state import SceneCaptureState

OnFinished = Callable[[Path], None]
"""Is called on the main thread with the capture's folder. May raise FrogError."""
_LOOKS = 0.1  # seconds between questions whether to stop
_LAST_LINES = 3


@dataclass(frozen=True)
class _Told:
    """How many images the child has rendered."""

    done: int


@dataclass(frozen=True)
class _Ended:
    """The worker's last message."""

    error: str = ""


class SceneCaptureTask(BackgroundTask):
    """One capture: ``start()`` it, ``pump()`` it until ``state.running`` is false. Images that exist are kept.

    Args:
        request: what to render; the open file is copied now.
        on_finished: is called when all images are there.

    Raises:
        FrogError: if the folder holds something else, or nothing can be written.
    """

    what = "scene's rendering"
    quit_seconds = 5.0

    def __init__(self, request: RenderRequest, on_finished: OnFinished | None = None) -> None:
        super().__init__()
        plan = request.plan
        capture_folder.prepare(plan)
        kept = len(plan.images) - len(plan.missing)
        self.state = SceneCaptureState(plan.folder, len(plan.images), kept, kept)
        self.on_finished = on_finished
        self._plan, self._stop = plan, threading.Event()
        scripts = not bpy.app.autoexec_fail
        self._temporary = tempfile.TemporaryDirectory(prefix="frog-scene-", ignore_cleanup_errors=True)
        try:
            written = request.write(Path(self._temporary.name), scripts=scripts)
        except (FrogError, OSError) as error:
            self._temporary.cleanup()
            raise FrogError(error) from error
        self._command = command(written, scripts=scripts)

    @property
    def is_running(self) -> bool:
        return self.state.running

    @property
    def is_stopping(self) -> bool:
        """True from ``cancel()`` to the end."""
        return self.state.running and self._stop.is_set()

    def cancel(self) -> None:
        """Asks the worker to end the rendering. Images that are done are kept for the next time."""
        self._stop.set()

    def work(self) -> None:
        try:
            self.put(_Ended(self._render() if self._plan.missing else ""))
        except OSError as error:
            self.put(_Ended(f"{self._command[0]}: could not be started ({error.strerror or error})."))
        except BaseException as error:
            traceback.print_exc(file=sys.stderr)
            self.put(_Ended(f"The rendering stopped on an unexpected {type(error).__name__}: {brief(error)}."))
        finally:
            self._temporary.cleanup()

    def _render(self) -> str:
        """Runs the child; a sentence if it failed."""
        process = subprocess.Popen(
            self._command,
            stdin=subprocess.PIPE,  # closed when this process ends, which ends the child
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            encoding="utf-8",
            errors="replace",
        )
        said: list[str] = []
        failures: list[str] = []
        reader = threading.Thread(target=self._follow, args=(process.stdout, said, failures), daemon=True)
        reader.start()
        try:
            while process.poll() is None and not self._stop.wait(_LOOKS):
                pass
        finally:
            if process.poll() is None:
                process.kill()
            code = process.wait()
            reader.join()
            for stream in (process.stdin, process.stdout):
                if stream is not None:
                    stream.close()
            self._tidy()
        if self._stop.is_set() or (code == 0 and not failures):
            return ""
        reason = failures[-1] if failures else " ".join(line.strip() for line in said[-_LAST_LINES:])
        why = brief(reason) or "it said nothing"
        return f"The Blender that rendered {how_it_ended(code)} ({why}). Images that are done are kept."

    def _follow(self, stream: object, said: list[str], failures: list[str]) -> None:
        """Reads the child's lines; those of Blender and its engines are kept for a sentence."""
        kept = self.state.kept
        for line in stream or ():  # type: ignore[attr-defined]
            try:
                told = json.loads(line)["frog"]
            except (ValueError, KeyError, TypeError):
                said.append(line)
                del said[:-_LAST_LINES]
                continue
            if "error" in told:
                failures.append(str(told["error"]))
            else:
                self.put(_Told(kept + int(told["done"])))

    def _tidy(self) -> None:
        """Removes what a stopped child left unfinished."""
        for camera in self._plan.cameras:
            for partial in (self._plan.folder / camera.name).glob("*.partial.png"):
                partial.unlink(missing_ok=True)

    def death(self) -> _Ended:
        return _Ended("The rendering stopped without an error message.")

    def apply(self, message: _Told | _Ended) -> None:
        state = self.state
        if isinstance(message, _Told):
            state.done = message.done
            return
        state.running, state.error = False, message.error
        missing = len(self._plan.missing)
        state.done = state.total - missing
        state.cancelled = self._stop.is_set() and missing > 0
        if missing == 0 and not state.error and self.on_finished is not None:
            try:
                self.on_finished(state.folder)
            except FrogError as error:
                state.error = str(error)

    def seconds_left(self) -> float | None:
        """See ``SceneCaptureState``."""
        return self.state.seconds_left(time.monotonic())


class CurrentSceneCapture(TaskHolder):
    """The capture that the panel shows: running, or the last one that ran."""

    busy = "A scene is being rendered already. Wait for it or cancel it first."
    task: SceneCaptureTask | None = None


def current() -> SceneCaptureTask | None:
    """The capture that the panel shows: running, or the last one that ran."""
    return addon_state.get(CurrentSceneCapture).task


def is_running() -> bool:
    """Whether a scene is being rendered."""
    return addon_state.get(CurrentSceneCapture).is_running


def begin(request: RenderRequest, on_finished: OnFinished | None = None) -> SceneCaptureTask:
    """Starts a capture as the current one, pumped by a timer; FrogError as of the task, or if one is running."""
    holder = addon_state.get(CurrentSceneCapture)
    holder.begin(lambda: SceneCaptureTask(request, on_finished), tick)
    assert holder.task is not None
    return holder.task


def tick() -> float | None:
    """What Blender's timer calls: pumps the current capture. Returns the seconds until the next call, or None."""
    return addon_state.get(CurrentSceneCapture).tick()


def stop() -> None:
    """Cancels the current capture and waits for its process to end."""
    addon_state.get(CurrentSceneCapture).stop()


def register() -> None:
    atexit.register(stop)


def unregister() -> None:
    stop()
    addon_state.get(CurrentSceneCapture).task = None
    atexit.unregister(stop)
    end_ticking(tick)
