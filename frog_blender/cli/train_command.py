"""``frog train``: a scene from a capture."""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.errors import FrogError
from ..engine.given_options import given_file, given_texts, joined, training_options
from ..engine.options import OPTIONS, TrainingOptions
from ..engine.recipes import RECIPES, Recipe, recipe
from ..engine.setting import meanings_of, text_of
from ..engine.training.session.output_paths import check_unused
from ..engine.training.session.torchrun import started_by_torchrun
from .arguments import add_options, given_of, positive
from .cluster import add_scheduler_argument
from .printing import say
from .stopping import stopping
from .streams import printing_may_fail

if TYPE_CHECKING:
    from .takes_command import JobOf

_INSTEAD = "--overwrite replaces it, --resume goes on with its training, and another name keeps both"


def add_train_parser(commands: Any) -> None:
    """Adds the command."""
    train = commands.add_parser("train", help="train a scene from a capture")
    train.add_argument("capture", type=Path)
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
    train.add_argument(
        "--events",
        action="store_true",
        help="print events as lines of JSON; end when standard input does, and obey its lines 'pause', 'resume' and "
        "'preview CAMERA'",
    )
    train.add_argument(
        "--takes",
        action="store_true",
        help="train every capture in the folder CAPTURE, each to a scene of its name in the folder --out; what is"
        " trained stays, what was begun goes on",
    )
    train.add_argument(
        "--jobs", type=positive(int), default=1, metavar="N", help="workers of --scheduler local, which share the cores"
    )
    add_scheduler_argument(train)
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
        return _train_takes(arguments, job_of)
    if not (options.overwrite or options.resume):
        check_unused(arguments.out, _INSTEAD)  # before torch is loaded
    if arguments.scheduler:
        raise FrogError("--scheduler gives takes to workers: expected --takes with it.")
    job = job_of(arguments.capture, arguments.out)
    if started_by_torchrun():
        if arguments.events:
            raise FrogError("--events tells of a training by one process, and torchrun has started this one.")
        from .train_together import train_together

        return train_together(job)
    with printing_may_fail(), stopping() as asked:  # what was learned is saved
        from ..engine.training.session.run import run_training
        from ..engine.training.session.time_estimate import remembering

        if arguments.events:
            from .event_stream import obeying_input, tell

            finished = tell(remembering(run_training(job, obeying_input(asked)), job))
        else:
            from .progress import show

            finished = show(remembering(run_training(job, asked), job), job.output)
    return 0 if finished else 1


def _train_takes(arguments: argparse.Namespace, job_of: JobOf) -> int:
    from .takes_command import train_takes

    if arguments.events or started_by_torchrun():
        found = "--events" if arguments.events else "torchrun"
        raise FrogError(f"--takes: found {found}, which one training is for: expected neither that nor torchrun.")
    return train_takes(arguments, job_of)
