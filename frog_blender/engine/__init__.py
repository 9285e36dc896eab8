"""Dynamic Gaussian scenes from Python: open a capture, train, load a scene, render, evaluate.

    from frog_blender import engine as frog

    capture = frog.open_capture("walk")
    result = frog.train(capture, "walk.frog", recipe="draft", on_event=print)
    scene = frog.load_scene("walk.frog")
    image = frog.render(scene, scene.header.cameras[0], time=0.25).rgb

Names are imported when they are first used: loading and rendering a scene imports no torch. See docs/python-api.md.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .api import CameraMetrics, Metrics, TrainResult, evaluate, load_scene, open_capture, render, train
    from .capture.camera import Camera
    from .capture.capture import Capture, Shot
    from .errors import FrogError
    from .gaussians import GaussianArrays
    from .playback.player import ScenePlayer
    from .playback.render import Drawing
    from .recipes import Recipe, recipe

_HOMES = {
    "Camera": "capture.camera",
    "CameraMetrics": "api",
    "Capture": "capture.capture",
    "Drawing": "playback.render",
    "FrogError": "errors",
    "GaussianArrays": "gaussians",
    "Metrics": "api",
    "Recipe": "recipes",
    "ScenePlayer": "playback.player",
    "Shot": "capture.capture",
    "TrainResult": "api",
    "evaluate": "api",
    "load_scene": "api",
    "open_capture": "api",
    "recipe": "recipes",
    "render": "api",
    "train": "api",
}

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
    return sorted({*globals(), *__all__})
