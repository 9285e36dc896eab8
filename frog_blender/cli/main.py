"""``frog``, from its first moment on: requests to end are obeyed before what commands are made of is imported."""

import atexit
import os
import signal
from collections.abc import Sequence
from contextlib import suppress

from . import CANCELLED


def main(arguments: Sequence[str] | None = None) -> int:
    """Runs a command and returns its exit status; an error is one sentence on standard error.

    Args:
        arguments: of the command; None for those of this process, which then ends with it.
    """
    if arguments is None:
        for name in ("SIGINT", "SIGTERM", "SIGHUP", "SIGBREAK"):
            number = getattr(signal, name, None)
            if number is not None and signal.getsignal(number) != signal.SIG_IGN:
                signal.signal(number, _end)
                atexit.register(signal.signal, number, signal.SIG_IGN)  # last of all: Python drops its handlers then
    from .commands import run

    return run(arguments)


def _end(*_: object) -> None:
    """Ends the process at once: nothing is half-written before a command begins, or after its end."""
    with suppress(OSError):
        os.write(2, b"frog: interrupted.\n")
    os._exit(CANCELLED)
