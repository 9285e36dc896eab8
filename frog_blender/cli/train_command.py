"""``frog train``: a scene from a capture, or from every capture in a folder; alone, or with other processes."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.capture.readers import detect
from ..engine.errors import CaptureRefused, FrogError, UsageError
from ..engine.given_options import given_file, given_texts, joined, training_options
from ..engine.options import OPTIONS, TrainingOptions
from ..engine.recipes import RECIPES, Recipe, recipe
from ..engine.setting import meanings_of, text_of
from ..engine.training.session import events
from ..engine.training.session.output_paths import check_unused, checkpoint_path, training_progress
from . import CANCELLED, DONE, FAILED
from .arguments import Reads, add_options, add_scheduler_argument, given_of, limited_threads, opened_cluster
from .terminal import add_json_argument, complain, printing_may_fail, say, stopping

if TYPE_CHECKING:
    from ..engine.distributed.cluster import Cluster
    from ..engine.training.session.job import TrainingJob

JobOf = Callable[[Path, Path], "TrainingJob"]
"""The training of a capture to a scene, with the settings of the command line."""

_INSTEAD = "--overwrite replaces it, --resume goes on with its training, and another name keeps both"


def add_train_parser(commands: Any) -> None:
    """Adds the command."""
    train = commands.add_parser("train", help="train a scene from a capture")
    train.add_argument("capture", type=Path, action=Reads)
    train.add_argument("--out", type=Path, required=True, metavar="X.frog")
    apart = ("overwrite", "resume", "settings")
    add_options(train, *(name for name in OPTIONS if name not in apart))
    add_options(train.add_mutually_exclusive_group(), "overwrite", "resume")
    train.add_argument(
        OPTIONS["settings"].flag,
        action="append",
        default=[],
        dest="texts",
        metavar=OPTIONS["settings"].placeholder,
        help="any option by its name, or a setting of the recipe (frog recipes lists them)",
    )
    train.add_argument(
        "--config", type=Path, metavar="FILE.toml", help="the same from a file; options and --set override it"
    )
    train.add_argument("--sink", action="append", default=[], metavar="NAME", help="tell a package's sink every event")
    lines = train.add_mutually_exclusive_group()
    add_json_argument(lines)
    lines.add_argument(
        "--events",
        action="store_true",
        help="print events as lines of JSON",
    )
    train.add_argument(
        "--takes",
        action="store_true",
        help="train every capture in the folder CAPTURE, each to a scene of its name in the folder --out; what is"
        " trained stays, what was begun goes on",
    )
    add_scheduler_argument(train, "workers of --scheduler local, which share the cores")
    train.set_defaults(run=_train)


def add_recipes_parser(commands: Any) -> None:
    """Adds the command that lists what ``--set`` takes."""
    recipes = commands.add_parser("recipes", help="list the settings of a recipe")
    recipes.add_argument("name", nargs="?", choices=RECIPES, default=OPTIONS["recipe"].default)
    recipes.set_defaults(run=_recipes)


def _recipes(arguments: argparse.Namespace) -> int:
    chosen = recipe(arguments.name)
    for name, meaning in meanings_of(Recipe).items():
        if meaning.group:
            print()
            say(meaning.group)
        say(f"  {name} = {text_of(getattr(chosen, name))}: {meaning.help} ({meaning.kind.expected})")
    return 0


def _options_of(arguments: argparse.Namespace) -> tuple[TrainingOptions, dict[str, str]]:
    """The options of a training, and what the user calls those that were given."""
    by_flag, by_text = given_of(arguments), given_texts(arguments.texts)
    by_file = given_file(arguments.config) if arguments.config else {}
    names = {name: f"{name} in {arguments.config}" for name in _names(by_file)}
    names |= {name: f"--set {name}" for name in _names(by_text)}
    names |= {name: OPTIONS[name].flag for name in by_flag}
    return training_options(joined(by_file, by_text, by_flag)), names


def _names(given: Mapping[str, Any]) -> list[str]:
    """Of options and of settings of the recipe."""
    return [name for name in (*given, *given.get("settings", ())) if name != "settings"]


def _train(arguments: argparse.Namespace) -> int:
    from ..engine.training.session.job import TrainingJob

    options, names = _options_of(arguments)

    def job_of(capture: Path, output: Path) -> TrainingJob:
        return TrainingJob.of_options(capture, output, options, chosen=names, sinks=tuple(arguments.sink))

    if arguments.takes:
        if arguments.events or arguments.as_json:
            raise UsageError("--takes: found --events or --json, which one training is for.")
        return _train_takes(arguments, job_of)
    if not (options.overwrite or options.resume):
        check_unused(arguments.out, _INSTEAD)  # before torch is loaded
    if arguments.scheduler:
        raise UsageError("--scheduler gives takes to workers: expected --takes with it.")
    job = job_of(arguments.capture, arguments.out)
    with printing_may_fail(), stopping() as asked:  # what was learned is saved
        from .progress import show, tell

        if arguments.events:
            finished = tell(_stream_of(job, asked))
        else:
            finished = show(_noted(_stream_of(job, asked), arguments.figures), job.output)
    return DONE if finished else CANCELLED


def _noted(stream: Iterator[events.Event], figures: dict[str, Any]) -> Iterator[events.Event]:
    """The same, with what ``--json`` says of the training."""
    for event in stream:
        match event:
            case events.Evaluated(split=split):
                figures["split"] = split
            case events.Cancelled(step, path):
                figures |= {"scene": path, "is_finished": False, "steps": step}
            case events.Finished(path, steps, seconds, psnr, gaussians, capacity, phases):
                figures |= {"scene": path, "is_finished": True, "steps": steps, "training_seconds": seconds}
                figures |= {"gaussians": gaussians, "bytes": Path(path).stat().st_size, "psnr_db": psnr}
                figures |= {"reductions": capacity.get("reductions", []), "seconds_by_phase": phases}
        yield event


def _stream_of(job: TrainingJob, asked: Callable[[], bool]) -> Iterator[events.Event]:
    """Trains, and remembers how long it took."""
    from ..engine.training.session.run import run_training
    from ..engine.training.session.time_estimate import remembering

    return remembering(run_training(job, asked), job)


def takes_in(folder: Path, scenes: Path) -> list[Path]:
    """The captures that lie in a folder, by name; says which of its folders are none.

    Args:
        scenes: a folder that is not looked at.

    Raises:
        FrogError: there is none.
    """
    takes = []
    for entry in sorted(folder.iterdir()):
        if not entry.is_dir() or entry.name.startswith(".") or entry.resolve() == scenes.resolve():
            continue
        try:
            detect(entry)
            takes.append(entry)
        except FrogError as error:
            complain(f"left out: {error}")
    if not takes:
        raise CaptureRefused(f"{folder}: found no capture in it, expected a folder that has captures in it.")
    return takes


def _train_takes(options: argparse.Namespace, job_of: JobOf) -> int:
    """Trains what is not yet trained, each take to a scene of its name in ``options.out``; returns the exit status."""
    takes, folder = takes_in(options.capture, options.out), options.out
    folder.mkdir(parents=True, exist_ok=True)
    jobs = {take.name: job_of(take, folder / f"{take.name}.frog") for take in takes}
    fitting = {name: job for name, job in jobs.items() if job.overwrite or _fits(name, job)}
    left = {name: job for name, job in fitting.items() if job.overwrite or not is_trained(job.output)}
    before = len(fitting) - len(left)
    say(f"{len(takes)} takes, {before} of them trained before")
    with printing_may_fail(), stopping() as asked:
        if options.scheduler and left:
            with opened_cluster(options.scheduler, min(options.jobs, len(left))) as cluster:
                finished = _on_cluster(cluster, left, asked)
        else:
            finished = [name for name, job in left.items() if _train_take(name, job, asked)]
        done = before + len(finished)
        say(f"{folder}: {done} of {len(takes)} takes are trained")
        if len(finished) < len(left):
            complain("run the same command again to go on with the others.")
        status = CANCELLED if asked() else FAILED
    return DONE if done == len(takes) else status


def _fits(name: str, job: TrainingJob) -> bool:
    """Whether what lies at a take's output is made of it and as it is asked for; tells where it is not."""
    from ..engine.training.session.checkpoint import check_fits
    from ..engine.training.session.run import prepare_capture

    try:
        if job.output.is_file() or checkpoint_path(job.output).is_file():
            check_fits(job, prepare_capture(job)[0])
    except FrogError as error:
        complain(f"{name}: {error}")
        return False
    return True


