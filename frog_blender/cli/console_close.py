"""Events of a Windows console that end a process: the window is closed, the user logs off, the computer shuts down.

Windows ends the process when its handler of such an event returns, and at the latest some seconds later. The handler
has its own thread and waits until the training is saved.
"""

from __future__ import annotations

import ctypes
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager

_CLOSE, _LOG_OFF, _SHUT_DOWN = 2, 5, 6
_MAX_WAIT = 30.0  # seconds; Windows itself waits less


@contextmanager
def console_closing(ask: Callable[[], None]) -> Iterator[None]:
    """Calls ``ask`` when the console closes, and lets Windows end the process once the block has ended."""
    if sys.platform != "win32":
        yield
        return
    ended = threading.Event()

    @ctypes.WINFUNCTYPE(ctypes.c_int, ctypes.c_uint)
    def handle(event: int) -> int:
        if event not in (_CLOSE, _LOG_OFF, _SHUT_DOWN):
            return 0  # Ctrl-C and Ctrl-Break are Python's
        ask()
        ended.wait(_MAX_WAIT)
        return 1

    kernel = ctypes.windll.kernel32
    kernel.SetConsoleCtrlHandler(handle, 1)
    try:
        yield
    finally:
        ended.set()
        kernel.SetConsoleCtrlHandler(handle, 0)
