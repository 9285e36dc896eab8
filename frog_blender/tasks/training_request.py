"""Training requests: the panel's settings as plain values for a worker thread."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bpy

from ..engine.capture.pixel_offsets import parse_pixel_offsets
from ..engine.errors import FrogError, found_instead
from ..engine.training.session.cancel_token import CancelToken
from ..engine.training.session.output_paths import (
    checkpoint_path,
    is_of_another,
    training_progress,
    unused_output,
)
from . import package_folders


class TrainingRequest:
    """What to train, in plain values.

    Args:
        recipe, capacity: names; None leaves the capacity to the recipe.
        max_gaussians: of the scene, at most; None for as many as the recipe allows.
        continued: the scene of a finished training that this one begins with, and leaves as it is.
        job: fields of the engine's ``TrainingJob`` that are not to have their defaults. They are not repeated here,
            and the class itself is not named: its module imports torch.
    """

    def __init__(
        self,
        capture: Path,
        output: Path,
        recipe: str = "standard",
        capacity: str | None = None,
        *,
        max_gaussians: int | None = None,
        continued: Path | None = None,
        **job: Any,
    ) -> None:
        self.capture, self.output, self.recipe, self.capacity, self.job = capture, output, recipe, capacity, job
        self.max_gaussians, self.continued = max_gaussians, continued

    def events(self, control: CancelToken) -> Iterator[Any]:
        """Run the training; called on the worker, because this is what imports torch."""
        package_folders.hold()
        from ..engine.training.compression.budget import recipe_within
        from ..engine.training.recipe import recipe
        from ..engine.training.session.job import TrainingJob
        from ..engine.training.session.run import run_training
        from ..engine.training.session.time_estimate import remembering

        self.copy_checkpoint()
        chosen = recipe(self.recipe, capacity=self.capacity)
        settings = recipe_within(chosen, "frog", max_gaussians=self.max_gaussians, max_bytes=None)
        job = TrainingJob(self.capture, self.output, recipe=settings, **self.job)
        return remembering(run_training(job, control), job)

    def copy_checkpoint(self) -> None:
        """Gives a training that continues a finished one the checkpoint that it begins with."""
        if self.continued is not None:
            _copy(checkpoint_path(self.continued), checkpoint_path(self.output))


def _copy(source: Path, target: Path) -> None:
    """Copies a file; FrogError where that fails."""
    try:
        shutil.copyfile(source, target)
    except OSError as error:
        raise FrogError(f"{target}: the checkpoint could not be copied ({error.strerror}).") from error


def request_of(settings: Any, resume: bool = False) -> TrainingRequest:
    """The training request of the panel's settings; FrogError if something is missing.

    Unless it is resumed, a training writes what is not there yet: the output gets a number where a scene lies.
    """
    return _request(settings, resume)


def longer_request(settings: Any, steps: int) -> TrainingRequest:
    """The request that goes on with a finished training until it has had ``steps``, for an output of its own: until it
    ends its scene may be worse than the one that is there. FrogError where there is nothing to go on with.
    """
    done = output_of(settings)
    if not can_train_longer(settings):
        raise found_instead(checkpoint_path(done), "no finished training of this capture", "one to go on with")
    request = _request(settings, True)
    request.output, request.continued = unused_output(done), done
    request.job |= {"steps": steps, "seconds": None}
    return request


def _request(settings: Any, resume: bool) -> TrainingRequest:
    if not settings.capture_folder:
        raise FrogError("No capture is selected. Choose the folder with the videos and cameras to train from.")
    capture = Path(bpy.path.abspath(settings.capture_folder))
    if not os.path.isdir(capture):  # false, not an error, without permission
        raise FrogError(f"{capture}: found no such folder, expected a capture to train from.")
    if not settings.output_path:
        raise FrogError("No output is selected. Choose the .frog file to write.")
    output = output_of(settings)
    if resume and is_of_another(output, capture):
        raise found_instead(checkpoint_path(output), "a training of another capture", f"one of {capture}")
    return TrainingRequest(
        capture,
        output if resume else unused_output(output),
        settings.recipe,
        settings.capacity,
        max_gaussians=settings.max_gaussians or None,
        steps=settings.steps or None,
        seconds=60.0 * settings.minutes or None,
        scale=settings.image_scale or None,
        pixel_offsets=parse_pixel_offsets(settings.pixel_offsets.split()),
        holdout_frames=None if settings.holdout_frames < 0 else settings.holdout_frames,
        masks="off" if settings.masks == "off" else "auto",
        key=_key_of(settings),
        device=settings.device,
        preview_camera=settings.preview_camera or None,
        resume=resume,
        overwrite=False,
    )


def _key_of(settings: Any) -> str | None:
    """The chroma key of the panel's settings, as ``masking.chroma_key`` reads it."""
    if settings.masks != "key":
        return None
    color = bytes(round(255 * min(max(value, 0.0), 1.0)) for value in settings.key_color)
    return f"#{color.hex()},{settings.key_tolerance:.2f}"


def output_of(settings: Any) -> Path:
    """The output file of the panel's settings."""
    output = Path(bpy.path.abspath(settings.output_path))
    if not output.name:
        raise found_instead(output, "a folder", "the name of a .frog file to write")
    return output if output.suffix == ".frog" else output.with_name(output.name + ".frog")


def can_resume(settings: Any) -> bool:
    """Whether there is a checkpoint of that output to resume: of the same capture, and of a training not yet at its
    end.
    """
    progress = _progress(settings)
    return progress is not None and progress[0] < 1.0


def can_train_longer(settings: Any) -> bool:
    """Whether the training of that output, from the same capture, has ended and left a checkpoint."""
    progress = _progress(settings)
    return progress is not None and progress[0] >= 1.0


def steps_done(settings: Any) -> int:
    """The steps of the training of that output so far; 0 for none."""
    progress = _progress(settings)
    return progress[1] if progress is not None else 0


def _progress(settings: Any) -> tuple[float, int] | None:
    """See ``training_progress``; None as well for the training of another capture."""
    try:
        output = output_of(settings)
    except FrogError:
        return None
    found = training_progress(output)
    if found is None or is_of_another(output, Path(bpy.path.abspath(settings.capture_folder))):
        return None
    return found