def is_trained(scene: Path) -> bool:
    """Whether a scene has been trained to its end."""
    trained = training_progress(scene)
    return scene.is_file() and (trained is None or trained[0] >= 1)


def _train_take(name: str, job: TrainingJob, asked: Callable[[], bool]) -> bool:
    """Trains a take in this process; False when it was stopped, or failed."""
    from .progress import show

    if asked():
        return False
    try:
        return show(_stream_of(_going_on(job), asked), job.output, f"{name}: ")
    except FrogError as error:  # the others can be trained nevertheless
        complain(f"{name}: {error}")
        return False


def _on_cluster(cluster: Cluster, jobs: Mapping[str, TrainingJob], asked: Callable[[], bool]) -> list[str]:
    """Gives takes to the workers of a cluster and follows them in one line; the names of those that finished."""
    from ..engine.distributed.cluster import Ended
    from .progress import Line

    tasks = []
    for name, job in jobs.items():
        anywhere = replace(job, capture=job.capture.resolve(), output=job.output.resolve())
        tasks.append((name, {"job": anywhere, "threads": cluster.threads()}))
    shares, finished = dict.fromkeys(jobs, 0.0), []
    layout = "{desc} |{bar}| {n:.2f}/{total} takes"
    with Line(desc="Training", total=len(jobs), bar_format=layout) as line:
        for name, message in cluster.messages(do_take, tasks, asked):
            if not isinstance(message, Ended):
                shares[name] = message
            elif message.answer:
                shares[name] = 1.0
                finished.append(name)
            elif message.error is not None:
                line.clear()
                complain(f"{name}: {message.error}")
            line.n = sum(shares.values())
            line.refresh()
    return finished


def do_take(task: Mapping[str, Any], tell: Callable[[float], None], cancelled: Callable[[], bool]) -> bool:
    """Trains a take as a task of a cluster; tells the share that is done. One that is done again goes on from the last
    checkpoint.

    Returns:
        Whether it finished.
    """
    from ..engine.training.session.run import run_training

    with limited_threads(task["threads"]):
        for event in run_training(_going_on(task["job"]), cancelled):
            if isinstance(event, events.Progress):
                tell(event.step / max(event.steps, 1))
            elif isinstance(event, events.Finished):
                return True
    return False


def _going_on(job: TrainingJob) -> TrainingJob:
    """The job, from its checkpoint if there is one."""
    return replace(job, resume=not job.overwrite and checkpoint_path(job.output).is_file())
