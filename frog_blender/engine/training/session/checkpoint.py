"""A training put on disk: everything a resume needs, in a file of its own beside the scene."""

from __future__ import annotations

from .. import passive_threads  # noqa: F401

# isort: split
import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.numpy import save as serialize
from torch import nn

from ...errors import FrogError, brief, found_instead
from ...io.atomic_files import write_atomically
from ...io.tensor_files import read_tensors
from ...model.canonical import ATTRIBUTES
from ...model.deformation import UNITS
from ...model.frog import Frog
from ...scene.scene_file import settings_json
from ..compression.schedule import CompressionStep, heads_of
from ..compression.sensitivity import Motion
from ..optimize.densification import COLLECTED
from ..optimize.smoothness import NeighbourGraph
from ..optimize.state_checks import fitting
from ..optimize.trainer import Trainer
from .output_paths import checkpoint_path as checkpoint_path

_KEY = "frog-checkpoint"
_VERSION = 12
_WHAT = "a training checkpoint"
# Attributes of the trainer's parts, each an array under the part's name.
_POSES = ("moments", "moved", "gathered")
_MOTION = ("score", "rest_energy", "fade_energy", "shape_energy")
_NEIGHBOURHOOD = ("anchors", "neighbours", "weights")


State = tuple[dict[str, np.ndarray], dict[str, Any]]
"""Everything a training has learned and remembers: arrays by name, and plain values."""


def state_of(trainer: Trainer, settings: dict[str, Any] | None = None) -> State:
    """A copy of a training's state. ``settings`` are plain values for ``checkpoint_settings``."""
    trainer.settle()
    tensors = {f"model.{name}": value for name, value in trainer.model.state_dict().items()}
    tensors |= trainer.optimizer.state_arrays()
    tensors |= {f"density.{name}": getattr(trainer.density, name) for name in COLLECTED}
    tensors["losses"] = trainer.picker.losses
    tensors["random"] = trainer.generator.get_state()
    for camera, errors in enumerate(trainer.regions.errors):
        tensors[f"regions.{camera}"] = torch.from_numpy(errors)
    if trainer.poses:
        poses = [camera.world_to_camera for camera in trainer.capture.cameras]
        tensors["poses"] = torch.from_numpy(np.stack(poses))
        tensors |= {f"poses.{name}": torch.from_numpy(getattr(trainer.poses, name)) for name in _POSES}
    if trainer.exposures:
        exposures = [camera.exposure for camera in trainer.capture.cameras]
        tensors["exposures"] = torch.tensor(exposures, dtype=torch.float64, device="cpu")
        tensors["exposures.sums"] = trainer.exposures.sums
    if trainer.compression:
        tensors["removed"] = torch.from_numpy(trainer.compression.removed)
        if trainer.compression.motion:
            tensors |= {f"motion.{name}": getattr(trainer.compression.motion, name) for name in _MOTION}
    if trainer.neighbourhood is not None:
        tensors |= {f"neighbourhood.{name}": getattr(trainer.neighbourhood, name) for name in _NEIGHBOURHOOD}
    values = {
        "version": _VERSION,
        "method": trainer.method,
        "recipe": json.loads(json.dumps(settings_json(trainer.recipe))),
        "step_count": trainer.step_count,
        "seconds": trainer.seconds,
        "progress": trainer.progress,
        "settings": settings or {},
        "cameras": [camera.name for camera in trainer.capture.cameras],
        "loss": trainer.loss if np.isfinite(trainer.loss) else None,
        "burst_shot": trainer.burst_shot,
        "draws": trainer.picker.draws,
        "shots": len(trainer.capture.shots),
        "parsimony": _parsimony_state(trainer),
        "heads": heads_of(trainer.model),
        "rate_factor": trainer.optimizer.rate_factor,
    }
    # ascontiguousarray would turn Adam's scalar step counters into vectors.
    return {name: np.array(value.detach().cpu().numpy(), order="C") for name, value in tensors.items()}, values


def save_checkpoint(path: Path, trainer: Trainer, settings: dict[str, Any] | None = None) -> None:
    """Atomic; FrogError when the disk does not take it."""
    write_checkpoint(path, state_of(trainer, settings))


