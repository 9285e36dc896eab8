"""Installs torch, or pycolmap alone, into a folder of its own with pip, completely or not at all."""

import shutil
import tempfile
import threading
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Self

import bpy

from .. import redrawing
from ..engine.errors import FrogError, in_words
from ..engine.io.pip import pip_command, run_pip
from . import package_folders
from .background_task import BackgroundTask
from .packages import BYTES_NEEDED, CALIBRATION_PACKAGES, CPU, NO_TORCH, PACKAGES


class Installation(BackgroundTask):
    """An installation of packages by pip; its result is a folder, and its stage what pip said last.

    Args:
        folder: where the packages are to be; an earlier installation there keeps it.
        build: of torch, which tells how much disk space there has to be; NO_TORCH for what calibration needs alone.
        arguments: further ones of pip's, such as an index.
        on_finished: is given the folder where they are.
    """

    what = "installation"
    busy = "An installation is already running."
    quit_seconds = 10.0

    def __init__(
        self,
        folder: Path,
        build: str = CPU,
        arguments: Sequence[str] = (),
        on_finished: Callable[[Path], None] | None = None,
    ) -> None:
        super().__init__()
        self.folder, self.on_finished = folder, on_finished
        self._package, self._bytes_needed = package_folders.package_of(folder), BYTES_NEEDED[build]
        self._arguments = [*arguments, *(CALIBRATION_PACKAGES if build == NO_TORCH else PACKAGES)]

    def start(self) -> Self:
        """Starts the worker; FrogError without pip or with too little disk space."""
        parent = self.folder.parent
        with in_words(f"{parent}: the folder could not be created"):
            parent.mkdir(parents=True, exist_ok=True)
            free = shutil.disk_usage(parent).free
        if free < self._bytes_needed:
            needs = f"{self._package} needs {self._bytes_needed / 1e9:.1f} GB"
            raise FrogError(f"{parent}: found {free / 1e9:.1f} GB free, {needs}.")
        self._pip = pip_command()
        return super().start()

    def redraw(self) -> None:
        redrawing.viewports()
        redrawing.preferences()

    def work(self) -> Path:
        folder, prefix = self.folder, package_folders.partial_prefix(self.folder)
        new_folder = partial(tempfile.TemporaryDirectory, None, prefix, folder.parent, ignore_cleanup_errors=True)
        failed = in_words(f"{folder}: {self._package} could not be installed", kinds=(OSError, ValueError))
        with failed, new_folder() as packages, new_folder() as scratch:
            self._install(Path(packages), Path(scratch))
            return package_folders.switch_to(Path(packages), folder)

    def _install(self, target: Path, scratch: Path) -> None:
        arguments, stopped = ["install", "--target", str(target), *self._arguments], self.stopped.is_set
        try:
            said = run_pip(arguments, target, stopped, scratch=scratch, say=self.tell, pip=self._pip)
        except FrogError as error:
            raise FrogError(f"{self._package} could not be installed: {error}") from error
        if not package_folders.has_package(target):
            raise FrogError(f"{self._package} could not be installed: pip brought none ({said}).")


def folder(name: str = package_folders.TORCH) -> Path:
    """Where this add-on's torch lies: with the user's extensions, so that it outlives upgrades of the add-on."""
    return Path(bpy.utils.user_resource("DATAFILES", path="frog_blender")) / name


def register() -> None:
    for packages in (folder(), folder(package_folders.CALIBRATION)):
        if package_folders.remains(packages):  # removing gigabytes takes a while
            threading.Thread(
                target=package_folders.clear_remains, args=(packages,), name="FRoG tidying", daemon=True
            ).start()
