"""``frog train``: a scene from a capture."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.errors import FrogError
from ..engine.field.names import METHODS
from ..engine.training.recipe import RECIPES
from ..engine.training.session.output_paths import check_unused
from ..engine.training.session.torchrun import started_by_torchrun
from .arguments import add_mask_arguments, add_offset_argument, offsets_of, positive, seed
from .cluster import add_scheduler_argument
from .stopping import stopping
from .streams import printing_may_fail

if TYPE_CHECKING:
    from ..engine.training.recipe import Recipe
    from ..engine.training.session.job import TrainingJob


_WAYS = "--overwrite replaces it, --resume goes on with its training, and another name keeps both"


def add_train_parser(commands: Any) -> None:
    """Adds the command."""
    train = commands.add_parser("train", help="train a scene from a capture")
    train.register("action", None, _Give)  # of every option that takes a value
    train.add_argument("capture", type=Path)
    train.add_argument("--out", type=Path, required=True, metavar="X.frog")
    train.add_argument("--method", choices=METHODS, default="frog")
    train.add_argument("--recipe", choices=RECIPES, default="standard")
    train.add_argument("--steps", type=positive(int), help="default: the recipe's")
    train.add_argument("--seconds", type=positive(float), help="train for this long instead")
    train.add_argument("--seed", type=seed, default=0)
    train.add_argument("--scale", type=positive(float), help="image size factor, such as 0.5")
    train.add_argument("--holdout-frames", type=int, metavar="K", help="hold out every K-th frame; 0 holds out none")
    train.add_argument(
        "--device",
        choices=["auto", "cpu", "cuda"],
        default="auto",
        help="auto: a usable GPU, else the CPU",
    )
    train.add_argument(
        "--capacity", choices=["auto", "fixed"], default="auto", help="auto (default): no more than the scene needs"
    )
    train.add_argument("--max-gaussians", type=positive(int), metavar="N", help="of the scene, at most")
    train.add_argument(
        "--views-per-step", type=positive(int), metavar="N", help="images of every step; default: 1, or one a process"
    )
    train.add_argument("--max-bytes", type=positive(int), metavar="N", help="of the .frog, with --capacity auto")
    train.add_argument("--lossless", action="store_true", help="write every number as it is; default: packed")
    train.add_argument(
        "--save-every",
        type=positive(float),
        default=180.0,
        metavar="SECONDS",
        help="between checkpoints; default: 180",
    )
    train.add_argument(
        "--events",
        action="store_true",
        help="print events as lines of JSON; end when standard input does, and obey its lines 'pause', 'resume' and "
        "'preview CAMERA'",
    )
    again = train.add_mutually_exclusive_group()
    again.add_argument(
        "--overwrite", action="store_true", help="replace a scene that is there, once the new one is whole"
    )
    again.add_argument(
        "--resume",
        action="store_true",
        help="go on from the checkpoint beside the .frog, with the recipe, method, capacity and so on that it began "
        "with (others are ignored, and it says so); only --steps, --seconds and --max-bytes may be set anew",
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
    add_offset_argument(train)
    add_mask_arguments(train)
    train.set_defaults(run=_train, given=frozenset())


class _Give(argparse.Action):
    """Stores a value, and that it was given: by itself it may be what it is when it is not."""

    def __call__(self, parser: Any, options: argparse.Namespace, values: Any, name: str | None = None) -> None:
        setattr(options, self.dest, values)
        options.given |= {self.dest}


def _chosen(options: argparse.Namespace) -> dict[str, str]:
    """Of the settings that a training keeps from its beginning those that were given, and how they were."""
    of_recipe = ("method", "recipe", "capacity", "views_per_step", "max_gaussians")
    names = (*of_recipe, "seed", "scale", "holdout_frames", "masks", "key")
    chosen = {name: f"--{name.replace('_', '-')}" for name in names if name in options.given}
    chosen |= {"lossless": "--lossless"} if options.lossless else {}
    return chosen | ({"pixel_offsets": "--pixel-offset"} if options.pixel_offset else {})


def _train(options: argparse.Namespace) -> int:
    if options.takes:
        return _train_takes(options)
    if not (options.overwrite or options.resume):
        check_unused(options.out, _WAYS)  # before torch is loaded
    if options.scheduler:
        raise FrogError("--scheduler gives takes to workers: expected --takes with it.")
    if started_by_torchrun():
        if options.events:
            raise FrogError("--events tells of a training by one process, and torchrun has started this one.")
        from .train_together import train_together

        return train_together(options, lambda: _job(options))
    with printing_may_fail(), stopping() as asked:  # what was learned is saved
        from ..engine.training.session.run import run_training
        from ..engine.training.session.time_estimate import remembering

        job = _job(options)
        if options.events:
            from .event_stream import obeying_input, tell

            finished = tell(remembering(run_training(job, obeying_input(asked)), job))
        else:
            from .progress import show

            finished = show(remembering(run_training(job, asked), job), job.output)
    return 0 if finished else 1


def _train_takes(options: argparse.Namespace) -> int:
    from .takes_command import train_takes

    if options.events or started_by_torchrun():
        found = "--events" if options.events else "torchrun"
        raise FrogError(f"--takes: found {found}, which one training is for: expected neither that nor torchrun.")

    def job_of(capture: Path, output: Path) -> TrainingJob:
        return _job(argparse.Namespace(**{**vars(options), "capture": capture, "out": output}))

    return train_takes(options, job_of)


def _job(options: argparse.Namespace) -> TrainingJob:
    from ..engine.training.session.job import TrainingJob

    return TrainingJob(
        capture=options.capture,
        output=options.out,
        method=options.method,
        recipe=_budgeted(options),
        steps=options.steps,
        seconds=options.seconds,
        seed=options.seed,
        scale=options.scale,
        holdout_frames=options.holdout_frames,
        overwrite=options.overwrite,
        resume=options.resume,
        chosen=_chosen(options),
        pixel_offsets=offsets_of(options),
        masks=options.masks,
        key=options.key,
        device=options.device,
        lossless=options.lossless,
        max_bytes=options.max_bytes,
        save_seconds=options.save_every,
    )


def _budgeted(options: argparse.Namespace) -> Recipe:
    """The recipe with the capacity and the budgets that were asked for."""
    from ..engine.training.compression.budget import recipe_within
    from ..engine.training.recipe import recipe

    chosen = recipe(options.recipe, capacity=options.capacity, views_per_step=options.views_per_step)
    return recipe_within(chosen, options.method, max_gaussians=options.max_gaussians, max_bytes=options.max_bytes)
