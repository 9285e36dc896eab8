"""Console messages that are printed once, though their cause recurs at every frame."""

import sys
import traceback

from . import addon_state

_MOST = 1000  # messages kept, as a message may differ at each frame


class ReportedMessages(dict[str, object]):
    """The messages that were printed since the file was opened, and what each was first asked for by."""


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
    """Allows every message to be printed again, for another file."""
    addon_state.get(ReportedMessages).clear()


def _is_new(key: str) -> bool:
    reported, asked = addon_state.get(ReportedMessages), object()
    # In one step: a render reports from its own thread.
    return len(reported) < _MOST and reported.setdefault(key, asked) is asked
