"""``frog train --segments``: a long take in segments, one after the other or by the workers of a cluster."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.errors import FrogError
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
    """Gives segments to the workers of a cluster; False when they were stopped, FrogError when one failed."""
    from .cluster_trainings import train_on_cluster

    job = stages.plan.job
    task: dict[str, Any] = {"folder": str(stages.plan.folder.resolve()), "capture": str(Path(job.capture).resolve())}
    task |= {"device": job.device, "save_seconds": job.save_seconds, "threads": cluster.threads()}
    tasks = {stages.label(number): {**task, "segment": number} for number in left}
    ended = train_on_cluster(cluster, tasks, train_part, asked, "segments")
    if any(each.error is not None for each in ended.values()):
        raise FrogError(f"{job.output}: not all segments were trained; run the same command again to go on.")
    return all(each.answer for each in ended.values())


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
    from ..experiments.machine import limited_threads
    from .cluster_trainings import tell_shares

    changes = {"device": task["device"], "save_seconds": task["save_seconds"], "capture": Path(task["capture"])}
    stages, number = Stages(SegmentPlan.open(Path(task["folder"]), **changes)), int(task["segment"])
    if stages.is_done(number):
        return True
    with limited_threads(task["threads"]):
        return tell_shares(stages.train(number, cancelled), tell)
