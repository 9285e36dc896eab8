"""Dynamic Gaussian scenes from Python: open a capture, train, load a scene, render, evaluate.

    from frog_blender import engine as frog

    capture = frog.open_capture("walk")
    result = frog.train(capture, "walk.frog", recipe="draft", on_event=print)
    scene = frog.load_scene("walk.frog")
    image = frog.render(scene, scene.header.cameras[0], time=0.25).rgb

Names are imported when they are first used: loading and rendering a scene imports no torch. See docs/python-api.md.
The imports below are for type checkers, and say from where.

``__all__`` is for who uses scenes. The other names are what methods, losses, readers and the like are made of (see
docs/extending.md and ``registry``), and what ``frog_blender.research`` stands on.
"""

# mypy: implicit-reexport

import ast
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .api import CameraMetrics, Metrics, TrainResult, evaluate, load_scene, open_capture, render, train
    from .arrays import Array, Floats, ImageArray, SceneArrays
    from .capture.camera import Camera
    from .capture.capture import Alteration, Capture, Shot
    from .capture.frame_keys import made_of
    from .capture.readers import layout_of
    from .capture.readers.checks import checked
    from .capture.video import load_opencv
    from .distributed.cluster import Cluster, Ended
    from .errors import CaptureRefused, FrogError, UsageError, in_words, named, printable, told_as
    from .evaluation.evaluate import TrueImages, evaluate_images
    from .evaluation.fly import fly_figures, read_fly
    from .evaluation.metrics import psnr_of
    from .evaluation.perceptual import perceptual_metrics
    from .field.names import FORMS, FUSIONS
    from .field.network import output_sizes
    from .frames.store import FrameStore
    from .gaussians import GaussianArrays, NumpyGaussians, TorchGaussians
    from .io.atomic_files import write_atomically
    from .io.plain_values import JsonMapping, JsonObject
    from .memory import gc_frozen
    from .model.canonical import CanonicalField
    from .model.interface import FINISHED, Deformed, SceneModel, ScheduleState, restored
    from .native.binding import instruction_set
    from .playback.player import ScenePlayer
    from .playback.render import Drawing, draw
    from .playback.render_files import render_views
    from .playback.views import View, read_cameras, views_at
    from .rasterizer import Image, RasterizeOptions, rasterize
    from .rasterizer.torch_types import Context
    from .recipes import RECIPES, SAMPLINGS, Recipe, recipe
    from .scene.scene_file import read_scene, scene_bytes, settings_json
    from .srgb import linear_to_srgb, srgb_to_linear
    from .training.methods import MOTION_UNIT, ModelInit, plain
    from .training.optimize.densification import DensificationStrategy, DensityStrategy
    from .training.optimize.device import choose_device
    from .training.optimize.trainer import Trainer
    from .training.optimize.training import TrainingDiverged
    from .training.session.checkpoint import checkpoint_settings
    from .training.session.events import (
        Cancelled,
        Evaluated,
        Event,
        Finished,
        Preview,
        Progress,
        Started,
        Statistics,
        WarningEvent,
    )
    from .training.session.export import export_scene
    from .training.session.job import TrainingJob
    from .training.session.output_paths import checkpoint_path, lock_output
    from .training.session.run import add_hooks, prepare_capture, run_training, seeds_of
    from .training.session.session import Session


def _homes(source: str) -> dict[str, str]:
    """The module of each name that is imported in this file."""
    imports = (node for node in ast.walk(ast.parse(source)) if isinstance(node, ast.ImportFrom) and node.level)
    return {name.name: str(node.module) for node in imports for name in node.names}


_HOMES = _homes(Path(__file__).read_text(encoding="utf-8"))

__all__ = [
    "Camera",
    "CameraMetrics",
    "Capture",
    "Drawing",
    "FrogError",
    "GaussianArrays",
    "Metrics",
    "Recipe",
    "ScenePlayer",
    "Shot",
    "TrainResult",
    "View",
    "evaluate",
    "load_scene",
    "open_capture",
    "read_cameras",
    "recipe",
    "render",
    "render_views",
    "train",
    "views_at",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
