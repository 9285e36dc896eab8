"""Installs torch, or pycolmap alone, into a folder of its own with pip, in the background, completely or not at all.

Knows nothing of Blender's windows; see ``task`` for that.
"""

from __future__ import annotations

import glob
import importlib.util
import os
import platform
import shutil
import site
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Sequence
from functools import partial
from importlib.machinery import ModuleSpec
from pathlib import Path

from ..engine.errors import FrogError, brief
from .folders import has_package, package_of, partial_prefix, switch_to


def has_pycolmap_wheel(system: str = sys.platform, machine: str = platform.machine()) -> bool:
    """Whether PyPI has pycolmap for this kind of computer, of names as Python gives them."""
    return (system, machine.lower()) in (("linux", "x86_64"), ("win32", "amd64"), ("darwin", "arm64"))


PYCOLMAP = "4.2.1"
"""Version of pycolmap that calibration was tested with; its interface changes from one to the next."""
_READING = ("opencv-contrib-python-headless", "imageio-ffmpeg")
_CALIBRATION = (f"pycolmap=={PYCOLMAP}",) if has_pycolmap_wheel() else ()
PACKAGES = ("torch", *_READING, *_CALIBRATION)
"""Packages that training, reading captures and calibrating need and Blender's Python lacks."""
CALIBRATION_PACKAGES = (*_CALIBRATION, *_READING)
"""Packages for whoever has torch, or only wants to calibrate."""
SIZES = "about 0.4 GB for the CPU only (1.2 GB on disk), about 3 GB with CUDA (7 GB on disk)"
CALIBRATION_SIZES = "about 0.1 GB (0.4 GB on disk)"
BYTES_NEEDED = 1.7e9  # while the smaller of the two is unpacked
CALIBRATION_BYTES_NEEDED = 0.6e9
_LINES_KEPT = 30


def pip_command(find_spec: Callable[[str], ModuleSpec | None] = importlib.util.find_spec) -> list[str]:
    """The command that runs pip with this Python: the installed one, or the wheel bundled with Python.

    Isolated (``-I``), so that nothing in the current folder or in PYTHONPATH runs in its place; and only for as long as
    this process keeps the other end of its input (``pip_process``).

    Args:
        find_spec: where this Python would import a module from.

    Raises:
        FrogError: where there is neither.
    """
    start = [sys.executable, "-I", str(Path(__file__).with_name("pip_process.py"))]
    installed_pip = find_spec("pip")
    origin = Path(installed_pip.origin or ".") if installed_pip is not None else None
    if origin is not None and any(origin.is_relative_to(folder) for folder in site.getsitepackages()):
        return [*start, ""]
    bundled = find_spec("ensurepip")
    folders = bundled.submodule_search_locations if bundled else None
    wheels = sorted(glob.glob(f"{(folders or ['.'])[0]}/_bundled/pip-*.whl"))
    if not wheels:
        raise FrogError(
            f"{sys.executable}: found no pip, expected Python's own. Install torch elsewhere and choose its folder "
            "in the preferences."
        )
    return [*start, wheels[-1]]


class Installation:
    """One run of pip. Begin with ``start()``; it ends by itself or by ``cancel()``.

    Attributes:
        folder: where the packages are when ``done``; before, where they would be for the first time.
        line: what pip said last.
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
        bytes_needed: float = BYTES_NEEDED,
    ) -> None:
        self.folder, self.line, self.error = folder, "Starting", ""
        self.running = self.done = False
        self._wanted = package_of(folder)
        self._arguments, self._packages = list(arguments), list(packages)
        self._pip, self._bytes_needed = pip, bytes_needed
        self._cancelled = threading.Event()
        self._process: subprocess.Popen[str] | None = None
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
        # Wheels only: a source package would run its own build code.
        options = ["--disable-pip-version-check", "--no-input", "--progress-bar", "off", "--only-binary=:all:"]
        self._command = [*command, "install", *options]
        self.running = True
        self._thread.start()
        return self

    def cancel(self) -> None:
        self._cancelled.set()
        if self._process is not None:
            self._process.terminate()

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
                self._run(Path(packages), Path(scratch))
                if not self._cancelled.is_set() and not self.error:
                    self.folder = switch_to(Path(packages), self.folder)
                    self.done = True
        except Exception as error:  # would be lost otherwise
            reason = getattr(error, "strerror", None) or brief(repr(error))
            self.error = f"{self.folder}: {self._wanted} could not be installed ({reason})."
        finally:
            self.running = False

    def _run(self, target: Path, scratch: Path) -> None:
        command = [*self._command, "--target", str(target), *self._arguments, *self._packages]
        said: list[str] = []
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,  # closed when this process ends, which ends pip
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            cwd=target,  # of ours alone
            # Where pip unpacks downloads. It may be killed before cleaning up, and free space was checked on this disk.
            env=os.environ | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(scratch)),
        )
        if self._cancelled.is_set():  # cancelled between the check and the start
            self._process.terminate()
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.strip():
                self.line = line.strip()
                said = [*said[-_LINES_KEPT:], self.line]
        if self._process.wait() and not self._cancelled.is_set():
            errors = [line.removeprefix("ERROR: ") for line in said if line.startswith("ERROR")]
            self.error = f"{self._wanted} could not be installed: {(errors or said or ['pip said nothing'])[-1]}"
        elif not has_package(target) and not self._cancelled.is_set():
            self.error = (
                f"{self._wanted} could not be installed: pip brought none ({(said or ['it said nothing'])[-1]})."
            )
