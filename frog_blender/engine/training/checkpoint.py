"""A training put on disk: everything a resume needs, in a file of its own beside the scene."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from safetensors.numpy import save as serialize
from torch import nn

from ..errors import FrogError, found_instead
from ..files import read_tensors, settings_json, write_atomically
from ..model.canonical import ATTRIBUTES
from ..model.frog import Frog
from .parsimony import Reduction, heads_of
from .trainer import Neighbourhood, Trainer

_KEY = "frog-checkpoint"
_VERSION = 7


def checkpoint_path(scene: str | Path) -> Path:
    """Where the checkpoint of a scene file lies."""
    return Path(f"{scene}.checkpoint")


State = tuple[dict[str, np.ndarray], dict[str, Any]]
"""Everything a training has learned and remembers: arrays by name, and plain values."""


def state_of(trainer: Trainer, settings: dict[str, Any] | None = None) -> State:
    """A copy of a training's state. ``settings`` are plain values for ``checkpoint_settings``."""
    trainer.settle()
    tensors = {f"model.{name}": value for name, value in trainer.model.state_dict().items()}
    tensors |= trainer.optimizer.state_arrays()
    tensors["density.gradient_sum"] = trainer.density.gradient_sum
    tensors["density.seen"] = trainer.density.seen
    tensors["density.peak_opacity"] = trainer.density.peak_opacity
    tensors["losses"] = trainer.picker.losses
    tensors["random"] = trainer.generator.get_state()
    for camera, errors in enumerate(trainer.regions.errors):
        tensors[f"regions.{camera}"] = errors
    if trainer.poses:
        poses = [camera.world_to_camera for camera in trainer.capture.cameras]
        tensors["poses"] = torch.from_numpy(np.stack(poses))
        for name in ("moments", "moved", "gathered"):
            tensors[f"poses.{name}"] = torch.from_numpy(getattr(trainer.poses, name))
    if trainer.parsimony:
        tensors["removed"] = torch.from_numpy(trainer.parsimony.removed)
    if trainer.neighbourhood is not None:
        for name in ("anchors", "neighbours", "weights"):
            tensors[f"neighbourhood.{name}"] = getattr(trainer.neighbourhood, name)
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
    """A state that ``state_of`` found; atomic; FrogError when the disk does not take it."""
    arrays, values = state
    write_atomically(path, serialize(arrays, metadata={_KEY: json.dumps(values)}))


def _check_shapes(tensors: dict[str, torch.Tensor]) -> None:
    """ValueError unless there is a row for every Gaussian: native code only sees addresses."""
    count = len(tensors["model.canonical.means"])
    shapes = {"means": (count, 3), "log_scales": (count, 3), "quaternions": (count, 4), "opacity_logits": (count,)}
    sh = tensors["model.canonical.sh"]
    shapes["sh"] = (count, sh.shape[1] if sh.ndim == 3 and sh.shape[1] in (1, 4, 9, 16) else 1, 3)
    for name, shape in shapes.items():
        if tensors[f"model.canonical.{name}"].shape != shape:
            raise ValueError(f"{name} of another shape than {shape}")
    if len(tensors["model.canonical.embeddings"]) > count:
        raise ValueError("more embeddings than Gaussians")
    for name in ("gradient_sum", "seen", "peak_opacity"):
        if tensors[f"density.{name}"].shape != (count,):
            raise ValueError(f"{name} of another length than {count}")


def _parsimony_state(trainer: Trainer) -> dict[str, Any]:
    if not trainer.parsimony:
        return {}
    return {"seed": trainer.parsimony.seed, "reductions": [asdict(each) for each in trainer.parsimony.reductions]}


def checkpoint_settings(path: Path) -> dict[str, Any]:
    """What ``save_checkpoint`` was given; FrogError when the file cannot be used."""
    _, metadata = read_tensors(path, "a training checkpoint")
    try:
        return dict(json.loads(metadata[_KEY])["settings"])
    except (KeyError, ValueError, TypeError, RecursionError) as error:
        raise found_instead(path, f"contents that do not fit ({error})", "a training checkpoint") from error


def load_checkpoint(path: Path, trainer: Trainer) -> None:
    """Puts ``trainer`` (same capture, recipe and method; any device) where the checkpoint was written."""
    arrays, metadata = read_tensors(path, "a training checkpoint")
    try:
        values = json.loads(metadata[_KEY])
        if values["version"] != _VERSION:
            raise FrogError(f"{path}: found checkpoint version {values['version']}, expected {_VERSION}.")
        recipe = json.loads(json.dumps(settings_json(trainer.recipe)))
        differing = [
            key
            for key in recipe
            if values["recipe"].get(key) != recipe[key] and key not in ("name", "steps", "steps_per_moment")
        ]
        same_capture = values["shots"] == len(trainer.capture.shots)
        same_capture &= values["cameras"] == [camera.name for camera in trainer.capture.cameras]
        if values["method"] != trainer.method or differing or not same_capture:
            what = "the method" if values["method"] != trainer.method else ", ".join(differing) or "the capture"
            raise FrogError(f"{path}: belongs to another training ({what} differ); train again without resuming.")
        restore(trainer, (arrays, values))
    except (KeyError, ValueError, TypeError, AttributeError, IndexError, OverflowError, RuntimeError) as error:
        raise found_instead(path, f"contents that do not fit ({error})", "a training checkpoint") from error


def restore(trainer: Trainer, state: State) -> None:
    """Puts ``trainer`` where ``state_of`` found it, or another one of the same training.

    KeyError, ValueError, TypeError or RuntimeError for a state that does not fit.
    """
    arrays, values = state
    tensors = {name: torch.from_numpy(array.copy()) for name, array in arrays.items()}
    _check_shapes(tensors)
    for name in ATTRIBUTES:
        setattr(trainer.model.canonical, name, nn.Parameter(tensors[f"model.canonical.{name}"].to(trainer.device)))
    trainer.model.load_state_dict({name[6:]: value for name, value in tensors.items() if name.startswith("model.")})
    trainer.model.zero_grad(set_to_none=True)
    trainer.rebuild_optimizer()
    trainer.optimizer.load_state_arrays(tensors)
    trainer.optimizer.rate_factor = float(values["rate_factor"])
    for name in ("gradient_sum", "seen", "peak_opacity"):
        setattr(trainer.density, name, tensors[f"density.{name}"].to(trainer.device))
    trainer.picker.losses = tensors["losses"]
    trainer.generator.set_state(tensors["random"])
    trainer.regions.errors = [tensors[f"regions.{camera}"] for camera in range(len(trainer.capture.cameras))]
    if trainer.poses:
        trainer.poses.resume(arrays["poses"], *(arrays[f"poses.{name}"] for name in ("moments", "moved", "gathered")))
        trainer.capture = trainer.poses.capture
    trainer.neighbourhood = None
    if "neighbourhood.anchors" in tensors:
        names = ("anchors", "neighbours", "weights")
        parts = [tensors[f"neighbourhood.{name}"].to(trainer.device) for name in names]
        trainer.neighbourhood = Neighbourhood(*parts)
    if trainer.parsimony:
        rounds = values["parsimony"]
        reductions = [Reduction(**each) for each in rounds["reductions"]]
        trainer.parsimony.resume(rounds["seed"], reductions, arrays["removed"])
    if isinstance(trainer.model, Frog):
        for name in set(heads_of(trainer.model)) - set(values["heads"]):
            trainer.model.silence(name)
    trainer.resume_at(values)
