"""A process that does one run of a grid, for ``workers.Processes``.

It reads the task from standard input and answers in JSON lines.
It saves a checkpoint and stops when its input ends: the process that started it closed it, or was killed.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from collections.abc import Callable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any, TextIO

from ..engine import FrogError
from .grid import Run
from .results import finite
from .runs import RunEnvironment, Stopped, failure, perform


def do_run(task: Mapping[str, Any], say: Callable[[float], None], cancelled: Callable[[], bool]) -> dict[str, Any]:
    """Does a run; returns ``{"record": ...}``, or ``{"stopped": True}`` if it was cancelled.

    Args:
        task: see ``workers.task_of``.
        say: called with the share of the run that is done.
        cancelled: asked whether to stop.
    """
    run = Run.from_json(task["run"])
    environment = RunEnvironment(Path(task["folder"]), task["device"], task["threads"], task["dedicated"])
    try:
        return {"record": finite(perform(run, environment, task["seconds"], say, cancelled))}
    except Stopped:
        return {"stopped": True}
    except (FrogError, MemoryError, ImportError) as error:
        return {"record": failure(run, str(error) or type(error).__name__)}


def serve(task: str, answer: TextIO, stopping: threading.Event) -> None:
    """Does a run. Answers lines of {"share": ...}, and a last one with what ``do_run`` returns.

    Args:
        task: a JSON object, see ``workers.task_of``.
        answer: where the lines are written.
        stopping: set to cancel the run.
    """

    def say(values: Mapping[str, Any]) -> None:
        with suppress(OSError):  # nobody reads any more: it is about to be stopped, and must still save
            answer.write(json.dumps(finite(dict(values)), allow_nan=False) + "\n")
            answer.flush()

    say(do_run(json.loads(task), lambda share: say({"share": share}), stopping.is_set))


def main() -> None:
    answer = os.fdopen(os.dup(1), "w", encoding="utf-8")
    os.dup2(2, 1)  # anything else that is printed goes to the log
    task = sys.stdin.readline()
    stopping = threading.Event()

    def wait() -> None:
        sys.stdin.read()
        stopping.set()

    threading.Thread(target=wait, daemon=True).start()
    serve(task, answer, stopping)


if __name__ == "__main__":
    import signal

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches the whole process group; the parent decides
    main()
