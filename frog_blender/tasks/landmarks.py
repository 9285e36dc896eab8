"""Fetches the file that finds a person's joints, with pip, in the background, whole or not at all."""

from __future__ import annotations

import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path

from ..engine.capture.calibration.landmark_file import PIP_ARGUMENTS, fetch_landmark_file
from ..engine.errors import FrogError, brief
from .pip_run import PipRun, pip_command


class LandmarkDownload:
    """One download. Begin with ``start()``; it ends by itself or by ``cancel()``.

    Attributes:
        folder: where the file is when ``done``.
        running, done: as it stands.
        error: why it ended without being done, one sentence; "" where it was cancelled.

    Args:
        pip: how to start pip; None for ``pip_command()``.
        cache: where the file is kept; None for the user's cache folder.
    """

    def __init__(self, *, pip: Sequence[str] | None = None, cache: Path | None = None) -> None:
        self.folder, self.error = Path(), ""
        self.running = self.done = False
        self._pip, self._cache = pip, cache
        self._run = PipRun()
        self._thread = threading.Thread(target=self._work, name="FRoG landmarks", daemon=True)

    @property
    def line(self) -> str:
        """What pip said last."""
        return self._run.line

    def start(self) -> LandmarkDownload:
        """Starts pip; FrogError without pip."""
        self._command = pip_command() if self._pip is None else self._pip
        self.running = True
        self._thread.start()
        return self

    def cancel(self) -> None:
        self._run.cancel()

    def join(self, seconds: float | None = None) -> bool:
        """Waits; True when it has ended."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def _work(self) -> None:
        try:
            self.folder = fetch_landmark_file(self._download, self._cache).parent
            self.done = not self._run.is_cancelled
        except Exception as error:  # would be lost otherwise
            if not self._run.is_cancelled:
                self.error = f"The landmark file could not be fetched: {brief(error)}"
        finally:
            self.running = False

    def _download(self, folder: Path) -> None:
        options = ["--disable-pip-version-check", "--no-input", "--progress-bar", "off"]
        with tempfile.TemporaryDirectory(prefix="frog-pip-", ignore_cleanup_errors=True) as scratch:
            command = [*self._command, *PIP_ARGUMENTS, *options, "--dest", str(folder)]
            done_well = self._run.run(command, folder, Path(scratch))
        if self._run.is_cancelled or not done_well:
            raise FrogError(self._run.reason)
