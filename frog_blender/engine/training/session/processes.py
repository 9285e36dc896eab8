"""The processes of one training, as ``torchrun`` starts them, connected by ``torch.distributed``.

NCCL carries what lies on GPUs, gloo the rest. A process that was killed closes its connections, which the others see at
once; one that hangs, or that a network has lost, is missed by its heartbeat.
"""

from .. import passive_threads  # noqa: F401

# isort: split
import os
import re
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import timedelta

import torch
from torch import distributed

from ...errors import FrogError, reason
from ...native.binding import set_thread_count
from ..optimize.view_pass import PeerLost, Peers
from .torchrun import number

_BEAT = 2.0  # seconds between two heartbeats
_LOST_AFTER = 20.0  # seconds without one, after which a process counts as lost
_CONNECTED_WITHIN = timedelta(minutes=5)  # torchrun may start a computer's processes minutes after another's
_LONGEST = timedelta(days=7)  # of a wait for the others, who may be saving or decoding as long as their hearts beat
_POLLED = 2e-4  # seconds
_LOOPBACKS = {"linux": "lo", "darwin": "lo0"}


class Processes(Peers):
    """See ``Peers``.

    Args:
        store: in which hearts beat; every process has a connection of its own to it.
        rank, size: of this process, and how many there are.
        decodes_first: see ``Peers``.
    """

    def __init__(self, store: distributed.Store, rank: int, size: int, *, decodes_first: bool) -> None:
        self.rank, self.size, self.decodes_first = rank, size, decodes_first
        self.is_broken = False
        self._store, self._ended = store, threading.Event()
        self._launcher = os.getppid() if "TORCHELASTIC_RUN_ID" in os.environ else None  # of torchrun alone
        self._is_left = False
        self._heard = {other: time.monotonic() for other in range(size) if other != rank}
        self._heart = threading.Thread(target=self._beats, name="frog heartbeat", daemon=True)
        self._heart.start()

    def add(self, tensor: torch.Tensor) -> None:
        """See Peers."""
        self._reduce(tensor, distributed.ReduceOp.SUM)

    def maximum(self, tensor: torch.Tensor) -> None:
        """See Peers."""
        self._reduce(tensor, distributed.ReduceOp.MAX)

    def leave(self) -> None:
        """Ends the heartbeat, and the connections unless one is broken: then a wait for it would not end."""
        self._ended.set()
        self._heart.join(2 * _BEAT)
        if not self.is_broken:
            with suppress(RuntimeError):  # others have left already
                distributed.destroy_process_group()

    def _reduce(self, tensor: torch.Tensor, operation: distributed.ReduceOp.RedOpType) -> None:
        try:
            if self._is_left:
                raise PeerLost("What has started the processes of this training has ended, or cannot be reached.")
            work = distributed.all_reduce(tensor, operation, async_op=True)
            self._wait(work)
        except PeerLost:
            self.is_broken = True
            raise
        except RuntimeError as error:
            self.is_broken = True
            raise PeerLost(f"Another process of this training has ended ({_first_line(error)}).") from error

    def _wait(self, work: distributed.Work) -> None:
        """Until ``work`` is done; PeerLost when a heart has not beaten for _LOST_AFTER meanwhile."""
        began = time.monotonic()
        while not work.is_completed():
            time.sleep(_POLLED)
            now = time.monotonic()
            for other, heard in self._heard.items():
                if now - max(began, heard) > _LOST_AFTER:
                    raise PeerLost(
                        f"Process {other} of {self.size} of this training has not answered for {_LOST_AFTER:.0f} s."
                    )
        work.wait()  # raises what it has failed by

    def _beats(self) -> None:
        """Says that this process lives and hears who else does, in a thread: the store waits for a host that is cut
        off."""
        count, last = 0, dict.fromkeys(self._heard, b"")
        while not self._ended.wait(_BEAT):
            count += 1
            try:
                self._store.set(f"beat {self.rank}", str(count))
                for other in self._heard:
                    key = f"beat {other}"
                    beat = bytes(self._store.get(key)) if self._store.check([key]) else b""
                    if beat != last[other]:
                        last[other], self._heard[other] = beat, time.monotonic()
            except RuntimeError:  # torchrun, or the process that hosts the store, is lost
                self._is_left = True
            if self._launcher is not None and os.getppid() != self._launcher:
                self._is_left = True


@contextmanager
def joined(device: str) -> Iterator[Processes]:
    """The processes that ``torchrun`` has started, connected inside the block.

    Each has its share of the computer's cores, and a GPU of its own unless ``device`` is "cpu".

    Raises:
        FrogError: they cannot be connected.
    """
    here, together = number("LOCAL_RANK", 0), number("LOCAL_WORLD_SIZE", 1)
    on_gpu = device != "cpu" and torch.cuda.is_available() and distributed.is_nccl_available()
    if on_gpu and torch.cuda.device_count() < together:
        raise FrogError(
            f"{together} processes have {torch.cuda.device_count()} GPUs here, expected one each: "
            "give torchrun fewer processes, or train with --device cpu."
        )
    if on_gpu:
        torch.cuda.set_device(here)
    set_thread_count(max(1, (os.cpu_count() or 1) // max(1, together)))
    if together == number("WORLD_SIZE", 1) and (loopback := _LOOPBACKS.get(sys.platform)):
        for backend in ("GLOO", "NCCL"):  # which would listen on the address of the computer's name
            os.environ.setdefault(f"{backend}_SOCKET_IFNAME", loopback)
    try:
        store, own, size = next(distributed.rendezvous("env://", timeout=_CONNECTED_WITHIN))
        distributed.init_process_group(
            "cpu:gloo,cuda:nccl" if on_gpu else "gloo",
            store=distributed.PrefixStore("group", store),
            rank=own,
            world_size=size,
            timeout=_LONGEST,
        )
        host, port = os.environ["MASTER_ADDR"], number("MASTER_PORT", 29500)
        hearts = distributed.TCPStore(host, port, is_master=False, timeout=timedelta(seconds=10))
        prefix = f"frog {number('TORCHELASTIC_RESTART_COUNT', 0)}"
        processes = Processes(distributed.PrefixStore(prefix, hearts), own, size, decodes_first=here == 0)
    except (RuntimeError, ValueError, KeyError, OSError) as error:
        raise FrogError(f"The processes of this training cannot be connected ({reason(error)}).") from error
    try:
        yield processes
    except BaseException:
        processes.is_broken = True  # the others may be in the middle of a step
        raise
    finally:
        processes.leave()
        set_thread_count(0)


def _first_line(error: Exception) -> str:
    """What gloo or NCCL said, without the place in its source."""
    first = (str(error).strip().splitlines() or [type(error).__name__])[0]
    return re.sub(r"^\[[^\]]*\]\s*", "", first).split(". ")[0].rstrip(".")[:200]
