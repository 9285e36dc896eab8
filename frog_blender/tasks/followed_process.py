"""A command that is followed while it runs: its lines, its last words, and ways to end it."""

from __future__ import annotations

import os
import queue
import signal
import subprocess
import threading
from collections import deque
from collections.abc import Sequence
from contextlib import suppress

from ..engine.errors import FrogError, brief
from ..engine.training.session.event_lines import bounded_lines

_WAITING = 8  # lines that wait to be taken; then the command waits
_LAST_LINES = 3
_LONGEST_WORDS = 2000  # bytes of a line of standard error
_DRAINED = 1.0  # seconds for what an ended command has left in its pipes, which its own children may hold open


class FollowedProcess:
    """A command started without a shell; FrogError where it cannot be.

    Its standard input ends when this process does, which tells it to end.
    """

    def __init__(self, arguments: Sequence[str]) -> None:
        try:
            self._process = subprocess.Popen(
                arguments,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.PIPE,
                start_new_session=os.name == "posix",  # whatever it starts is killed with it
            )
        except (OSError, ValueError) as error:
            why = getattr(error, "strerror", None) or error
            raise FrogError(f"{brief(arguments[0])}: the remote command could not be started ({why}).") from error
        self._lines: queue.Queue[bytes] = queue.Queue(_WAITING)
        self._is_left = threading.Event()
        self._said: deque[bytes] = deque(maxlen=_LAST_LINES)
        self._readers = [threading.Thread(target=work, daemon=True) for work in (self._read, self._listen)]
        for reader in self._readers:
            reader.start()

    @property
    def code(self) -> int | None:
        """The exit status; None while it runs."""
        return self._process.poll()

    def line(self, patience: float) -> bytes | None:
        """The next line of its standard output; None where none comes within so many seconds."""
        with suppress(queue.Empty):
            return self._lines.get(timeout=patience)
        return None

    def drained(self) -> bool:
        """Whether it has ended, and no line will follow. Waits a moment for what is left in its pipes."""
        if self.code is None:
            return False
        for reader in self._readers:
            reader.join(_DRAINED)
        return self._lines.empty()

    def send(self, line: str) -> None:
        """Writes a line to its standard input."""
        if self._process.stdin is not None and not self._process.stdin.closed:
            with suppress(OSError):
                self._process.stdin.write(f"{line}\n".encode("utf-8", "replace"))
                self._process.stdin.flush()

    def end_input(self) -> None:
        """Closes its standard input, which asks it to end."""
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()

    def kill(self) -> None:
        """Ends it at once, with what it has started."""
        if self.code is not None:
            return
        with suppress(OSError):
            if os.name == "posix":
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()

    def leave(self) -> None:
        """Ends it where it still runs. Nobody takes its lines any more."""
        self._is_left.set()
        self.end_input()
        self.kill()
        with suppress(queue.Empty):
            while True:  # makes room for the line that waits to be put
                self._lines.get_nowait()

    def last_words(self) -> str:
        """Its last lines on standard error, as one."""
        said = b" ".join(line.strip() for line in self._said).decode("utf-8", "replace")
        return brief(said.removeprefix("frog: ")) or "it said nothing"

    def _read(self) -> None:
        if self._process.stdout is not None:
            with self._process.stdout as stream:
                for line in bounded_lines(stream):
                    if self._is_left.is_set():
                        return
                    self._lines.put(line)

    def _listen(self) -> None:
        if self._process.stderr is not None:
            with self._process.stderr as stream:
                self._said.extend(bounded_lines(stream, _LONGEST_WORDS))
