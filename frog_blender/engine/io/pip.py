"""pip in a process of its own: isolated, followed, and gone when this process is."""

import glob
import importlib.util
import site
import sys
from collections import deque
from collections.abc import Callable, Sequence
from pathlib import Path

from ..errors import FrogError
from .child_process import ChildProcess

_LINES_KEPT = 30
# Wheels only: a source package would run its own build code.
_OPTIONS = ("--disable-pip-version-check", "--no-input", "--progress-bar", "off", "--only-binary=:all:")


def pip_command() -> list[str]:
    """The command that runs pip with this Python: the installed one, or the wheel bundled with Python.

    Isolated (``-I``), so that nothing in the current folder or in PYTHONPATH runs in its place; and only for as long as
    this process keeps the other end of its input (``pip_process``).

    Raises:
        FrogError: where there is neither.
    """
    start = [sys.executable, "-I", str(Path(__file__).with_name("pip_process.py"))]
    installed_pip = importlib.util.find_spec("pip")
    origin = Path(installed_pip.origin or ".") if installed_pip is not None else None
    if origin is not None and any(origin.is_relative_to(folder) for folder in site.getsitepackages()):
        return [*start, ""]
    bundled = importlib.util.find_spec("ensurepip")
    folders = bundled.submodule_search_locations if bundled else None
    wheels = sorted(glob.glob(f"{(folders or ['.'])[0]}/_bundled/pip-*.whl"))
    if not wheels:
        raise FrogError(
            f"{sys.executable}: found no pip, expected Python's own. Install torch elsewhere and choose its folder "
            "in the preferences."
        )
    return [*start, wheels[-1]]


def run_pip(
    arguments: Sequence[str],
    folder: Path,
    stopped: Callable[[], bool] = lambda: False,
    *,
    scratch: Path | None = None,
    say: Callable[[str], None] = lambda line: None,
    pip: Sequence[str] | None = None,
) -> str:
    """Runs pip and returns the last line of its output.

    Args:
        arguments: ``install`` or ``download``, and further ones; no source package is ever built.
        folder: the current one, of ours alone.
        stopped: is asked ten times a second.
        scratch: where pip unpacks downloads, which it may leave there; ``folder`` unless given.
        say: is told each line.
        pip: how to start pip; None for ``pip_command()``.

    Raises:
        FrogError: of its last error, or else its last line, where it failed.
        Stopped: if ``stopped`` said so.
    """
    command = [*(pip_command() if pip is None else pip), arguments[0], *_OPTIONS, *arguments[1:]]
    environment = dict.fromkeys(("TMPDIR", "TEMP", "TMP"), str(scratch or folder))
    said: deque[str] = deque(["pip said nothing"], maxlen=_LINES_KEPT)
    with ChildProcess(command, environment=environment, folder=folder, merged=True) as process:
        for line in process.lines(stopped):
            if text := line.decode("utf-8", "replace").strip():
                said.append(text)
                say(text)
        if process.code:
            errors = [text.removeprefix("ERROR: ") for text in said if text.startswith("ERROR")]
            raise FrogError((errors or said)[-1])
    return said[-1]
