"""A training put on disk, in a file of its own beside the scene, and what a resumed one takes over from there."""

from .. import passive_threads  # noqa: F401

# isort: split


import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from safetensors.numpy import save as serialize

from ...arrays import Array
from ...capture.capture import Capture
from ...capture.frame_keys import found_otherwise
from ...errors import FrogError, UsageError, brief, found_instead
from ...io.atomic_files import write_atomically
from ...io.plain_values import JsonObject
from ...io.tensor_files import read_tensors
from ...recipes import stored_recipe
from ..compression.budget import recipe_within
from ..optimize.training import Training
from .job import RENEWED, STORED, TrainingJob
from .output_paths import checkpoint_path, header_of, training_progress

_KEY = "frog-checkpoint"
_VERSION = 1
_WHAT = "a training checkpoint"
_NAMED = 3  # settings in a sentence
_MAY_DIFFER = ("name", "steps", "steps_per_moment")  # in a recipe

State = tuple[dict[str, Array], JsonObject]
"""Everything a training has learned and remembers: arrays by name, and plain values."""


def state_of(training: Training, settings: JsonObject | None = None) -> State:
    """A copy of a training's state. ``settings`` are plain values for ``checkpoint_settings``."""
    tensors, values = training.state()
    # ascontiguousarray would turn Adam's scalar step counters into vectors.
    arrays = {name: np.array(value.detach().cpu().numpy(), order="C") for name, value in tensors.items()}
    return arrays, {"version": _VERSION, "settings": settings or {}, **training.description, **values}


def write_checkpoint(path: Path, state: State) -> None:
    """A state that ``state_of`` found; atomic; FrogError when disk or memory do not take it."""
    arrays, values = state
    try:
        content = serialize(arrays, metadata={_KEY: json.dumps(values)})
    except MemoryError as error:
        raise FrogError(f"{path}: could not be written (out of memory); nothing was changed.") from error
    write_atomically(path, content)


def _read(path: Path, is_read: Callable[[str], bool] = lambda name: True) -> State:
    """FrogError when ``write_checkpoint`` did not write the file, or another version of it did."""
    arrays, metadata = read_tensors(path, _WHAT, is_read)
    try:
        values = json.loads(metadata[_KEY])
        version, settings = values["version"], values["settings"]
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise found_instead(path, f"contents that do not fit ({error!r})", _WHAT) from error
    if version != _VERSION:
        raise FrogError(f"{path}: found checkpoint version {brief(version)}, expected {_VERSION}.")
    if not isinstance(values, dict) or not isinstance(settings, dict):
        raise found_instead(path, "settings of another shape", _WHAT)
    return arrays, values


def checkpoint_settings(path: Path) -> JsonObject:
    """The settings that ``state_of`` was given; FrogError when the file cannot be used."""
    return dict(_read(path, is_read=lambda name: False)[1]["settings"])


def check_unchanged(path: Path, capture: Capture) -> None:
    """FrogError where a capture is no longer what the training of a checkpoint began with, as far as that is known."""
    made = _read(path, is_read=lambda name: False)[1].get("made_of")
    if unlike := found_otherwise(made if isinstance(made, dict) else {}, capture):
        found, advice = " and ".join(unlike.values()), "bring those back, or train anew"
        raise FrogError(f"{path}: found {found} in {capture.path} than its training began with: {advice}.")


def check_fits(job: TrainingJob, capture: Capture) -> None:
    """Checks that what lies at a job's output, if anything, is what the job would make there, of the capture as it is.

    Args:
        capture: as the job would train on it.

    Raises:
        FrogError: it is made of something else, or with other settings. Only what has not ended may get another length.
    """
    scene, state = header_of(job.output), header_of(checkpoint_path(job.output))
    if not scene and not state:
        return
    made = state.get("made_of", scene.get("made_of"))
    differences = list(found_otherwise(made if isinstance(made, dict) else {}, capture).values())
    asked = replace(job, recipe=recipe_within(job.recipe, job)).stored_settings()
    try:  # a scene says less than the checkpoint that may be gone
        less = {"recipe": {"name": scene["recipe"]["name"]}, "method": scene["method"]} if scene else {}
        own, known = _by_name(json.loads(json.dumps(asked))), _by_name(state.get("settings", less))
    except (KeyError, TypeError, ValueError) as error:
        raise found_instead(job.output, f"settings that do not fit ({error})", "those of a training") from error
    ended = (training_progress(job.output) or (1.0, 0))[0] >= 1
    kept = {name: value for name, value in own.items() if ended or name not in RENEWED}
    differing = [name for name, value in kept.items() if known.get(name, value) != value]
    differences += [f"{name} {brief(known[name])} where {brief(own[name])} is asked for" for name in differing[:_NAMED]]
    if differences:
        advice = "--overwrite trains it anew, another --out keeps both"
        raise FrogError(f"{job.output}: found a training with {', '.join(differences)}; {advice}.")


