"""Rendering a scene's capture in a Blender beside this one, watched by a worker thread."""

import json
import tempfile
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Self

import bpy

from ..engine.errors import FrogError, brief
from ..engine.io.child_process import ChildProcess
from ..engine.whole_progress import Standing
from ..scene_capture.request import RenderRequest, command
from .background_task import BackgroundTask, Ended, Progress


class SceneCaptureTask(BackgroundTask):
    """One capture; its result is its folder. Images that exist are kept; its progress counts them.

    Args:
        request: what to render.
        on_finished: is given the folder when all images are there.

    Attributes:
        kept: how many images were there before.
    """

    what = "scene's rendering"
    busy = "A scene is being rendered already. Wait for it or cancel it first."

    def __init__(self, request: RenderRequest, on_finished: Callable[[Path], None] | None = None) -> None:
        super().__init__()
        self.request, self.on_finished = request, on_finished
        self.kept = 0
        self._started = time.monotonic()

    def start(self) -> Self:
        """Copies the open file and starts the worker; FrogError if the folder holds something else, or nothing can be
        written.
        """
        request, scripts = self.request, not bpy.app.autoexec_fail
        request.prepare()
        self.kept = len(request.images) - len(request.missing)
        self.progress = Progress("Rendering", self.kept, len(request.images))
        self._temporary = tempfile.TemporaryDirectory(prefix="frog-scene-", ignore_cleanup_errors=True)
        try:
            written = self.request.write(Path(self._temporary.name), scripts=scripts)
        except (FrogError, OSError) as error:
            self._temporary.cleanup()
            raise FrogError(error) from error
        self._command = command(written, scripts=scripts)
        return super().start()

    def work(self) -> Path | None:
        try:
            if self.request.missing:
                self._render()
        finally:
            self._temporary.cleanup()
        return None if self.request.missing else self.request.folder

    def _render(self) -> None:
        """Runs the child; FrogError if it failed."""
        failures: list[str] = []
        try:
            with ChildProcess(self._command) as process:
                for line in process.lines(self.stopped.is_set):
                    with suppress(ValueError, KeyError, TypeError):  # Blender and its engines write there as well
                        said = json.loads(line)["frog"]
                        if "error" in said:
                            failures.append(str(said["error"]))
                        else:
                            self._tell_images(self.kept + int(said["done"]))
                end = f"failed ({brief(failures[-1])})" if failures else process.end
        finally:
            for camera in self.request.cameras:  # what a stopped child left unfinished
                for partial in (self.request.folder / camera.name).glob("*.partial.png"):
                    partial.unlink(missing_ok=True)
        if failures or process.code or self.request.missing:
            raise FrogError(f"The Blender that rendered {end}. Images that are done are kept.")

    def conclude(self, ended: Ended) -> None:
        super().conclude(ended)
        total = len(self.request.images)
        self.progress = Progress("Rendering", total - len(self.request.missing), total)

    @property
    def kept_at_quit(self) -> str:
        return "Images that are done are kept: Render Capture continues there."

    def _tell_images(self, done: int) -> None:
        """Queues how many there are; the time that is left is an estimate from those since the start."""
        total, rendered = len(self.request.images), max(done - self.kept, 1)
        left = (time.monotonic() - self._started) / rendered * (total - done)
        standing = Standing(f"{done:,} of {total:,} images", done / max(total, 1), left)
        self.put(Progress("Rendering", done, total, standing))
