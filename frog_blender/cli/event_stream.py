"""A training for another program: its events as lines on standard output, obeying what comes on standard input."""

from __future__ import annotations

import io
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress

from ..engine.io.child_process import bounded_lines
from ..engine.training.session import events
from ..engine.training.session.cancel_token import CancelToken
from ..engine.training.session.events import line_of

_LONGEST_WORD = 4096
_STANDARD_INPUT = 0


def tell(stream: Iterator[events.Event]) -> bool:
    """Prints each event as a line of JSON; True when the training finished, False when it was cancelled."""
    finished = False
    for event in stream:
        line = line_of(event)
        if line is not None:
            print(line, flush=True)
        finished = isinstance(event, events.Finished)
    return finished


def obeying_input(ends: Callable[[], bool]) -> CancelToken:
    """A token that obeys lines on standard input: ``pause``, ``resume`` and ``preview CAMERA``. It cancels when
    standard input ends: the program that reads the events is gone, or has closed it for that.

    Args:
        ends: is asked as well.
    """
    control = CancelToken(ends)
    threading.Thread(target=_obey, args=(control,), daemon=True).start()
    return control


def _obey(control: CancelToken) -> None:
    with suppress(OSError):  # it is closed
        # Not sys.stdin, whose lock would outlive the interpreter.
        for line in bounded_lines(io.FileIO(_STANDARD_INPUT, closefd=False), _LONGEST_WORD):
            word, _, rest = line.decode("utf-8", "replace").strip().partition(" ")
            if word == "pause":
                control.pause()
            elif word == "resume":
                control.resume()
            elif word == "preview":
                control.preview_camera = rest
    control.cancel()