def _by_name(stored: JsonObject) -> JsonObject:
    """What decides a training besides its capture; the recipe's name first."""
    recipe = dict(stored["recipe"])
    return {"recipe": recipe.pop("name"), **recipe, **{name: stored[name] for name in STORED if name in stored}}


def load_checkpoint(path: Path, training: Training) -> None:
    """Puts ``training`` (same capture, recipe and method; any device) where the checkpoint was written.

    FrogError when the file cannot be used; the training is then as it was.
    """
    state = _read(path)
    if differing := _differences(state[1], training):
        raise FrogError(f"{path}: belongs to another training ({differing} differ); train again without resuming.")
    before = state_of(training)
    try:
        restore(training, state)
    except Exception as error:
        # Whatever somebody wrote into the file, the training must be able to begin instead.
        restore(training, before)
        raise found_instead(path, f"contents that do not fit ({error})", _WHAT) from error


def _differences(values: JsonObject, training: Training) -> str:
    """What of a checkpoint is not as in this training, in words; empty where all is."""
    expected = training.description
    if values.get("method") != expected["method"]:
        return "the method"
    stored = values.get("recipe")
    if not isinstance(stored, dict):
        return "the recipe"
    own = expected["recipe"]
    if differing := [key for key in own if key not in _MAY_DIFFER and stored.get(key) != own[key]]:
        return ", ".join(differing[:_NAMED])
    return "" if all(values.get(key) == expected[key] for key in ("shots", "cameras")) else "the capture"


def restore(training: Training, state: State) -> None:
    """Puts ``training`` where ``state_of`` found it, or another one of the same training.

    Any exception for a state that does not fit; the training is then of no use until another does.
    """
    arrays, values = state
    training.load_state({name: torch.from_numpy(array.copy()) for name, array in arrays.items()}, values)


def restore_job(job: TrainingJob) -> tuple[TrainingJob, str | None]:
    """The job with the settings that its training began with; only its limits can be set anew.

    Returns:
        The restored job, and a sentence for the user where it differs from what was asked for.

    Raises:
        FrogError: the checkpoint cannot be used, or belongs to another capture.
    """
    path = checkpoint_path(job.output)
    if not path.is_file():
        raise UsageError(found_instead(path, "no file", "a training checkpoint to resume from"))
    stored = checkpoint_settings(path)
    restored = _restored(job, path, stored)
    asked, kept = (_by_name(one.stored_settings()) for one in (job, restored))
    ignored = [known for name, known in job.chosen.items() if asked.get(name) != kept.get(name)]
    if _described(restored) == _described(job) and not ignored:
        return restored, None
    ending = f"; ignored: {', '.join(ignored)}" if ignored else ""
    return restored, f"Resuming with the original settings: {_described(restored)}{ending}."


def _restored(job: TrainingJob, path: Path, stored: JsonObject) -> TrainingJob:
    try:
        options = {name: stored[name] for name in STORED}
        restored = replace(job, **options, recipe=stored_recipe(stored["recipe"]))
        if job.steps or job.seconds:
            restored = replace(restored, steps=job.steps, seconds=job.seconds)
        return replace(restored, max_bytes=job.max_bytes) if job.max_bytes else restored
    except (KeyError, FrogError) as error:
        raise found_instead(path, f"settings that do not fit ({error})", "a training checkpoint") from error


def _described(job: TrainingJob) -> str:
    return f"method {job.method}, recipe {job.recipe.name}, capacity {job.recipe.capacity}"
