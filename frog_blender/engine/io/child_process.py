"""Programs beside this one: followed by their lines, killed with all they have started, and gone when this one is.

``ChildProcess`` is any program. ``run_in_child`` runs a function of the engine in a Python of its own: whatever ends
that one, memory or a crash in a library, this one goes on.
"""

import importlib
import json
import os
import queue
import signal
import subprocess
import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import IO, Self, TypeVar, get_type_hints

from ..errors import FrogError, brief, how_it_ended, in_words
from .atomic_files import write_atomically
from .plain_values import UnfitValue, entries, plain, plain_json, typed

Progress = Callable[[str, int, int], None]
"""Told a stage's name, and how much of how much is done."""
Result = TypeVar("Result")
_REQUEST, _RESULT = "request.json", "result.json"
_PACKAGE = Path(__file__).parents[2]  # frog_blender, or an extension that holds it
_ENGINE = f"{_PACKAGE.name}.engine"  # as a child of ours imports it
_LONGEST_LINE = 2**23  # bytes of a line that is read
_QUESTIONS = 0.1  # seconds between questions whether to stop
_WAITING = 8  # lines that wait to be taken; then the program waits
_LAST_LINES = 3
_LONGEST_WORDS = 2000  # bytes of a line of standard error
_DRAINED = 1.0  # seconds for what an ended program has left in its pipes, which its own children may hold open
_REAPED = 10.0  # seconds for the system to end a killed program
_MOST_TEXT = 2**26  # bytes of a result


class Stopped(Exception):
    """The caller asked for the end. No FrogError: nothing is wrong."""


def bounded_lines(stream: IO[bytes], longest: int = _LONGEST_LINE) -> Iterator[bytes]:
    """The lines of a stream; longer ones are skipped, whatever their length, and never held in memory."""
    is_whole = True
    while piece := stream.readline(longest):
        ends = piece.endswith(b"\n") or len(piece) < longest
        if is_whole and ends:
            yield piece
        is_whole = ends


