"""Trainings on the workers of a cluster, followed in one line."""

from __future__ import annotations

import queue
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any

from ..engine.training.session import events
from .printing import complain

if TYPE_CHECKING:
    from ..engine.distributed.cluster import Cluster, Ended, Task, Work


def train_on_cluster(
    cluster: Cluster, tasks: Mapping[str, Task], work: Work, asked: Callable[[], bool], unit: str
) -> dict[str, Ended]:
    """Gives trainings to workers and waits for them; says at once which of them failed.

    Args:
        tasks: what ``work`` needs, by what people call the training.
        work: tells the share that is done, and answers whether it finished.
        asked: whether all are to stop.
        unit: what the trainings are, in the plural.

    Returns:
        How each ended.
    """
    from tqdm import tqdm

    heard = queue.Queue[tuple[str, Any]]()
    for label, task in tasks.items():
        cluster.start(label, work, task, partial(_put, heard, label), partial(_put, heard, label))
    shares, ended = dict.fromkeys(tasks, 0.0), dict[str, Any]()
    layout = "{desc} |{bar}| {n:.2f}/{total} " + unit
    with tqdm(desc="Training", total=len(tasks), file=sys.stderr, bar_format=layout) as line:
        while len(ended) < len(tasks):
            if asked():
                cluster.stop()
            with suppress(queue.Empty):  # Windows' Ctrl-C waits for an endless get
                label, message = heard.get(timeout=0.5)
                if isinstance(message, float):
                    shares[label] = message
                else:
                    ended[label] = message
                    shares[label] = 1.0 if message.answer else shares[label]
                    if message.error is not None:
                        line.clear()
                        complain(f"{label}: {message.error}")
                line.n = sum(shares.values())
                line.refresh()
    return ended


def _put(heard: queue.Queue[tuple[str, Any]], label: str, message: Any) -> None:
    heard.put((label, message))


def tell_shares(stream: Iterator[events.Event], tell: Callable[[float], None]) -> bool:
    """Follows a training on a worker; True when it finished, False when it was cancelled."""
    for event in stream:
        if isinstance(event, events.Progress):
            tell(event.step / max(event.steps, 1))
        elif isinstance(event, events.Finished):
            return True
    return False
