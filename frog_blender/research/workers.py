"""Who does the runs of a grid, several at once: processes of this machine, or the workers of a cluster."""

from __future__ import annotations

import json
import os
import queue
import subprocess
import sys
import threading
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from .grid import Run
from .runs import RunEnvironment, failure

if TYPE_CHECKING:
    from ..engine import Cluster, Ended

Answers = queue.Queue[tuple[Run, dict[str, Any]]]
"""What runs answer: ``{"share": ...}`` any number of times, then ``{"record": ...}`` or ``{"stopped": True}``."""


class Working(Protocol):
    """A run in progress."""

    def stop(self) -> None:
        """Asks it to save its state and end."""

    def wait(self) -> None:
        """Returns when it has ended."""


class Workers(Protocol):
    """Who does runs."""

    @property
    def jobs(self) -> int:
        """How many runs are done at once."""

    @property
    def threads(self) -> int:
        """Threads of each."""

    def start(self, run: Run, environment: RunEnvironment, seconds: float | None, answers: Answers) -> Working:
        """Begins a run.

        Args:
            seconds: the limit of a run at equal time.
            answers: where its answers go.
        """


def task_of(run: Run, environment: RunEnvironment, seconds: float | None) -> dict[str, Any]:
    """A run as JSON values, for ``worker.do_run``. Its paths are absolute: it may be done from another folder."""
    run = replace(run, capture=str(Path(run.capture).resolve()))
    folder = str(environment.folder.resolve())
    task: dict[str, Any] = {"run": run.to_json(), "folder": folder, "device": environment.device}
    return task | {"threads": environment.threads, "dedicated": environment.dedicated, "seconds": seconds}


@dataclass(frozen=True)
class Processes:
    """Processes of this machine, which share its cores.

    Attributes:
        jobs: how many at once.
    """

    jobs: int

    @property
    def threads(self) -> int:
        return max(1, (os.cpu_count() or 1) // self.jobs)

    def start(self, run: Run, environment: RunEnvironment, seconds: float | None, answers: Answers) -> Working:
        return _Process(run, environment, seconds, answers)


class _Process:
    """A process of ``worker``, and a thread that puts its answers into a queue."""

    def __init__(self, run: Run, environment: RunEnvironment, seconds: float | None, answers: Answers) -> None:
        self._log = environment.scene(run).with_suffix(".log")
        root = Path(__file__).resolve().parents[__name__.count(".")]
        path = os.pathsep.join([str(root), *filter(None, [os.environ.get("PYTHONPATH")])])
        threads = str(environment.threads)
        variables = {**os.environ, "PYTHONPATH": path, "OMP_NUM_THREADS": threads, "MKL_NUM_THREADS": threads}
        with self._log.open("w", encoding="utf-8") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", f"{__package__}.worker"],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=log,
                text=True,
                encoding="utf-8",
                env=variables,
            )
        task = task_of(run, environment, seconds)
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):  # it ended at once, which ``_listen`` reports
            self._process.stdin.write(json.dumps(task) + "\n")
            self._process.stdin.flush()
        threading.Thread(target=self._listen, args=(run, answers), daemon=True).start()

    def _listen(self, run: Run, answers: Answers) -> None:
        assert self._process.stdout is not None
        ended = False
        for line in self._process.stdout:
            try:
                answer = json.loads(line)
            except ValueError:
                continue
            ended |= "share" not in answer
            answers.put((run, answer))
        if not ended:
            status = self._process.wait()
            sentence = f"The process of this run ended with status {status}; see {self._log.name}."
            answers.put((run, {"record": failure(run, sentence)}))

    def stop(self) -> None:
        """Asks it to save its state and end."""
        assert self._process.stdin is not None
        with suppress(BrokenPipeError):
            self._process.stdin.close()

    def wait(self) -> None:
        """Waits for its end; its log is kept if its status is not 0."""
        self.stop()
        if self._process.wait() == 0:
            self._log.unlink(missing_ok=True)


@dataclass(frozen=True)
class ClusterWorkers:
    """The workers of a cluster.

    Attributes:
        cluster: where runs are given out. Its workers see captures and results under the same paths.
        threads: of each run.
    """

    cluster: Cluster
    threads: int

    @property
    def jobs(self) -> int:
        return self.cluster.slots

    def start(self, run: Run, environment: RunEnvironment, seconds: float | None, answers: Answers) -> Working:
        return _ClusterRun(self.cluster, run, task_of(run, environment, seconds), answers)


class _ClusterRun:
    """A run on a cluster, with its answers put into a queue."""

    def __init__(self, cluster: Cluster, run: Run, task: dict[str, Any], answers: Answers) -> None:
        from .worker import do_run

        self._cluster, self._run, self._answers = cluster, run, answers
        self._done = threading.Event()
        cluster.start(run.key, do_run, task, lambda share: answers.put((run, {"share": share})), self._ended)

    def _ended(self, ended: Ended) -> None:
        answer = {"record": failure(self._run, ended.error)} if ended.error is not None else ended.answer
        self._answers.put((self._run, answer))
        self._done.set()

    def stop(self) -> None:
        self._cluster.stop()

    def wait(self) -> None:
        self._done.wait()