class ChildProcess:
    """A program that was started without a shell. Its standard input ends when this process does, which tells it to
    end; leaving the ``with`` block ends it at once.

    Args:
        environment: variables that it has besides this process's.
        folder: its current one.
        merged: its standard error is among its lines.

    Raises:
        FrogError: where it cannot be started.
    """

    def __init__(
        self,
        arguments: Sequence[str],
        *,
        environment: Mapping[str, str] | None = None,
        folder: Path | None = None,
        merged: bool = False,
    ) -> None:
        with in_words(f"{brief(arguments[0])}: could not be started", kinds=(OSError, ValueError)):
            self._process = subprocess.Popen(
                arguments,
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT if merged else subprocess.PIPE,
                cwd=folder,
                env=os.environ | environment if environment else None,
                start_new_session=os.name == "posix",  # whatever it starts is killed with it
            )
        self._lines: queue.Queue[bytes] = queue.Queue(_WAITING)
        self._is_left = threading.Event()
        self._said: deque[bytes] = deque(maxlen=_LAST_LINES)
        pipes = (self._read, self._process.stdout), (self._listen, self._process.stderr)
        self._readers = [threading.Thread(target=work, args=[pipe], daemon=True) for work, pipe in pipes if pipe]
        for reader in self._readers:
            reader.start()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Ends it where it still runs. Nobody takes its lines any more."""
        self._is_left.set()
        if self._process.stdin is not None:
            with suppress(OSError):
                self._process.stdin.close()
        self.kill()
        with suppress(queue.Empty):
            while True:  # makes room for the line that waits to be put
                self._lines.get_nowait()
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(_REAPED)

    @property
    def code(self) -> int | None:
        """The exit status; None while it runs."""
        return self._process.poll()

    def lines(self, stopped: Callable[[], bool] = lambda: False) -> Iterator[bytes]:
        """The lines of its standard output until it has ended.

        Args:
            stopped: is asked before each line, and ten times a second.

        Raises:
            Stopped: if ``stopped`` said so.
        """
        while not stopped():
            try:
                line = self._lines.get(timeout=_QUESTIONS)
            except queue.Empty:
                if self._is_drained():
                    return
            else:
                yield line
        raise Stopped

    def kill(self) -> None:
        """Ends it at once, with what it has started; from any thread."""
        if self.code is not None:
            return
        with suppress(OSError):
            if os.name == "posix":
                os.killpg(self._process.pid, signal.SIGKILL)
            else:
                self._process.kill()

    @property
    def end(self) -> str:
        """How it ended, and its last lines on standard error: "ended with status 1 (no memory)"."""
        said = brief(b" ".join(line.strip() for line in self._said).decode("utf-8", "replace")) or "it said nothing"
        return f"{how_it_ended(self.code or 0)} ({said.rstrip('.')})"

    def _is_drained(self) -> bool:
        """Whether it has ended, and no line will follow. Waits a moment for what is left in its pipes."""
        if self.code is None:
            return False
        for reader in self._readers:
            reader.join(_DRAINED)
        return self._lines.empty()

    def _read(self, output: IO[bytes]) -> None:
        with output:
            for line in bounded_lines(output):
                if self._is_left.is_set():
                    return
                self._lines.put(line)

    def _listen(self, errors: IO[bytes]) -> None:
        with errors:
            self._said.extend(bounded_lines(errors, _LONGEST_WORDS))


def run_in_child(
    function: Callable[..., Result],
    *arguments: object,
    folder: Path,
    progress: Progress,
    stopped: Callable[[], bool] = lambda: False,
    failure: Callable[[str], str],
    kind: type[FrogError] = FrogError,
) -> Result:
    """What a function of the engine returns, run in a Python of its own: what a library does to that ends it alone.

    Its arguments and its result pass as ``plain`` values in files of a folder.

    Args:
        progress: told what the function tells its last parameter, where that is called ``tell``.
        failure: the sentence for a process that failed, of how it ended.
        kind: of FrogError that the function may raise, which is raised here as such.

    Raises:
        Stopped: if ``stopped`` said so; the process was ended.
        FrogError: if the function raised one, or its process failed or died.
    """
    path, module = folder / _RESULT, function.__module__.rpartition(".engine.")[2]
    path.unlink(missing_ok=True)
    request = {"module": module, "function": function.__name__, "arguments": plain(arguments)}
    write_atomically(folder / _REQUEST, json.dumps(request).encode())
    command = [sys.executable, "-P", "-m", f"{_ENGINE}.io.child_process", str(folder)]
    with ChildProcess(command, environment=_python_environment()) as child:
        for line in child.lines(stopped):
            if (told := _told(line)) is not None:
                progress(*told)
        if child.code or not path.is_file():
            raise FrogError(failure(child.end))
    try:
        if path.stat().st_size > _MOST_TEXT:
            raise UnfitValue(f"{path.stat().st_size} bytes", "less")
        answer = entries(plain_json(path.read_text(encoding="utf-8"), "a result"), "a result")
        if "error" in answer:
            raise (kind if answer.get("kind") == kind.__name__ else FrogError)(answer["error"])
        result: Result = typed(get_type_hints(function)["return"], answer.get("result"), "a result")
        return result
    except (OSError, UnfitValue) as error:
        raise FrogError(f"{path}: found a result that cannot be read ({brief(error)}).") from error


def _python_environment() -> dict[str, str]:
    """Variables of a Python that imports what this one does."""
    return {
        "PYTHONPATH": os.pathsep.join([str(_PACKAGE.parent), *filter(None, sys.path)]),
        "PYTHONIOENCODING": "utf-8",
        "OPENBLAS_NUM_THREADS": "1",  # its threads reserve memory, and wait for each other on small matrices
        "PXR_WORK_THREAD_LIMIT": "1",
    }


def _told(line: bytes) -> tuple[str, int, int] | None:
    """The progress that a child's line tells; None for a line of some library."""
    try:
        told = json.loads(line)
        return str(told["stage"]), int(told["done"]), int(told["total"])
    except (ValueError, KeyError, TypeError):
        return None


def _tell(stage: str, done: int, total: int) -> None:
    print(json.dumps({"stage": stage, "done": done, "total": total}), flush=True)


def _end_with_parent() -> None:
    """Standard input ends when the parent does, however that ended."""
    while os.read(0, 1024):  # not sys.stdin, whose lock would outlive the interpreter
        pass
    os._exit(1)


def main(folder: Path) -> None:
    """The child: runs a function and writes its result; anything but a FrogError ends the process as it is."""
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        request = entries(plain_json((folder / _REQUEST).read_text(encoding="utf-8"), "a request"), "a request")
        function = getattr(importlib.import_module(f"{_ENGINE}.{request['module']}"), request["function"])
        hints = get_type_hints(function)
        del hints["return"]
        more = {"tell": _tell} if hints.pop("tell", None) else {}
        given = zip(hints.items(), request["arguments"], strict=True)
        answer = {"result": plain(function(*(typed(hint, value, name) for (name, hint), value in given), **more))}
    except FrogError as error:
        answer = {"error": str(error), "kind": type(error).__name__}
    write_atomically(folder / _RESULT, json.dumps(answer).encode())


if __name__ == "__main__":
    main(Path(sys.argv[1]))
