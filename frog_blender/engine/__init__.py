"""Dynamic Gaussian scenes from Python: open a capture, train, load a scene, render, evaluate.

    from frog_blender import engine as frog

    capture = frog.open_capture("walk")
    result = frog.train(capture, "walk.frog", recipe="draft", on_event=print)
    scene = frog.load_scene("walk.frog")
    image = frog.render(scene, scene.header.cameras[0], time=0.25).rgb

Names are imported when they are first used: loading and rendering a scene imports no torch. See docs/python-api.md.

``__all__`` is for who uses scenes. The other names are what methods, losses, readers and the like are made of (see
docs/extending.md and ``registry``), and what ``frog_blender.research`` stands on.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .api import CameraMetrics as CameraMetrics
    from .api import Metrics as Metrics
    from .api import TrainResult as TrainResult
    from .api import evaluate as evaluate
    from .api import load_scene as load_scene
    from .api import open_capture as open_capture
    from .api import render as render
    from .api import train as train
    from .arrays import Array as Array
    from .arrays import Floats as Floats
    from .arrays import ImageArray as ImageArray
    from .arrays import SceneArrays as SceneArrays
    from .capture.camera import Camera as Camera
    from .capture.capture import Alteration as Alteration
    from .capture.capture import Capture as Capture
    from .capture.capture import Shot as Shot
    from .capture.readers import layout_of as layout_of
    from .capture.readers.checks import checked as checked
    from .capture.video import load_opencv as load_opencv
    from .distributed.cluster import Cluster as Cluster
    from .distributed.cluster import Ended as Ended
    from .errors import FrogError as FrogError
    from .errors import printable as printable
    from .evaluation.evaluate import evaluate_images as evaluate_images
    from .evaluation.metrics import psnr_of as psnr_of
    from .evaluation.perceptual import perceptual_metrics as perceptual_metrics
    from .field.names import FORMS as FORMS
    from .field.names import FUSIONS as FUSIONS
    from .field.network import output_sizes as output_sizes
    from .frames.store import FrameStore as FrameStore
    from .gaussians import GaussianArrays as GaussianArrays
    from .gaussians import NumpyGaussians as NumpyGaussians
    from .gaussians import TorchGaussians as TorchGaussians
    from .io.atomic_files import write_atomically as write_atomically
    from .io.plain_values import JsonMapping as JsonMapping
    from .io.plain_values import JsonObject as JsonObject
    from .memory import gc_frozen as gc_frozen
    from .model.canonical import CanonicalField as CanonicalField
    from .model.interface import FINISHED as FINISHED
    from .model.interface import SceneModel as SceneModel
    from .model.interface import ScheduleState as ScheduleState
    from .model.torch_player import restored as restored
    from .native.binding import instruction_set as instruction_set
    from .playback.player import ScenePlayer as ScenePlayer
    from .playback.render import Drawing as Drawing
    from .playback.render import draw as draw
    from .rasterizer import Image as Image
    from .rasterizer import RasterizeOptions as RasterizeOptions
    from .rasterizer import rasterize as rasterize
    from .rasterizer.torch_types import Context as Context
    from .recipes import RECIPES as RECIPES
    from .recipes import SAMPLINGS as SAMPLINGS
    from .recipes import Recipe as Recipe
    from .recipes import recipe as recipe
    from .scene.scene_file import read_scene as read_scene
    from .scene.scene_file import scene_bytes as scene_bytes
    from .scene.scene_file import settings_json as settings_json
    from .srgb import linear_to_srgb as linear_to_srgb
    from .srgb import srgb_to_linear as srgb_to_linear
    from .training.methods import MOTION_UNIT as MOTION_UNIT
    from .training.methods import ModelInit as ModelInit
    from .training.methods import plain as plain
    from .training.optimize.densification import DensificationStrategy as DensificationStrategy
    from .training.optimize.densification import DensityStrategy as DensityStrategy
    from .training.optimize.device import choose_device as choose_device
    from .training.optimize.running_loss import TrainingDiverged as TrainingDiverged
    from .training.optimize.trainer import Limits as Limits
    from .training.optimize.trainer import Trainer as Trainer
    from .training.session.events import Cancelled as Cancelled
    from .training.session.events import Evaluated as Evaluated
    from .training.session.events import Event as Event
    from .training.session.events import Finished as Finished
    from .training.session.events import Progress as Progress
    from .training.session.events import Started as Started
    from .training.session.events import WarningEvent as WarningEvent
    from .training.session.export import export_scene as export_scene
    from .training.session.job import TrainingJob as TrainingJob
    from .training.session.output_paths import checkpoint_path as checkpoint_path
    from .training.session.output_paths import lock_output as lock_output
    from .training.session.run import hooks_of as hooks_of
    from .training.session.run import prepare_capture as prepare_capture
    from .training.session.run import run_training as run_training
    from .training.session.run import seeds_of as seeds_of
    from .training.session.session import Session as Session

_NAMES = {
    "api": "CameraMetrics Metrics TrainResult evaluate load_scene open_capture render train",
    "arrays": "Array Floats ImageArray SceneArrays",
    "capture.camera": "Camera",
    "capture.capture": "Alteration Capture Shot",
    "capture.readers": "layout_of",
    "capture.readers.checks": "checked",
    "capture.video": "load_opencv",
    "distributed.cluster": "Cluster Ended",
    "errors": "FrogError printable",
    "evaluation.evaluate": "evaluate_images",
    "evaluation.metrics": "psnr_of",
    "evaluation.perceptual": "perceptual_metrics",
    "field.names": "FORMS FUSIONS",
    "field.network": "output_sizes",
    "frames.store": "FrameStore",
    "gaussians": "GaussianArrays NumpyGaussians TorchGaussians",
    "io.atomic_files": "write_atomically",
    "io.plain_values": "JsonMapping JsonObject",
    "memory": "gc_frozen",
    "model.canonical": "CanonicalField",
    "model.interface": "FINISHED SceneModel ScheduleState",
    "model.torch_player": "restored",
    "native.binding": "instruction_set",
    "playback.player": "ScenePlayer",
    "playback.render": "Drawing draw",
    "rasterizer": "Image RasterizeOptions rasterize",
    "rasterizer.torch_types": "Context",
    "scene.scene_file": "read_scene scene_bytes settings_json",
    "srgb": "linear_to_srgb srgb_to_linear",
    "training.methods": "MOTION_UNIT ModelInit plain",
    "training.optimize.densification": "DensificationStrategy DensityStrategy",
    "training.optimize.device": "choose_device",
    "training.optimize.running_loss": "TrainingDiverged",
    "training.optimize.trainer": "Limits Trainer",
    "recipes": "RECIPES SAMPLINGS Recipe recipe",
    "training.session.events": "Cancelled Evaluated Event Finished Progress Started WarningEvent",
    "training.session.export": "export_scene",
    "training.session.job": "TrainingJob",
    "training.session.output_paths": "checkpoint_path lock_output",
    "training.session.run": "hooks_of prepare_capture run_training seeds_of",
    "training.session.session": "Session",
}
_HOMES = {name: module for module, names in _NAMES.items() for name in names.split()}

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
    "evaluate",
    "load_scene",
    "open_capture",
    "recipe",
    "render",
    "train",
]


def __getattr__(name: str) -> object:
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value: object = getattr(import_module(f".{_HOMES[name]}", __name__), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_HOMES})
