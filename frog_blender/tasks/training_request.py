"""Training requests: the panel's settings as plain values for a worker thread."""

import os
import shutil
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import bpy

from ..engine.capture.readers.footage import is_recording
from ..engine.errors import FrogError, found_instead, in_words
from ..engine.io.atomic_files import atomic_file
from ..engine.options import TrainingOptions
from ..engine.training.session.cancel_token import CancelToken
from ..engine.training.session.events import Event
from ..engine.training.session.job import TrainingJob
from ..engine.training.session.live_scene import LiveScene
from ..engine.training.session.output_paths import checkpoint_path, is_of_another, training_progress, unused_output
from ..engine.training.session.time_estimate import remembering
from ..option_properties import chosen_options
from . import package_folders

KEY_MASKS = "key"
"""The choice of the panel's masks that is none of the option's: a colour of its own."""


@dataclass
class TrainingRequest:
    """What to train, in plain values.

    Attributes:
        continued: the scene of a finished training that this one begins with, and leaves as it is.
    """

    capture: Path
    output: Path
    options: TrainingOptions = field(default_factory=TrainingOptions)
    continued: Path | None = None

    def events(self, control: CancelToken, live: LiveScene | None = None) -> Iterator[Event]:
        """Run the training; called on the worker, because this is what imports torch.

        Args:
            live: takes snapshots of the scene.
        """
        package_folders.hold()
        from ..engine.training.session.run import run_training

        self.copy_checkpoint()
        job = TrainingJob.of_options(self.capture, self.output, self.options, live=live)
        return remembering(run_training(job, control), job)

    def copy_checkpoint(self) -> None:
        """Gives a training that continues a finished one the checkpoint that it begins with."""
        if self.continued is not None:
            target = checkpoint_path(self.output)
            failed = in_words(f"{target}: the checkpoint could not be copied")
            with failed, checkpoint_path(self.continued).open("rb") as done, atomic_file(target) as copy:
                shutil.copyfileobj(done, copy)


def longer_request(settings: Any, steps: int) -> TrainingRequest:
    """The request that goes on with a finished training until it has had ``steps``, for an output of its own: until it
    ends its scene may be worse than the one that is there. There has to be one: see ``can_train_longer``.
    """
    done, request = output_of(settings), request_of(settings, resume=True)
    options = replace(request.options, steps=steps, seconds=None)
    return replace(request, output=unused_output(done), continued=done, options=options)


def request_of(settings: Any, resume: bool = False) -> TrainingRequest:
    """The training request of the panel's settings; FrogError if something is missing.

    Unless it is resumed, a training writes what is not there yet: the output gets a number where a scene lies.
    """
    capture = Path(bpy.path.abspath(settings.capture_folder))
    if not os.path.isdir(capture) and not is_recording(capture):  # false, not an error, without permission
        raise FrogError(f"{capture}: found no such folder, expected a capture to train from.")
    if not settings.output_path:
        raise FrogError("No output is selected. Choose the .frog file to write.")
    output = output_of(settings)
    if resume and is_of_another(output, capture):
        raise found_instead(checkpoint_path(output), "a training of another capture", f"one of {capture}")
    options = chosen_options(settings, **_from_panel(settings), resume=resume)
    return TrainingRequest(capture, output if resume else unused_output(output), options)


def _from_panel(settings: Any) -> dict[str, Any]:
    """Options that the panel has in another form than the table's: a colour beside its tolerance."""
    if settings.masks != KEY_MASKS:
        return {"key": None}
    color = bytes(round(255 * min(max(value, 0.0), 1.0)) for value in settings.key_color)
    return {"masks": "auto", "key": f"#{color.hex()},{settings.key_tolerance:.2f}"}


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
    return 0 <= _progress(settings)[0] < 1


def can_train_longer(settings: Any) -> bool:
    """Whether the training of that output, from the same capture, has ended and left a checkpoint."""
    return _progress(settings)[0] >= 1


def steps_done(settings: Any) -> int:
    """The steps of the training of that output so far; 0 for none."""
    return _progress(settings)[1]


def _progress(settings: Any) -> tuple[float, int]:
    """The share and the number of the steps that are done; -1 and 0 for none, and for a training of another capture."""
    try:
        output = output_of(settings)
    except FrogError:
        return -1.0, 0
    is_other = is_of_another(output, Path(bpy.path.abspath(settings.capture_folder)))
    return (None if is_other else training_progress(output)) or (-1.0, 0)
