"""Independent tasks on the workers of a Dask cluster: one of this machine, or one whose scheduler is running.

A task is a function of a module that the workers can import, with what it needs: plain values, or dataclasses of them.
Paths in it must mean the same on every worker. A task whose worker dies is given to another one.
"""

from __future__ import annotations

import asyncio
import logging
import os
import queue
import re
import socket
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING, Any, cast

from ..errors import FrogError, UsageError, reason
from ..notices import say

if TYPE_CHECKING:
    from distributed import Client, Future, LocalCluster

LOCAL = "local"
"""The scheduler's address that stands for a cluster of this machine's own."""
_CONNECT_SECONDS = 10.0
_ADDRESS = re.compile(r"(?P<scheme>tcp|tls)://(?P<host>[^/:\s]+|\[[0-9a-fA-F:]+\]):(?P<port>[0-9]{1,5})")
_ASKED_EVERY = 1.0  # seconds between a worker's questions whether to stop: each goes to the scheduler and back

Task = Mapping[str, Any]
Say = Callable[[Any], None]
Work = Callable[[Task, Say, Callable[[], bool]], Any]
"""Does a task: given its values, a callback for messages, and one that is asked whether to stop."""


@dataclass(frozen=True)
class Ended:
    """How a task ended.

    Attributes:
        answer: what its function returned; None if it failed.
        error: a sentence; None unless it failed.
    """

    answer: Any = None
    error: str | None = None


