"""A tiny scene of every kind that a ``.frog`` can hold, made without torch."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from support.builders import odd_camera, scene_file

from frog_blender.engine.field.names import CANONICAL
from frog_blender.engine.scene.scene_file import SceneFile, scene_bytes

_SCENES_OWN = ("means", "log_scales", "quaternions", "opacity_logits", "sh")


def kinds() -> dict[str, SceneFile]:
    """By name; each plays."""
    plain = scene_file()
    mask = {"lifetimes": np.full((6, 1), 0b10100000, np.uint8)}  # the second of three groups is never seen
    return {
        "frog": plain,
        "moving part": scene_file(moving=13),
        "heads": scene_file(head_width=8),
        "modulated": scene_file(modulation=True, fusion="attention"),
        "ed3dgs": _as("ed3dgs", scene_file(fusion="dual")),
        "lifetimes": SceneFile(plain.header, plain.arrays | mask),
        "static": _still(plain),
        "imported": _imported(_still(plain)),
        "moving camera": _moving_camera(plain),
        "curves": _curves(plain),
        "d3dgs": _d3dgs(plain),
        "hexplane": _hexplane(plain),
    }


def whole_files(scenes: dict[str, SceneFile]) -> list[bytes]:
    """Each as a lossless and as a packed file."""
    return [scene_bytes(scene, compact=compact) for scene in scenes.values() for compact in (False, True)]


def _as(method: str, scene: SceneFile, **model: object) -> SceneFile:
    return SceneFile(replace(scene.header, method=method, model=model or scene.header.model), scene.arrays)


def _still(scene: SceneFile) -> SceneFile:
    arrays = {name: array for name, array in scene.arrays.items() if name in CANONICAL}
    return SceneFile(replace(scene.header, method="static", model={}), arrays)


def _imported(scene: SceneFile) -> SceneFile:
    alone = {"cameras": (), "camera_shots": (), "test_cameras": (), "frame_count": 1, "capture_format": "ply"}
    return SceneFile(replace(scene.header, **alone), scene.arrays)


def _moving_camera(scene: SceneFile) -> SceneFile:
    per_frame = tuple(replace(odd_camera(45 + frame), name=f"frame {frame}") for frame in range(7))
    shots = tuple((frame,) for frame in range(7))
    header = replace(scene.header, cameras=per_frame, camera_shots=shots, test_cameras=(), test_frames=(3,))
    return SceneFile(header, scene.arrays)


def _random(seed: int, **shapes: tuple[int, ...]) -> dict[str, np.ndarray]:
    random = np.random.default_rng(seed)
    return {f"network.{name}": random.normal(0, 0.2, shape).astype(np.float32) for name, shape in shapes.items()}


def _curves(scene: SceneFile) -> SceneFile:
    arrays = {name: scene.arrays[name] for name in _SCENES_OWN}
    arrays["embeddings"] = np.random.default_rng(0).normal(size=(len(arrays["means"]), 15)).astype(np.float32)
    units = {"motion_units": [0.5, 0.5, 0.5], "rotation_unit": 0.5, "centre_unit": 0.3, "width_unit": 0.5}
    return _as("curves", SceneFile(scene.header, arrays), **units, first_width=0.5)


def _d3dgs(scene: SceneFile) -> SceneFile:
    width, place, time = 8, 3 + 6 * 2, 1 + 2 * 2
    inputs = [place + time, width, width + place + time]
    shapes: dict[str, tuple[int, ...]] = {"output.weight": (10, width), "output.bias": (10,)}
    for layer, size in enumerate(inputs):
        shapes |= {f"layers.{layer}.weight": (width, size), f"layers.{layer}.bias": (width,)}
    network = _random(1, **shapes)
    network |= {"network.origin": np.zeros(3, np.float32), "network.extent": np.ones(3, np.float32)}
    arrays = {name: scene.arrays[name] for name in _SCENES_OWN} | network
    sizes = {"depth": len(inputs), "width": width, "space_frequencies": 2, "time_frequencies": 2}
    return _as("d3dgs", SceneFile(scene.header, arrays), **sizes, motion_unit=0.5)


def _hexplane(scene: SceneFile) -> SceneFile:
    channels, rows, hidden, resolutions = 4, 5, 8, [6, 9]
    outputs = 3 + 3 + 4 + 1 + 3
    shapes: dict[str, tuple[int, ...]] = {
        "first.weight": (hidden, channels * len(resolutions)),
        "first.bias": (hidden,),
        "second.weight": (hidden, hidden),
        "second.bias": (hidden,),
        "output_weight": (outputs, hidden),
        "output_bias": (outputs,),
    }
    for number, size in enumerate(resolutions):
        shapes[f"space_planes.{number}"] = (3, channels, size, size)
        shapes[f"time_planes.{number}"] = (3, channels, rows, size)
    network = _random(2, **shapes)
    network |= {"network.origin": np.full(3, -5, np.float32), "network.extent": np.full(3, 10, np.float32)}
    arrays = {name: scene.arrays[name] for name in _SCENES_OWN} | network
    sizes = {"channels": channels, "time_rows": rows, "hidden_width": hidden, "head_width": 0}
    settings = {"resolutions": resolutions, "deformed_sh": 1, "deformed_opacity": True, "motion_unit": 0.5}
    return _as("hexplane", SceneFile(scene.header, arrays), **sizes, **settings)
