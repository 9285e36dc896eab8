"""What a resumed training takes over from its checkpoint, and which of the user's settings it ignores."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

from ...capture.readers import detect
from ...errors import FrogError, found_instead
from ...io.paths import is_network_path
from ...io.plain_values import JsonObject
from ..recipe import stored_recipe
from .checkpoint import checkpoint_settings
from .job import TrainingJob, restored_settings
from .output_paths import checkpoint_path

_OF_RECIPE = {"recipe": "name", "capacity": "capacity", "views_per_step": "views_per_step"}


def restore_job(job: TrainingJob) -> tuple[TrainingJob, str | None]:
    """The job with the settings that its training began with; only its limits can be set anew.

    Returns:
        The restored job, and a sentence for the user where it differs from what was asked for.

    Raises:
        FrogError: the checkpoint cannot be used, or belongs to another capture.
    """
    path = checkpoint_path(job.output)
    if not path.is_file():
        raise found_instead(path, "no file", "a training checkpoint to resume from")
    stored = checkpoint_settings(path)
    _check_capture(path, stored, job.capture)
    restored = _restored(job, path, stored)
    ignored = [known for name, known in job.chosen.items() if _setting(job, name) != _setting(restored, name)]
    if _described(restored) == _described(job) and not ignored:
        return restored, None
    ending = f"; ignored: {', '.join(ignored)}" if ignored else ""
    return restored, f"Resuming with the original settings: {_described(restored)}{ending}."


def _check_capture(path: Path, stored: JsonObject, capture: Path) -> None:
    """FrogError when the checkpoint's capture is another folder, unless that holds no capture: then it was moved."""
    folder = stored.get("capture")
    if not isinstance(folder, str) or not folder or folder == str(Path(capture).resolve()):
        return
    try:
        # A path in a file must not make this computer contact another: a capture there counts as moved.
        if is_network_path(folder) or Path(folder).resolve() == Path(capture).resolve():
            return
        detect(Path(folder))
    except (FrogError, OSError, ValueError):
        return
    raise found_instead(path, f"a training of another capture, {folder}", f"one of {capture}")


def _restored(job: TrainingJob, path: Path, stored: JsonObject) -> TrainingJob:
    try:
        kept = restored_settings(stored)
        if job.steps or job.seconds:
            kept |= {"steps": job.steps, "seconds": job.seconds}
        if job.max_bytes:
            kept["max_bytes"] = job.max_bytes
        return replace(job, **kept, recipe=stored_recipe(stored["recipe"]))
    except (KeyError, FrogError) as error:
        raise found_instead(path, f"settings that do not fit ({error})", "a training checkpoint") from error


def _described(job: TrainingJob) -> str:
    return f"method {job.method}, recipe {job.recipe.name}, capacity {job.recipe.capacity}"


def _setting(job: TrainingJob, name: str) -> Any:
    """A setting by its name; ``Any`` because fields have types of their own."""
    if name == "max_gaussians":  # with automatic capacity the final count
        return job.recipe.kept_at_most
    return getattr(job.recipe, _OF_RECIPE[name]) if name in _OF_RECIPE else getattr(job, name)