class Cluster:
    """A connection to a scheduler, and the cluster itself where it is this machine's own. A context manager.

    Args:
        scheduler: an address such as "tls://10.0.0.5:8786", with Dask's own settings of TLS, or ``LOCAL``: to its
            processes connects who has a certificate that they alone are told.
        workers: processes of a local cluster, which share the cores.

    Raises:
        FrogError: if no scheduler answers.
    """

    def __init__(self, scheduler: str, workers: int = 1) -> None:
        from distributed import Client, Event

        logging.getLogger("distributed").setLevel(logging.CRITICAL)  # what ends a task is said once, by the caller
        if scheduler != LOCAL:
            _check_reachable(scheduler)
        self._own = _local_cluster(workers) if scheduler == LOCAL else None
        try:
            self._client: Client = Client(self._own or scheduler, timeout=_CONNECT_SECONDS, set_as_default=False)
        except (OSError, ValueError) as error:
            self._close_own()
            raise _no_answer(scheduler, error) from error
        self._name = f"frog-{uuid.uuid4().hex}"
        self._told: dict[str, Say] = {}
        self._futures: dict[str, Future[Any]] = {}
        self._stopping = False
        self._stop = Event(self._name, client=self._client)
        self._client.subscribe_topic(self._name, self._heard)

    def __enter__(self) -> Cluster:
        return self

    def __exit__(self, *_: object) -> None:
        self.stop()
        self._client.close()
        self._close_own()

    def _close_own(self) -> None:
        if self._own is not None:
            self._own.close()

    @property
    def dashboard(self) -> str:
        """The address of the scheduler's page in a browser; "" of this machine's own, which has none."""
        return "" if self._own else str(self._client.dashboard_link)

    @property
    def slots(self) -> int:
        """How many tasks run at once; at least one, since workers may come later."""
        slots: int = sum(self._client.nthreads().values())
        return max(1, slots)

    def threads(self) -> int:
        """Threads that each task may use: a machine's cores shared by its slots, the fewest of any machine."""
        cores = self._client.run(os.cpu_count)
        workers = self._client.scheduler_info(n_workers=-1)["workers"]  # of one moment: others may come and go
        slots: Counter[str] = Counter()
        for worker in workers.values():
            slots[worker["host"]] += worker["nthreads"]
        shares = (count // slots[workers[name]["host"]] for name, count in cores.items() if name in workers)
        return max(1, min(shares, default=1))

    def messages(
        self, work: Work, tasks: Iterable[tuple[str, Task]], stopped: Callable[[], bool] = lambda: False
    ) -> Iterator[tuple[str, Any]]:
        """Does tasks, as many at once as there are slots; yields by key what they say, and at last how they ``Ended``.

        A task that is done again repeats its messages.

        Args:
            tasks: by key, each taken when it can begin.
            stopped: asked whether to begin no other task, and to ask those in progress to end. They still answer.
        """
        heard: queue.Queue[tuple[str, Any]] = queue.Queue()
        waiting, working = iter(tasks), set[str]()
        try:
            while True:
                while len(working) < self.slots and not stopped() and (begun := next(waiting, None)) is not None:
                    working.add(begun[0])
                    self._start(*begun, work, heard)
                if stopped():
                    self.stop()
                if not working:
                    return
                with suppress(queue.Empty):  # Windows' Ctrl-C waits for an endless get
                    key, message = heard.get(timeout=0.2)
                    if key in working:  # what it said last may come after its end: they take different ways
                        working -= {key} if isinstance(message, Ended) else set()
                        yield key, message
        finally:
            if working:
                self.stop()
            while working:
                key, message = heard.get()
                working -= {key} if isinstance(message, Ended) else set()

    def _start(self, key: str, task: Task, work: Work, heard: queue.Queue[tuple[str, Any]]) -> None:
        self._told[key] = lambda message: heard.put((key, message))
        do = partial(_do, work, dict(task), key, self._name)
        future = self._client.submit(do, key=f"{self._name}-{key}-{uuid.uuid4().hex}", pure=False)
        self._futures[key] = future
        future.add_done_callback(lambda future: heard.put((key, self._ended(key, future))))

    def stop(self) -> None:
        """Asks all tasks to end. They still answer."""
        if self._futures and not self._stopping:
            self._stopping = True
            self._stop.set()

    def _heard(self, event: tuple[float, Any]) -> None:
        _, (key, message) = event
        if key in self._told:
            self._told[key](message)

    def _ended(self, key: str, future: Future[Any]) -> Ended:
        self._futures.pop(key, None)
        self._told.pop(key, None)
        if future.status == "finished":
            return Ended(future.result())
        if future.status == "cancelled":
            return Ended(error="The scheduler dropped this task.")
        error = future.exception()
        return Ended(error=str(error) or type(error).__name__)


def _local_cluster(workers: int) -> LocalCluster:
    """Processes that answer each other alone: by a certificate of which no file exists."""
    import cryptography  # noqa: F401  # Dask needs it for a certificate, and names no package where it is missing
    from distributed import LocalCluster, Security

    cluster = LocalCluster(
        n_workers=workers,
        threads_per_worker=1,
        memory_limit=None,  # trainings bound their memory themselves; Dask would pause them at a share of the machine's
        preload=[f"{__package__}.local_processes"],
        protocol="tls://",
        security=Security.temporary(),
        host="127.0.0.1",
        dashboard_address=None,
        silence_logs=logging.CRITICAL,
    )
    loop, scheduler = cast(Any, cluster.loop), cast(Any, cluster.scheduler)
    loop.add_callback(scheduler.http_server.stop)  # the workers' own are stopped as they begin
    return cluster


def _check_reachable(scheduler: str) -> None:
    """Says what an open address means; FrogError for one where no scheduler answers: a client of Dask's
    tries on for a while, and prints tracebacks when it is dropped."""
    from distributed import Security
    from distributed.core import connect

    async def try_it() -> None:
        comm = await connect(scheduler, _CONNECT_SECONDS, **security)
        comm.abort()

    security, match = Security().get_connection_args("client"), _ADDRESS.fullmatch(scheduler)
    if match is None:
        raise UsageError(f"--scheduler {scheduler}: expected tls://HOST:PORT, tcp://HOST:PORT or {LOCAL}.")
    if match["scheme"] == "tls" and not security["ssl_context"]:
        raise FrogError(
            f"--scheduler {scheduler}: Dask's settings name no certificates, expected distributed.comm.tls."
        )
    try:
        socket.create_connection((match["host"].strip("[]"), int(match["port"])), _CONNECT_SECONDS).close()
        asyncio.run(try_it())
    except (OSError, OverflowError, ValueError) as error:  # ValueError: a name that no host can have
        raise _no_answer(scheduler, error) from error
    if match["scheme"] == "tcp":
        say(
            f"--scheduler {scheduler}: whoever reaches this address or a worker's can run code as you there, and read"
            " what is sent; tls:// keeps others out."
        )


def _no_answer(scheduler: str, error: Exception) -> FrogError:
    return FrogError(
        f"--scheduler {scheduler}: no Dask scheduler answered ({reason(error)}), expected an address such as"
        f" tls://10.0.0.5:8786, or {LOCAL}."
    )


def _do(work: Work, task: Task, key: str, name: str) -> Any:
    """What a worker does: the task, with its messages sent through the scheduler."""
    from distributed import Event, get_worker

    worker = get_worker()
    stop, asked, stopping = Event(name), -_ASKED_EVERY, False

    def say(message: Any) -> None:
        worker.log_event(name, (key, message))

    def cancelled() -> bool:
        nonlocal asked, stopping
        if not stopping and time.monotonic() - asked >= _ASKED_EVERY:
            stopping, asked = bool(stop.is_set()), time.monotonic()
        return stopping

    return work(task, say, cancelled)
