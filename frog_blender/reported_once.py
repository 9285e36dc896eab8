"""What the console is told once, though it is met at every frame."""

from __future__ import annotations

import sys
import threading
import traceback

from . import addon_state

_MOST = 1000  # messages kept; one that has a number of its own at each frame must not fill the memory


class ReportedMessages:
    """What was said since the file was opened."""

    def __init__(self) -> None:
        self.keys: set[str] = set()
        self.lock = threading.Lock()  # a render reports from its own thread


def message(text: str) -> None:
    """Prints a sentence unless it was printed since the file was opened."""
    if _is_new(text):
        print(f"FRoG: {text}", file=sys.stderr)


def unexpected(where: str, error: Exception) -> None:
    """Prints the traceback of an error that is being handled, once for each place and type."""
    if _is_new(f"{where}: {type(error).__name__}"):
        print(f"FRoG: {where}: unexpected {type(error).__name__}. It is reported once.", file=sys.stderr)
        traceback.print_exception(error, file=sys.stderr)


def forget() -> None:
    """Everything may be said again, as for another file."""
    reported = addon_state.get(ReportedMessages)
    with reported.lock:
        reported.keys.clear()


def _is_new(key: str) -> bool:
    reported = addon_state.get(ReportedMessages)
    with reported.lock:
        if key in reported.keys or len(reported.keys) >= _MOST:
            return False
        reported.keys.add(key)
        return True
