"""``frog train --takes``: every capture in a folder, one after the other or by the workers of a cluster."""

from __future__ import annotations

import argparse
import queue
import sys
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.capture.readers import detect
from ..engine.errors import FrogError, found_instead
from ..engine.training.session import events
from ..engine.training.session.output_paths import checkpoint_path, training_progress
from .cluster import opened_cluster
from .printing import complain, say
from .stopping import stopping
from .streams import printing_may_fail

if TYPE_CHECKING:
    from ..engine.distributed.cluster import Cluster
    from ..engine.training.session.job import TrainingJob

JobOf = Callable[[Path, Path], "TrainingJob"]
"""The training of a capture to a scene, with the settings of the command line."""


def takes_in(folder: Path, scenes: Path) -> list[Path]:
    """The captures that lie in a folder, by name; says which of its folders are none.

    Args:
        scenes: a folder that is not looked at.

    Raises:
        FrogError: there is none, or the folder cannot be read.
    """
    try:
        entries = sorted(entry for entry in folder.iterdir() if entry.is_dir() and not entry.name.startswith("."))
    except OSError as error:
        raise FrogError(f"{folder}: could not be read ({error.strerror or error}).") from error
    takes = []
    for entry in entries:
        if entry.resolve() == scenes.resolve():
            continue
        try:
            detect(entry)
            takes.append(entry)
        except FrogError as error:
            complain(f"left out: {error}")
    if not takes:
        raise found_instead(folder, "no capture in it", "a folder that has captures in it")
    return takes


def train_takes(options: argparse.Namespace, job_of: JobOf) -> int:
    """Trains what is not yet trained, each take to a scene of its name in ``options.out``; returns the exit status."""
    takes, folder = takes_in(options.capture, options.out), options.out
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise FrogError(f"{folder}: scenes cannot be written here ({error.strerror or error}).") from error
    outputs = {take.name: folder / f"{take.name}.frog" for take in takes}
    jobs = {take.name: job_of(take, outputs[take.name]) for take in takes}
    left = {name: _going_on(job) for name, job in jobs.items() if job.overwrite or not is_trained(job.output)}
    say(f"{len(takes)} takes, {len(takes) - len(left)} of them trained before")
    with printing_may_fail(), stopping() as asked:
        if options.scheduler and left:
            with opened_cluster(options.scheduler, min(options.jobs, len(left))) as cluster:
                finished = _on_cluster(cluster, left, asked)
        else:
            finished = [name for name, job in left.items() if _train(name, job, asked)]
        done = len(takes) - len(left) + len(finished)
        say(f"{folder}: {done} of {len(takes)} takes are trained")
        if done < len(takes):
            complain("run the same command again to go on with the others.")
    return 0 if done == len(takes) else 1


def is_trained(scene: Path) -> bool:
    """Whether a scene has been trained to its end."""
    trained = training_progress(scene)
    return scene.is_file() and (trained is None or trained[0] >= 1)


def _going_on(job: TrainingJob) -> TrainingJob:
    """The job, from its checkpoint if there is one."""
    return replace(job, resume=not job.overwrite and checkpoint_path(job.output).is_file())


def _train(name: str, job: TrainingJob, asked: Callable[[], bool]) -> bool:
    """Trains a take in this process; False when it was stopped, or failed."""
    from ..engine.training.session.run import run_training
    from ..engine.training.session.time_estimate import remembering
    from .progress import show

    if asked():
        return False
    try:
        return show(remembering(run_training(job, asked), job), job.output, f"{name}: ")
    except FrogError as error:  # the others can be trained nevertheless
        complain(f"{name}: {error}")
        return False


def _on_cluster(cluster: Cluster, jobs: Mapping[str, TrainingJob], asked: Callable[[], bool]) -> list[str]:
    """Gives takes to the workers of a cluster and follows them in one line; the names of those that finished."""
    from tqdm import tqdm

    heard, threads = queue.Queue[tuple[str, Any]](), cluster.threads()
    for name, job in jobs.items():
        cluster.start(name, train_take, task_of(job, threads), partial(_put, heard, name), partial(_put, heard, name))
    shares, ended = dict.fromkeys(jobs, 0.0), dict[str, Any]()
    layout = "{desc} |{bar}| {n:.2f}/{total} takes"
    with tqdm(desc="Training", total=len(jobs), file=sys.stderr, bar_format=layout) as line:
        while len(ended) < len(jobs):
            if asked():
                cluster.stop()
            with suppress(queue.Empty):  # Windows' Ctrl-C waits for an endless get
                name, message = heard.get(timeout=0.5)
                if isinstance(message, float):
                    shares[name] = message
                else:
                    ended[name] = message
                    shares[name] = 1.0 if message.answer else shares[name]
                    if message.error is not None:
                        line.clear()
                        complain(f"{name}: {message.error}")
                line.n = sum(shares.values())
                line.refresh()
    return [name for name, end in ended.items() if end.answer]


def _put(heard: queue.Queue[tuple[str, Any]], name: str, message: Any) -> None:
    heard.put((name, message))


def task_of(job: TrainingJob, threads: int) -> dict[str, Any]:
    """A training as JSON values, for ``train_take``. Its paths are absolute: it may be done from another folder."""
    told = {"device": job.device, "save_every": job.save_every, "overwrite": job.overwrite}
    return {"settings": job.stored_settings(), "output": str(job.output.resolve()), "threads": threads, **told}


def train_take(task: Mapping[str, Any], tell: Callable[[float], None], cancelled: Callable[[], bool]) -> bool:
    """Trains a take as a task of a cluster; tells the share that is done. A task that is done again goes on from the
    last checkpoint.

    Args:
        task: what ``task_of`` made.

    Returns:
        Whether it finished.
    """
    from ..engine.training.session.job import TrainingJob
    from ..engine.training.session.run import run_training
    from .cluster import limited_threads

    output = Path(task["output"])
    fields = {"device": task["device"], "save_every": task["save_every"], "overwrite": task["overwrite"]}
    job = replace(TrainingJob.of_settings(task["settings"], output), **fields)
    with limited_threads(task["threads"]):
        for event in run_training(_going_on(job), cancelled):
            if isinstance(event, events.Progress):
                tell(event.step / max(event.steps, 1))
            elif isinstance(event, events.Finished):
                return True
    return False
