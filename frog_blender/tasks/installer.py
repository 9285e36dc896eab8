"""Installs torch, or pycolmap alone, into a folder of its own with pip, in the background, completely or not at all.

Knows nothing of Blender's windows; see ``task`` for that.
"""

from __future__ import annotations

import shutil
import tempfile
import threading
from collections.abc import Sequence
from functools import partial
from pathlib import Path

from ..engine.errors import FrogError, brief
from .package_folders import has_package, package_of, partial_prefix, switch_to
from .packages import BYTES_NEEDED, CPU, PACKAGES
from .pip_run import PipRun, pip_command


class Installation:
    """One run of pip. Begin with ``start()``; it ends by itself or by ``cancel()``.

    Attributes:
        folder: where the packages are when ``done``; before, where they would be for the first time.
        running, done: as it stands.
        error: why it ended without being done, one sentence; "" where it was cancelled.

    Args:
        arguments: further ones of pip's, such as an index.
        pip: how to start pip; None for ``pip_command()``.
        bytes_needed: disk space without which it does not start.
    """

    def __init__(
        self,
        folder: Path,
        arguments: Sequence[str] = (),
        packages: Sequence[str] = PACKAGES,
        *,
        pip: Sequence[str] | None = None,
        bytes_needed: float = BYTES_NEEDED[CPU],
    ) -> None:
        self.folder, self.error = folder, ""
        self.running = self.done = False
        self._wanted = package_of(folder)
        self._arguments, self._packages = list(arguments), list(packages)
        self._pip, self._bytes_needed = pip, bytes_needed
        self._free_before = self._fraction = 0.0
        self._run = PipRun()
        self._thread = threading.Thread(target=self._work, name="FRoG installation", daemon=True)

    def start(self) -> Installation:
        """Starts pip; FrogError without pip or with too little disk space."""
        command = pip_command() if self._pip is None else self._pip
        try:
            self.folder.parent.mkdir(parents=True, exist_ok=True)
            free = shutil.disk_usage(self.folder.parent).free
        except OSError as error:
            raise FrogError(f"{self.folder.parent}: the folder could not be created ({error.strerror}).") from error
        if free < self._bytes_needed:
            needs = f"{self._wanted} needs {self._bytes_needed / 1e9:.1f} GB"
            raise FrogError(f"{self.folder.parent}: found {free / 1e9:.1f} GB free, {needs}.")
        self._free_before = free
        # Wheels only: a source package would run its own build code.
        options = ["--disable-pip-version-check", "--no-input", "--progress-bar", "off", "--only-binary=:all:"]
        self._command = [*command, "install", *options]
        self.running = True
        self._thread.start()
        return self

    @property
    def line(self) -> str:
        """What pip said last."""
        return self._run.line

    @property
    def fraction(self) -> float:
        """About how much is done, from 0 to 1, by how much of the disk space is taken: pip of Python 3.11 tells none,
        and whoever else writes counts too.
        """
        try:
            taken = self._free_before - shutil.disk_usage(self.folder.parent).free
        except OSError:  # as it was
            return self._fraction
        self._fraction = min(max(self._fraction, taken / self._bytes_needed), 0.99)
        return self._fraction

    def cancel(self) -> None:
        self._run.cancel()

    def join(self, seconds: float | None = None) -> bool:
        """Waits; True when it has ended."""
        self._thread.join(seconds)
        return not self._thread.is_alive()

    def _work(self) -> None:
        new_folder = partial(
            tempfile.TemporaryDirectory,
            prefix=partial_prefix(self.folder),
            dir=self.folder.parent,
            ignore_cleanup_errors=True,
        )
        try:
            with new_folder() as packages, new_folder() as scratch:
                self._install(Path(packages), Path(scratch))
                if not self._run.is_cancelled and not self.error:
                    self.folder = switch_to(Path(packages), self.folder)
                    self.done = True
        except Exception as error:  # would be lost otherwise
            reason = getattr(error, "strerror", None) or brief(repr(error))
            self.error = f"{self.folder}: {self._wanted} could not be installed ({reason})."
        finally:
            self.running = False

    def _install(self, target: Path, scratch: Path) -> None:
        command = [*self._command, "--target", str(target), *self._arguments, *self._packages]
        done_well = self._run.run(command, target, scratch)
        if self._run.is_cancelled:
            return
        if not done_well:
            self.error = f"{self._wanted} could not be installed: {self._run.reason}"
        elif not has_package(target):
            self.error = f"{self._wanted} could not be installed: pip brought none ({self._run.last_words})."
