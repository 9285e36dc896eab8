"""What a command has to do with its terminal: printing, also where nobody reads any more, and requests to end.

Ctrl-C and other requests to end: long commands save their state, all others remove what is half-written. A closed
terminal, a lost connection (SIGHUP), ``kill``, a scheduler or a system that shuts down (SIGTERM), and a closed console
window of Windows (SIGBREAK and its events) count as the first Ctrl-C.
"""

import argparse
import ctypes
import json
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager, nullcontext, redirect_stdout, suppress
from datetime import datetime
from types import FrameType
from typing import Any, TextIO

from ..engine.errors import printable

_CTRL_C = signal.SIGINT
_OTHERS = [getattr(signal, name) for name in ("SIGTERM", "SIGHUP", "SIGBREAK") if hasattr(signal, name)]
_CLOSE, _LOG_OFF, _SHUT_DOWN = 2, 5, 6  # events of a Windows console that end a process
_IMPORTING = "<frozen importlib._bootstrap>"  # in the stack of whatever a module does while it is imported
_IMPORT_WAIT = 0.02  # seconds
_MAX_WAIT = 30.0  # seconds; Windows itself waits less


class Output:
    """How output is told, as a command's ``--quiet`` and ``--log`` say; one for the process."""

    quiet = False
    log: TextIO | None = None


def log_line(line: str) -> None:
    """A line of the log, with the time, if there is one; a disk that is full ends nothing."""
    if Output.log is not None and line.strip():
        with suppress(OSError, ValueError):
            print(f"{datetime.now().isoformat(timespec='seconds')} {line.rstrip()}", file=Output.log, flush=True)


@contextmanager
def printed(quiet: bool, log: TextIO | None) -> Iterator[None]:
    """Inside the block output is told so: what is printed goes to the log as well, without bars."""
    before, Output.quiet, Output.log = (sys.stdout, sys.stderr), quiet, log
    if log is not None:
        sys.stdout, sys.stderr = _LoggedStream(sys.stdout), _LoggedStream(sys.stderr)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
        Output.quiet, Output.log = False, None
        if log is not None:
            log.close()


def say(text: object) -> None:
    """Prints a line of a command's result, without control characters: text from files must not control the
    terminal."""
    print(printable(text))


def complain(text: object) -> None:
    """Prints a line about an error to standard error."""
    print(f"frog: {printable(text)}", file=sys.stderr)


def add_json_argument(parser: Any) -> None:
    """Adds ``--json``; see ``answering``."""
    parser.add_argument("--json", action="store_true", dest="as_json", help="print the result as JSON, for programs")


@contextmanager
def answering(options: argparse.Namespace) -> Iterator[None]:
    """Inside the block a command may fill ``options.figures`` as docs/json-schema.json says. With ``--json`` they are
    printed at its end as one object, and what else it says goes to standard error."""
    options.figures, as_json = {}, getattr(options, "as_json", False)
    with redirect_stdout(sys.stderr) if as_json else nullcontext():
        yield
    if as_json and options.figures:
        print(json.dumps(options.figures, indent=1))


@contextmanager
def stopping() -> Iterator[Callable[[], bool]]:
    """Yields a function that returns True after the first request to end; a second Ctrl-C raises KeyboardInterrupt.

    Other repeated requests do nothing: a closed terminal sends SIGHUP twice, and a scheduler may repeat SIGTERM.
    """
    asked, around = False, signal.getsignal(_CTRL_C)

    def ask() -> None:
        nonlocal asked
        asked = True
        if isinstance(around, Leaving):
            around.was_asked = True

    def stop(signal_number: int, _: FrameType | None) -> None:
        if asked and signal_number == _CTRL_C:
            raise KeyboardInterrupt
        if not asked:
            with suppress(OSError):  # past Python's own streams, in whose middle it may be
                os.write(2, b"\nfrog: stopping, and keeping what is done; Ctrl-C again leaves at once.\n")
        ask()

    with _handled([_CTRL_C, *_OTHERS], stop), _console_closing(ask):
        yield lambda: asked