def write_checkpoint(path: Path, state: State) -> None:
    """A state that ``state_of`` found; atomic; FrogError when disk or memory do not take it."""
    arrays, values = state
    try:
        content = serialize(arrays, metadata={_KEY: json.dumps(values)})
    except MemoryError as error:
        raise FrogError(f"{path}: could not be written (out of memory); nothing was changed.") from error
    write_atomically(path, content)


def _gaussians(tensors: dict[str, torch.Tensor], trainer: Trainer) -> dict[str, torch.Tensor]:
    """The canonical attributes on the trainer's device; ValueError unless there is a row for every Gaussian."""
    found = {name: tensors[f"model.canonical.{name}"] for name in ATTRIBUTES}
    count, moving = len(found["means"]), len(found["embeddings"])
    coefficients = found["sh"].shape[1]
    if coefficients not in [(degree + 1) ** 2 for degree in range(trainer.recipe.sh_degree + 1)]:
        raise ValueError(f"{coefficients} SH coefficients")
    if not 0 <= moving <= count > 0:
        raise ValueError(f"{moving} of {count} Gaussians that move")
    shapes = {"sh": (count, coefficients, 3), "embeddings": (moving, trainer.model.canonical.embeddings.shape[1])}
    shapes |= {"means": (count, 3), "log_scales": (count, 3), "quaternions": (count, 4), "opacity_logits": (count,)}
    return {name: fitting(name, found[name], shapes[name]).to(trainer.device) for name in ATTRIBUTES}


def _set_width(tensors: dict[str, torch.Tensor], model: Frog, most: int) -> None:
    """Gives the model's first layer as many units as there are in ``tensors``: a network may have been narrowed.
    ValueError for more than ``most``."""
    field = model.deformation
    width = len(tensors["model.deformation.bias"])
    if width == len(field.bias) or not field.can_narrow:
        return
    if not 1 <= width <= most:
        raise ValueError(f"{width} hidden units")
    arrays = {}
    for name, old in field.unit_arrays.items():
        shape = [width if at == UNITS[name] else size for at, size in enumerate(old.shape)]
        arrays[name] = fitting(name, tensors[f"model.deformation.{name}"], tuple(shape)).to(old.device)
    model.set_width(arrays)


def _neighbourhood(tensors: dict[str, torch.Tensor], trainer: Trainer) -> NeighbourGraph | None:
    """What was drawn for the embedding smoothness, if anything; ValueError for Gaussians that do not move."""
    if "neighbourhood.anchors" not in tensors:
        return None
    anchors, neighbours, weights = (tensors[f"neighbourhood.{name}"] for name in _NEIGHBOURHOOD)
    fitting("anchors", anchors, (len(anchors),), torch.int64)
    fitting("neighbours", neighbours, (len(anchors), *neighbours.shape[1:2]), torch.int64)
    fitting("weights", weights, tuple(neighbours.shape))
    if not neighbours.numel():
        raise ValueError("nobody's neighbours")
    who = torch.cat([anchors, neighbours.flatten()])
    if not bool(((who >= 0) & (who < trainer.model.canonical.num_dynamic)).all()):
        raise ValueError("neighbours that are none")
    return NeighbourGraph(*(part.to(trainer.device) for part in (anchors, neighbours, weights)))


def _motion(tensors: dict[str, torch.Tensor], trainer: Trainer) -> Motion | None:
    """What was measured of those that move, if anything; ValueError for another number of Gaussians."""
    if "motion.score" not in tensors:
        return None
    moving = trainer.model.canonical.num_dynamic
    return Motion(*(fitting(name, tensors[f"motion.{name}"], (moving,)).to(trainer.device) for name in _MOTION))


def _parsimony_state(trainer: Trainer) -> dict[str, Any]:
    if not trainer.compression:
        return {}
    return {"seed": trainer.compression.seed, "reductions": [asdict(each) for each in trainer.compression.reductions]}


def _read(path: Path, wanted: Callable[[str], bool] = lambda name: True) -> State:
    """FrogError when the file is none that ``write_checkpoint`` wrote, or of another version."""
    arrays, metadata = read_tensors(path, _WHAT, wanted)
    try:
        values = json.loads(metadata[_KEY])
        version, settings = values["version"], values["settings"]
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise found_instead(path, f"contents that do not fit ({error!r})", _WHAT) from error
    if version != _VERSION:
        raise FrogError(f"{path}: found checkpoint version {brief(version)}, expected {_VERSION}.")
    if not isinstance(values, dict) or not isinstance(settings, dict):
        raise found_instead(path, "settings that are none", _WHAT)
    return arrays, values


