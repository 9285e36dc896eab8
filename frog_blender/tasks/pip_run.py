"""One run of pip in a process of its own, whose output can be followed and which can be ended."""

from __future__ import annotations

import glob
import importlib.util
import os
import site
import subprocess
import sys
import threading
from collections.abc import Callable, Sequence
from importlib.machinery import ModuleSpec
from pathlib import Path

from ..engine.errors import FrogError

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


class PipRun:
    """Runs pip once. ``cancel()`` may be called from another thread, before or while it runs.

    Attributes:
        line: what pip said last.
    """

    def __init__(self) -> None:
        self.line = "Starting"
        self._said: list[str] = []
        self._cancelled = threading.Event()
        self._process: subprocess.Popen[str] | None = None

    @property
    def is_cancelled(self) -> bool:
        return self._cancelled.is_set()

    def cancel(self) -> None:
        self._cancelled.set()
        if self._process is not None:
            self._process.terminate()

    def run(self, command: Sequence[str], folder: Path, scratch: Path) -> bool:
        """Waits for the command to end; true if it did well.

        Args:
            folder: the current one, of ours alone.
            scratch: where pip unpacks downloads. It may be killed before cleaning up.
        """
        self._process = subprocess.Popen(
            command,
            stdin=subprocess.PIPE,  # closed when this process ends, which ends pip
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            errors="replace",
            cwd=folder,
            env=os.environ | dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(scratch)),
        )
        if self._cancelled.is_set():  # cancelled between the check and the start
            self._process.terminate()
        assert self._process.stdout is not None
        for line in self._process.stdout:
            if line.strip():
                self.line = line.strip()
                self._said = [*self._said[-_LINES_KEPT:], self.line]
        return self._process.wait() == 0

    @property
    def last_words(self) -> str:
        """The last line of its output."""
        return (self._said or ["it said nothing"])[-1]

    @property
    def reason(self) -> str:
        """Why it failed: its last error, or else its last line."""
        errors = [line.removeprefix("ERROR: ") for line in self._said if line.startswith("ERROR")]
        return (errors or self._said or ["pip said nothing"])[-1]