class Leaving:
    """Handles a request to end: raises KeyboardInterrupt, but after an import, where some libraries print and forget
    it, and stay half-loaded.

    Attributes:
        was_asked: whether there was one that ``stopping`` answered.
    """

    was_asked = False

    def __call__(self, signal_number: int, frame: FrameType | None) -> None:
        while frame is not None:
            if frame.f_code.co_filename == _IMPORTING:
                later = threading.Timer(_IMPORT_WAIT, _signal_again, [signal_number])
                later.daemon = True
                later.start()
                return
            frame = frame.f_back
        raise KeyboardInterrupt


def _signal_again(signal_number: int) -> None:
    """To the main thread itself, where it can be told: that ends what it waits for."""
    if sys.platform == "win32":
        signal.raise_signal(signal_number)
    else:
        signal.pthread_kill(threading.main_thread().ident or 0, signal_number)


@contextmanager
def leaving_cleanly() -> Iterator[Leaving]:
    """Inside the block a request to end raises KeyboardInterrupt, so that what is half-written is removed."""
    leaving = Leaving()
    with _handled([_CTRL_C, *_OTHERS], leaving):
        yield leaving


@contextmanager
def _handled(signals: Iterable[int], handler: Callable[[int, FrameType | None], Any]) -> Iterator[None]:
    """Handles signals inside the block; does nothing outside the main thread, where Python allows no handlers.

    A request other than Ctrl-C that is ignored stays so, as ``nohup`` sets it.
    """
    before = {}
    if threading.current_thread() is threading.main_thread():
        for handled in signals:
            if handled == _CTRL_C or signal.getsignal(handled) != signal.SIG_IGN:
                before[handled] = signal.signal(handled, handler)
    try:
        yield
    finally:
        for handled, previous in before.items():
            signal.signal(handled, previous if previous is not None else signal.SIG_DFL)


@contextmanager
def _console_closing(ask: Callable[[], None]) -> Iterator[None]:
    """Calls ``ask`` when a Windows console closes, the user logs off, or the computer shuts down.

    Windows ends the process when its handler of such an event returns, and at the latest some seconds later. The
    handler has its own thread and waits until the block has ended.
    """
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


@contextmanager
def printing_may_fail() -> Iterator[None]:
    """Inside the block output that cannot be printed is dropped without an error, so that it ends no training.

    The terminal may be closed, the pipe's reader gone, or the disk of a log full.
    """
    before = sys.stdout, sys.stderr
    sys.stdout, sys.stderr = _LossyStream(sys.stdout), _LossyStream(sys.stderr)
    try:
        yield
    finally:
        sys.stdout, sys.stderr = before
        for stream in before:
            _drop_buffer(stream)


class _Stream:
    """Wraps a text stream."""

    def __init__(self, stream: TextIO) -> None:
        self._stream = stream

    def __getattr__(self, name: str) -> Any:  # as the stream's own attributes
        return getattr(self._stream, name)


class _LoggedStream(_Stream):
    """Its whole lines go to the log too; of a line that was written over, what is read at last."""

    _line = ""

    def write(self, text: str) -> int:
        *lines, self._line = (self._line + text).split("\n")
        for line in lines:
            log_line(line.rsplit("\r", 1)[-1])
        return self._stream.write(text)


class _LossyStream(_Stream):
    """Writing to it never raises."""

    def write(self, text: str) -> int:
        with suppress(OSError, ValueError):
            return self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with suppress(OSError, ValueError):
            self._stream.flush()


def _drop_buffer(stream: TextIO) -> None:
    """Flushes a stream; drops what cannot be written, which would else raise again when Python exits."""
    try:
        stream.flush()
    except (OSError, ValueError):
        with suppress(OSError, ValueError), open(os.devnull, "w", encoding="utf-8") as nowhere:
            os.dup2(nowhere.fileno(), stream.fileno())
