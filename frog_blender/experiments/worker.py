"""A process that does one run for ``execute.run_grid``.

It reads the task from standard input and answers in JSON lines.
It saves a checkpoint and stops when its input ends: the process that started it closed it, or was killed.
"""

from __future__ import annotations

import json
import os
import sys
import threading
from contextlib import suppress
from pathlib import Path
from typing import TextIO

from ..engine.errors import FrogError
from .grid import Run
from .results import finite
from .runs import RunEnvironment, Stopped, failure, perform


def serve(task: str, answer: TextIO, stopping: threading.Event) -> None:
    """Does a run. Answers lines of {"share": ...} and a last one of {"record": ...} or {"stopped": true}.

    Args:
        task: a JSON object: run, folder, device, threads, dedicated, seconds.
        answer: where the lines are written.
        stopping: set to cancel the run.
    """
    wanted = json.loads(task)
    run = Run.from_json(wanted["run"])
    environment = RunEnvironment(Path(wanted["folder"]), wanted["device"], wanted["threads"], wanted["dedicated"])

    def say(**values: object) -> None:
        with suppress(OSError):  # nobody reads any more: it is about to be stopped, and must still save
            answer.write(json.dumps(finite(values), allow_nan=False) + "\n")
            answer.flush()

    try:
        record = perform(run, environment, wanted["seconds"], lambda share: say(share=share), stopping.is_set)
        say(record=record)
    except Stopped:
        say(stopped=True)
    except (FrogError, MemoryError, ImportError) as error:
        say(record=failure(run, str(error) or type(error).__name__))


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
