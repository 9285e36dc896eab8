"""Ctrl-C and other requests to end: long commands save their state, all others remove what is half-written.

A closed terminal, a lost connection (SIGHUP), ``kill``, a scheduler or a system that shuts down (SIGTERM), and a
closed console window of Windows (SIGBREAK and its events) count as the first Ctrl-C.
"""

from __future__ import annotations

import os
import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, nullcontext
from types import FrameType
from typing import Any

from .console_close import console_closing

_CTRL_C = signal.SIGINT
_OTHERS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]

Handler = Callable[[int, FrameType | None], Any]


@contextmanager
def stopping() -> Iterator[Callable[[], bool]]:
    """Yields a function that returns True after the first request to end; a second Ctrl-C raises KeyboardInterrupt.

    Other repeated requests do nothing: a closed terminal sends SIGHUP twice, and a scheduler may repeat SIGTERM.
    """
    asked = False

    def ask() -> None:
        nonlocal asked
        asked = True

    def stop(number: int, _: FrameType | None) -> None:
        if asked and number == _CTRL_C:
            raise KeyboardInterrupt
        ask()

    closing = console_closing(ask) if os.name == "nt" else nullcontext()
    with _handled(_CTRL_C, stop), _all_handled(stop), closing:
        yield lambda: asked


@contextmanager
def leaving_cleanly() -> Iterator[None]:
    """Inside the block a request to end raises KeyboardInterrupt, so that what is half-written is removed."""

    def leave(*_: object) -> None:
        raise KeyboardInterrupt

    with _all_handled(leave):
        yield


@contextmanager
def _all_handled(handler: Handler) -> Iterator[None]:
    """Handles requests other than Ctrl-C; an ignored SIGHUP stays ignored, as ``nohup`` sets it."""
    with ExitStack() as stack:
        for number in _OTHERS:
            if signal.getsignal(number) != signal.SIG_IGN:
                stack.enter_context(_handled(number, handler))
        yield


@contextmanager
def _handled(number: int, handler: Handler) -> Iterator[None]:
    """Handles a signal inside the block; does nothing outside the main thread, where Python allows no handlers."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    previous = signal.signal(number, handler)
    try:
        yield
    finally:
        signal.signal(number, previous if previous is not None else signal.SIG_DFL)
