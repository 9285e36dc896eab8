"""The processes of a training that ``torchrun`` started, on one machine or several.

What they tell each other goes through ``torch.distributed``: by gloo what lies on the CPU, by NCCL what lies on a GPU.
A process that is killed closes its connections, which ends what the others wait for. One that hangs, or whose machine
is cut off, is noticed by its heartbeat.
"""

from __future__ import annotations

from ..training import passive_threads  # noqa: F401

# isort: split
import os
import threading
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from datetime import timedelta
from typing import Any, TypeVar

import torch

from ..errors import FrogError
from ..native import binding
from ..training.optimize.peers import Alone, PeerLost, Peers

_BEAT_SECONDS, _SILENT_SECONDS = 1.0, 25.0  # a busy machine may keep a thread waiting for long
_STOPPED_SECONDS = 10.0  # without a beat of its own: the process was stopped, or its machine slept
_ASKED_SECONDS = 1.0  # between two looks at the heartbeats, of who waits
_STEP_SECONDS = 25  # that a GPU waits for the others in a step, which all have begun
_JOIN_SECONDS = 300  # from the first process to the last
_LONGEST_SECONDS = 7 * 86_400  # that a process may decode, or write, while the others wait

Result = TypeVar("Result")


@contextmanager
def joined(environment: Mapping[str, str] = os.environ) -> Iterator[Peers]:
    """Yields the processes that share a training, as torchrun's variables say; this one alone without them.

    Processes of one machine share its cores and its GPUs.

    Raises:
        FrogError: if the others do not come.
    """
    if int(environment.get("WORLD_SIZE", "1")) < 2 or "RANK" not in environment:
        yield Alone()
        return
    import torch.distributed as dist

    os.environ.setdefault("TORCH_NCCL_BLOCKING_WAIT", "1")  # an error that can be caught, where one is lost
    local, here = int(environment.get("LOCAL_RANK", "0")), int(environment.get("LOCAL_WORLD_SIZE", "1"))
    backend = "gloo"
    if torch.cuda.is_available():
        torch.cuda.set_device(local % torch.cuda.device_count())
        # NCCL takes one process a GPU.
        backend = "cpu:gloo,cuda:nccl" if here <= torch.cuda.device_count() else "gloo"
    try:
        dist.init_process_group(backend, timeout=timedelta(seconds=_JOIN_SECONDS))
    except (RuntimeError, ValueError) as error:
        raise FrogError(f"The processes of this training did not find each other ({_first_line(error)}).") from error
    rank, size = dist.get_rank(), dist.get_world_size()
    beats = Heartbeats(rank, size, _store_of(environment))
    binding.set_thread_count(max(1, (os.cpu_count() or 1) // here))
    try:
        yield ProcessGroup(rank, size, local == 0, beats)
        dist.destroy_process_group()
    finally:
        beats.stop()
        binding.set_thread_count(0)


def _store_of(environment: Mapping[str, str]) -> Callable[[], Any]:
    """Makes a connection of its own to the processes' store; ``Any`` because torch does not type it."""
    import torch.distributed as dist

    address, port = environment["MASTER_ADDR"], int(environment["MASTER_PORT"])
    attempt = environment.get("TORCHELASTIC_RESTART_COUNT", "0")

    def connect() -> Any:
        store = dist.TCPStore(address, port, is_master=False, timeout=timedelta(seconds=_SILENT_SECONDS))
        return dist.PrefixStore(f"frog-heartbeats-{attempt}", store)

    return connect


class Heartbeats:
    """Says that this process lives, and which of the others does not, in a thread of its own.

    Args:
        connect: makes the connection to the store.

    Attributes:
        lost: a sentence; "" while all live.
    """

    def __init__(self, rank: int, size: int, connect: Callable[[], Any]) -> None:
        self._rank, self._size, self._connect = rank, size, connect
        self.lost = ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._beat, name="frog: heartbeats", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """No more heartbeats."""
        self._stop.set()
        self._thread.join(_BEAT_SECONDS)

    def _beat(self) -> None:
        others = [rank for rank in range(self._size) if rank != self._rank]
        try:
            store = self._connect()
            counts, last, woke = dict.fromkeys(others, 0), dict.fromkeys(others, time.monotonic()), time.monotonic()
            while not self._stop.wait(_BEAT_SECONDS):
                store.add(str(self._rank), 1)
                now = time.monotonic()
                slept, woke = now - woke > _STOPPED_SECONDS, now
                for rank in others:
                    count = store.add(str(rank), 0)
                    if count != counts[rank] or slept:
                        counts[rank], last[rank] = count, now
                    elif now - last[rank] > _SILENT_SECONDS:
                        self.lost = f"Process {rank} of this training does not answer."
                        return
        except RuntimeError as error:  # of torch's store
            if not self._stop.is_set():
                self.lost = f"Process {self._rank} of this training has lost the others ({_first_line(error)})."


class ProcessGroup:
    """See ``Peers``.

    Args:
        rank, size: of this process, and of all.
        is_first_here: see ``Peers``.
        beats: of the others.
    """

    def __init__(self, rank: int, size: int, is_first_here: bool, beats: Heartbeats) -> None:
        self.rank, self.size, self.is_first_here, self._beats = rank, size, is_first_here, beats

    def add_up(self, values: torch.Tensor) -> None:
        """See Peers."""
        import torch.distributed as dist

        self._done(lambda: dist.all_reduce(values, dist.ReduceOp.SUM, async_op=True), values.device)

    def take_largest(self, values: torch.Tensor) -> None:
        """See Peers."""
        import torch.distributed as dist

        self._done(lambda: dist.all_reduce(values, dist.ReduceOp.MAX, async_op=True), values.device)

    def gather(self, row: list[int]) -> list[list[int]]:
        """See Peers."""
        own = torch.tensor(row, dtype=torch.int64, device="cpu")
        rows: list[list[int]] = self._gathered(own).tolist()
        return rows

    def first_of(self, value: float) -> float:
        """See Peers."""
        own = torch.tensor([value], dtype=torch.float64, device="cpu")
        return float(self._gathered(own)[0, 0])

    def from_first(self, content: bytes) -> bytes:
        """See Peers."""
        import torch.distributed as dist

        size = self.gather([len(content)])[0][0]
        values = torch.empty(size, dtype=torch.uint8, device="cpu")
        if self.rank == 0:
            values = torch.frombuffer(bytearray(content), dtype=torch.uint8)
        self._done(lambda: dist.broadcast(values, 0, async_op=True), values.device)
        return values.numpy().tobytes()

    def _gathered(self, own: torch.Tensor) -> torch.Tensor:
        """(size, n) of (n,) on the CPU."""
        import torch.distributed as dist

        rows = own.new_zeros(self.size, len(own))
        self._done(lambda: dist.all_gather(list(rows.unbind()), own, async_op=True), own.device)
        return rows

    def _done(self, begin: Callable[[], Any], device: torch.device) -> None:
        """Waits for an operation. ``Any`` because torch's kinds of work have no common type that it names."""
        try:
            work = begin()
            if device.type == "cuda":
                work.wait(timedelta(seconds=_STEP_SECONDS))
                return
            while not self._waited(work):
                if self._beats.lost:
                    raise PeerLost(self._beats.lost)
        except RuntimeError as error:
            raise PeerLost(f"Another process of this training has ended ({_first_line(error)}).") from error

    def _waited(self, work: Any) -> bool:
        """Waits for a second at most; whether the work is done. What it failed by is raised."""
        try:
            work.wait(timedelta(seconds=_ASKED_SECONDS))
        except RuntimeError:
            if work.is_completed():
                raise
            return False
        return True


def _first_line(error: Exception) -> str:
    return (str(error).strip() or type(error).__name__).splitlines()[0].rstrip(".")
