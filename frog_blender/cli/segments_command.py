"""``frog train --segments``: a long take in segments, one after the other or by the workers of a cluster."""

from __future__ import annotations

import argparse
import queue
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.errors import FrogError
from ..engine.training.session.torchrun import started_by_torchrun
from .cluster import opened_cluster
from .printing import complain, say
from .stopping import stopping
from .streams import printing_may_fail

if TYPE_CHECKING:
    from ..engine.distributed.cluster import Cluster
    from ..engine.training.segments.stages import Stages
    from ..engine.training.session.job import TrainingJob


def train_segments(options: argparse.Namespace, job: TrainingJob) -> int:
    """Trains what is not yet trained, and joins it; returns the exit status."""
    if options.events or started_by_torchrun():
        found = "--events" if options.events else "torchrun"
        raise FrogError(f"--segments: found {found}, which one training is for: expected neither that nor torchrun.")
    if options.jobs > 1 and not options.scheduler:
        raise FrogError(f"--jobs {options.jobs}: expected --scheduler local with it, whose workers they are.")
    with printing_may_fail(), stopping() as asked:
        from ..engine.training.segments.plan import SegmentPlan
        from ..engine.training.segments.stages import BASE, Stages

        stages = Stages(SegmentPlan.begin(job, options.segments))
        say(f"{len(stages.cuts)} segments; they are kept in {stages.plan.folder}")
        if not _train(stages, BASE, asked):
            return _stopped()
        say(f"{stages.choose_shared()} Gaussians are shared")
        left = [number for number in range(len(stages.cuts)) if not stages.is_done(number)]
        if options.scheduler and left:
            with opened_cluster(options.scheduler, min(options.jobs, len(left))) as cluster:
                finished = _on_cluster(cluster, stages, left, asked)
        else:
            finished = all(_train(stages, number, asked) for number in left)
        if not finished:
            return _stopped()
        header = stages.join()
        psnr = header.metrics.get("psnr")
        quality = "PSNR not measured" if psnr is None else f"PSNR {psnr:.2f} dB"
        did = f"{len(stages.cuts)} segments, {header.steps} steps in {header.train_seconds:.0f} s"
        say(f"{job.output}: {did}, {quality}")
    return 0


def _stopped() -> int:
    complain("stopped; run the same command again to continue.")
    return 1


def _train(stages: Stages, number: int, asked: Callable[[], bool]) -> bool:
    """Trains a segment, or the whole take, in this process; False when it was stopped."""
    from ..engine.training.session.time_estimate import remembering
    from .progress import show

    if stages.is_done(number):
        return True
    if asked():
        return False
    label = f"{stages.label(number)}: "
    return show(remembering(stages.train(number, asked), stages.job_of(number)), stages.scene_path(number), label)


def _on_cluster(cluster: Cluster, stages: Stages, left: list[int], asked: Callable[[], bool]) -> bool:
    """Gives segments to the workers of a cluster; False when they were stopped, FrogError when one fails."""
    from tqdm import tqdm

    job, heard = stages.plan.job, queue.Queue[tuple[int, Any]]()
    task: dict[str, Any] = {"folder": str(stages.plan.folder.resolve()), "capture": str(Path(job.capture).resolve())}
    task |= {"device": job.device, "save_seconds": job.save_seconds, "threads": cluster.threads()}
    for number in left:
        told, ended = partial(_put, heard, number), partial(_put, heard, number)
        cluster.start(str(number), train_part, {**task, "segment": number}, told, ended)
    shares, finished = dict.fromkeys(left, 0.0), True
    layout = "{desc} |{bar}| {n:.2f}/{total} segments"
    with tqdm(desc="Segments", total=len(left), file=sys.stderr, bar_format=layout) as line:
        waiting = set(left)
        while waiting:
            if asked():
                cluster.stop()
            with suppress(queue.Empty):  # Windows' Ctrl-C waits for an endless get
                number, message = heard.get(timeout=0.5)
                if isinstance(message, float):
                    shares[number] = message
                elif message.error is not None:
                    raise FrogError(f"{stages.label(number)}: {message.error}")
                else:
                    waiting.discard(number)
                    finished = finished and bool(message.answer)
                    shares[number] = 1.0 if message.answer else shares[number]
                line.n = sum(shares.values())
                line.refresh()
    return finished


def _put(heard: queue.Queue[tuple[int, Any]], number: int, message: Any) -> None:
    heard.put((number, message))


def train_part(task: Mapping[str, Any], tell: Callable[[float], None], cancelled: Callable[[], bool]) -> bool:
    """Trains a segment as a task of a cluster; tells the share that is done. A task that is done again goes on from the
    last checkpoint.

    Args:
        task: the plan's folder, the segment's number, and the device, seconds between checkpoints and threads to use.

    Returns:
        Whether it finished.
    """
    from ..engine.training.segments.plan import SegmentPlan
    from ..engine.training.segments.stages import Stages
    from ..engine.training.session import events
    from ..experiments.machine import limited_threads

    changes = {"device": task["device"], "save_seconds": task["save_seconds"], "capture": Path(task["capture"])}
    stages, number = Stages(SegmentPlan.open(Path(task["folder"]), **changes)), int(task["segment"])
    if stages.is_done(number):
        return True
    with limited_threads(task["threads"]):
        for event in stages.train(number, cancelled):
            if isinstance(event, events.Progress):
                tell(event.step / max(event.steps, 1))
            elif isinstance(event, events.Finished):
                return True
    return False
