"""A cluster for a command: connected, with the address of its page printed."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from contextlib import contextmanager

from ..engine.distributed.cluster import LOCAL, Cluster


def add_scheduler_argument(command: argparse.ArgumentParser) -> None:
    """Adds ``--scheduler``; the command has a ``--jobs`` of its own."""
    command.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help=f"give the work to the workers of a Dask cluster, such as tcp://10.0.0.5:8786; {LOCAL}: to --jobs"
        " workers of this machine",
    )


@contextmanager
def opened_cluster(scheduler: str, workers: int) -> Iterator[Cluster]:
    """Yields the cluster; its tasks are asked to end, and a local one ends, with the block.

    Args:
        scheduler: the address of a Dask scheduler, or "local".
        workers: processes of a local cluster.

    Raises:
        FrogError: if no scheduler answers.
    """
    with Cluster(scheduler, workers) as cluster:
        print(f"Dask: {cluster.slots} at once; {cluster.dashboard}", file=sys.stderr, flush=True)
        yield cluster


@contextmanager
def limited_threads(count: int) -> Iterator[None]:
    """At most ``count`` threads each for the native library, torch and OpenCV inside the block; 0 changes nothing."""
    if not count:
        yield
        return
    import cv2
    import torch

    from ..engine.native import binding

    before, torch_before = cv2.getNumThreads(), torch.get_num_threads()
    cv2.setNumThreads(count)
    torch.set_num_threads(count)
    binding.set_thread_count(count)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
        torch.set_num_threads(torch_before)
        binding.set_thread_count(0)