def checkpoint_settings(path: Path) -> dict[str, Any]:
    """What ``save_checkpoint`` was given; FrogError when the file cannot be used."""
    settings: dict[str, Any] = _read(path, wanted=lambda name: False)[1]["settings"]
    return settings


def load_checkpoint(path: Path, trainer: Trainer) -> None:
    """Puts ``trainer`` (same capture, recipe and method; any device) where the checkpoint was written.

    FrogError when the file cannot be used; the trainer is then as it was.
    """
    state = _read(path)
    if differing := _differing(state[1], trainer):
        raise FrogError(f"{path}: belongs to another training ({differing} differ); train again without resuming.")
    before = state_of(trainer)
    try:
        restore(trainer, state)
    except Exception as error:
        # Whatever somebody wrote into the file, the training must be able to begin instead.
        restore(trainer, before)
        raise found_instead(path, f"contents that do not fit ({error})", _WHAT) from error


def _differing(values: dict[str, Any], trainer: Trainer) -> str:
    """What of a checkpoint is not as in this training, in words; empty where all is."""
    if values.get("method") != trainer.method:
        return "the method"
    stored, recipe = values.get("recipe"), json.loads(json.dumps(settings_json(trainer.recipe)))
    if not isinstance(stored, dict):
        return "the recipe"
    decides = [key for key in recipe if key not in ("name", "steps", "steps_per_moment")]
    if differing := [key for key in decides if stored.get(key) != recipe[key]]:
        return brief(", ".join(differing))
    same = values.get("shots") == len(trainer.capture.shots)
    same &= values.get("cameras") == [camera.name for camera in trainer.capture.cameras]
    return "" if same else "the capture"


def restore(trainer: Trainer, state: State) -> None:
    """Puts ``trainer`` where ``state_of`` found it, or another one of the same training.

    Any exception for a state that does not fit; the trainer is then of no use until another does.
    """
    arrays, values = state
    tensors = {name: torch.from_numpy(array.copy()) for name, array in arrays.items()}
    for name, attribute in _gaussians(tensors, trainer).items():
        setattr(trainer.model.canonical, name, nn.Parameter(attribute))
    if isinstance(trainer.model, Frog):
        _set_width(tensors, trainer.model, trainer.recipe.hidden_width)
    trainer.model.load_state_dict({name[6:]: value for name, value in tensors.items() if name.startswith("model.")})
    trainer.model.zero_grad(set_to_none=True)
    trainer.rebuild_optimizer()
    trainer.optimizer.resume(tensors, float(values["rate_factor"]))
    trainer.density.resume({name: tensors[f"density.{name}"] for name in COLLECTED}, trainer.count)
    trainer.picker.resume(tensors["losses"], int(values["draws"]))
    trainer.generator.set_state(tensors["random"])
    trainer.regions.resume([tensors[f"regions.{camera}"] for camera in range(len(trainer.capture.cameras))])
    if trainer.poses:
        trainer.poses.resume(tensors["poses"], *(tensors[f"poses.{name}"] for name in _POSES))
        trainer.capture = trainer.poses.capture
    if trainer.exposures:
        found = tensors["exposures.sums"], tensors["exposures"]
        trainer.see_through(trainer.exposures.resume(*found, trainer.capture))
    trainer.neighbourhood = _neighbourhood(tensors, trainer)
    if trainer.compression:
        rounds = values["parsimony"]
        reductions = [CompressionStep(**each) for each in rounds["reductions"]]
        trainer.compression.resume(rounds["seed"], reductions, arrays["removed"], _motion(tensors, trainer))
    trainer.resume_at(values)
    trainer.check()
    if isinstance(trainer.model, Frog):  # last: silencing writes zeros
        for name in values["heads"]:
            trainer.model.restore_head(name)
        for name in set(heads_of(trainer.model)) - set(values["heads"]):
            trainer.model.prune_head(name)
