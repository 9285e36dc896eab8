"""What a training that goes on takes over from the one that began, and what it says of what it leaves aside."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ...capture.readers import detect
from ...errors import FrogError, found_instead
from ...io.paths import is_network_path
from ..methods import METHODS
from ..recipe import stored_recipe
from ..setting import Choice, Kind, Number, OrNone, check
from .checkpoint import checkpoint_path, checkpoint_settings
from .loop import KEPT

if TYPE_CHECKING:
    from .job import TrainingJob

_OF_RECIPE = {"recipe": "name", "capacity": "capacity"}
_MOST_CAMERAS, _FARTHEST = 10_000, 1e6


@dataclass(frozen=True)
class _Offsets:
    """Pixels (x, y) by camera, as ``open_capture`` takes them."""

    expected = "two numbers of pixels for each camera"

    def accepts(self, value: object) -> bool:
        pixels = Number(-_FARTHEST, _FARTHEST)
        return (
            isinstance(value, dict)
            and len(value) <= _MOST_CAMERAS
            and all(isinstance(pair, list) and len(pair) == 2 for pair in value.values())
            and all(pixels.accepts(each) for pair in value.values() for each in pair)
        )


_KINDS: dict[str, Kind] = {
    "method": Choice(tuple(METHODS)),
    "seed": Number(0, 2**32 - 1, whole=True),
    "scale": OrNone(Number(1e-4, 16)),
    "holdout_frames": OrNone(Number(0, 10**6, whole=True)),
    "pixel_offsets": OrNone(_Offsets()),
    "lossless": Choice((True, False)),
    "max_bytes": OrNone(Number(1, 2**50, whole=True)),
    "steps": OrNone(Number(1, 10**12, whole=True)),
    "seconds": OrNone(Number(1e-9, 1e12)),
}
"""What a checkpoint may say of each of ``loop.KEPT``."""


def restore_job(job: TrainingJob) -> tuple[TrainingJob, str | None]:
    """A resumed job with what it was started with, and what is to be said of that; only the limits can be set anew.

    FrogError when the checkpoint cannot be used, or is another capture's.
    """
    path = checkpoint_path(job.output)
    if not path.is_file():
        raise found_instead(path, "no file", "a training checkpoint to go on from")
    before = checkpoint_settings(path)
    _check_capture(path, before, job.capture)
    began = _began(job, path, before)
    left_aside = _left_aside(job, began)
    if _described(began) == _described(job) and not left_aside:
        return began, None
    aside = f"; left aside: {', '.join(left_aside)}" if left_aside else ""
    return began, f"The training goes on as it began: {_described(began)}{aside}."


def _check_capture(path: Path, before: dict[str, Any], capture: Path) -> None:
    """FrogError when the checkpoint is of another folder that is still a capture: one that is gone was moved."""
    stored = before.get("capture")
    if not isinstance(stored, str) or not stored or stored == str(Path(capture).resolve()):
        return
    try:
        # What a file says makes no computer call others: a capture there counts as one that was moved.
        if is_network_path(stored) or Path(stored).resolve() == Path(capture).resolve():
            return
        detect(Path(stored))
    except (FrogError, OSError, ValueError):
        return
    raise found_instead(path, f"a training of another capture, {stored}", f"one of {capture}")


def _began(job: TrainingJob, path: Path, before: dict[str, Any]) -> TrainingJob:
    try:
        kept = {name: before[name] for name in KEPT}
        for name, value in kept.items():
            check(name, value, _KINDS[name])
        if kept["pixel_offsets"]:
            kept["pixel_offsets"] = {name: (float(x), float(y)) for name, (x, y) in kept["pixel_offsets"].items()}
        if job.steps or job.seconds:
            kept |= {"steps": job.steps, "seconds": job.seconds}
        if job.max_bytes:
            kept["max_bytes"] = job.max_bytes
        return replace(job, **kept, recipe=stored_recipe(before["recipe"]))
    except (KeyError, FrogError) as error:
        raise found_instead(path, f"settings that do not fit ({error})", "a training checkpoint") from error


def _described(job: TrainingJob) -> str:
    return f"method {job.method}, recipe {job.recipe.name}, capacity {job.recipe.capacity}"


def _left_aside(asked: TrainingJob, began: TrainingJob) -> list[str]:
    """The settings that somebody chose for a training that began with others, as they know them."""
    return [known for name, known in asked.chosen.items() if _setting(asked, name) != _setting(began, name)]


def _setting(job: TrainingJob, name: str) -> Any:
    if name == "max_gaussians":  # with automatic capacity what is kept in the end
        return job.recipe.kept_at_most
    return getattr(job.recipe, _OF_RECIPE[name]) if name in _OF_RECIPE else getattr(job, name)
