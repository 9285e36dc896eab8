"""What the console is told once, though it is met at every frame."""

from __future__ import annotations

import sys
import threading
import traceback

_MOST = 1000  # kept; a message that has a number of its own at each frame must not fill the memory
_said: set[str] = set()
_lock = threading.Lock()  # a render meets things in its own thread


def once(sentence: str) -> None:
    """Prints a sentence unless it was printed since the file was opened."""
    if _is_new(sentence):
        print(f"FRoG: {sentence}", file=sys.stderr)


def unforeseen(where: str, error: Exception) -> None:
    """Prints the traceback of an error that is being handled, once for each place and kind."""
    if _is_new(f"{where}: {type(error).__name__}"):
        print(
            f"FRoG: {where}: an unforeseen {type(error).__name__}; it is said once.",
            file=sys.stderr,
        )
        traceback.print_exception(error, file=sys.stderr)


def forget() -> None:
    """Everything may be said again, as for another file."""
    with _lock:
        _said.clear()


def _is_new(key: str) -> bool:
    with _lock:
        if key in _said or len(_said) >= _MOST:
            return False
        _said.add(key)
        return True
