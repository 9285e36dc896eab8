"""A tiny scene of every kind that a ``.frog`` can hold."""

from dataclasses import replace

import torch
from support.builders import odd_camera, scene_file
from support.random_models import canonical, perturbed, scene_of

from frog_blender.engine.field.names import CANONICAL
from frog_blender.engine.scene.scene_file import SceneFile, scene_bytes
from frog_blender.research.baselines.curves import Curves, CurveSettings
from frog_blender.research.baselines.d3dgs import D3dgs, D3dgsSettings
from frog_blender.research.baselines.hexplane import HexPlane, HexPlaneSettings


def kinds() -> dict[str, SceneFile]:
    """By name; each plays."""
    plain = scene_file()
    return {
        "frog": plain,
        "moving part": scene_file(moving=13),
        "heads": scene_file(head_width=8),
        "modulated": scene_file(modulation=True, fusion="attention"),
        "ed3dgs": _as("ed3dgs", scene_file(fusion="dual")),
        "static": _still(plain),
        "imported": _imported(_still(plain)),
        "moving camera": _moving_camera(plain),
        **_baselines(),
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


def _baselines() -> dict[str, SceneFile]:
    torch.manual_seed(0)
    models = {
        "curves": Curves(canonical(15), CurveSettings((0.5, 0.5, 0.5), 0.5, 0.3, 0.5, 0.5)),
        "d3dgs": D3dgs(canonical(), D3dgsSettings(3, 8, 2, 2, 0.5)),
        "hexplane": HexPlane(canonical(), HexPlaneSettings(4, (6, 9), 5, 8, 0, 1, True, 0.5)),
    }
    return {method: scene_of(method, perturbed(model)) for method, model in models.items()}
