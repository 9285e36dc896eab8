"""Builders that the engine's tests share: cameras, random Gaussians, small scene files, a second interpreter."""

import os
import re
import subprocess
import sys
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import replace
from itertools import combinations, product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

from frog_blender.engine.capture.camera import Camera, rotation_about
from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.frame_delta import canonical_arrays
from frog_blender.engine.scene.header import SceneHeader
from frog_blender.engine.scene.scene_file import SceneFile
from frog_blender.engine.spherical_harmonics import SH_DC

REPOSITORY = Path(__file__).resolve().parents[2]
Run = Callable[..., tuple[int, str, str]]
"""The fixture ``run``: arguments of ``frog`` to its exit status and what it says, on standard output and error."""


def pairwise(*choices: Iterable[Any]) -> list[tuple[Any, ...]]:
    """Few combinations, the same each time, that hold every pair of values of any two of the parameters."""

    def pairs(combination: tuple[Any, ...]) -> set[tuple[Any, ...]]:
        return set(combinations(enumerate(combination), 2))

    values = [list(choice) for choice in choices]
    candidates = list(product(*(range(len(choice)) for choice in values)))
    missing = set[tuple[Any, ...]]().union(*map(pairs, candidates))
    chosen = []
    while missing:
        best = max(candidates, key=lambda candidate: len(pairs(candidate) & missing))
        missing -= pairs(best)
        chosen.append(tuple(options[index] for options, index in zip(values, best, strict=True)))
    return chosen


def result_of(steps: Generator[Any, None, Any]) -> tuple[Any, list[Any]]:
    """What a generator returns, and what it yielded."""
    said: list[Any] = []
    while True:
        try:
            said.append(next(steps))
        except StopIteration as end:
            return end.value, said


def refused(match: str, call: Callable[..., object], /, *arguments: Any, **options: Any) -> str:
    """The sentence of the FrogError that a call raises: one, on one line, in which the pattern is found."""
    with pytest.raises(FrogError, match=match) as caught:
        call(*arguments, **options)
    assert re.fullmatch(r".*[.?]", str(caught.value)), "it is no sentence"
    return str(caught.value)


def refuses(match: str, operator: Callable[..., object], /, *arguments: Any, **options: Any) -> str:
    """What Blender raises of the error that an operator, or a render, reports; the pattern is found in it."""
    with pytest.raises(RuntimeError, match=match) as caught:
        operator(*arguments, **options)
    return str(caught.value)


def until(condition: Callable[[], object]) -> None:
    """Waits for what another thread or process does."""
    deadline = time.monotonic() + 60
    while not condition():
        assert time.monotonic() < deadline, "it never came to that"
        time.sleep(0.01)


def rotation_of(axis: tuple[float, float, float], angle: float) -> np.ndarray:
    """(3, 3) rotation about an axis by radians."""
    return rotation_about(angle * np.array(axis) / np.linalg.norm(axis))


def plain_camera(width: int = 32, height: int = 32, focal: float = 40.0) -> Camera:
    """At the origin, looking along +z, the principal point in the middle."""
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera("plain", width, height, intrinsics, np.eye(4))


def odd_camera(width: int = 45, height: int = 27) -> Camera:
    """Rotated about no axis of the world, with an off-centre principal point and two focal lengths."""
    intrinsics = np.array([[41.0, 0, 0.37 * width], [0, 36.0, 0.61 * height], [0, 0, 1]])
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = rotation_of((0.3, -1.0, 0.5), 0.9)
    world_to_camera[:3, 3] = 0.4, -0.7, 1.1
    return Camera("odd", width, height, intrinsics, world_to_camera)


def looking_at(
    name: str,
    eye: ArrayLike,
    size: tuple[int, int],
    intrinsics: np.ndarray,
    target: ArrayLike = (0.0, 0.0, 0.0),
    up: ArrayLike = (0.0, 0.0, 1.0),
) -> Camera:
    """A level camera at ``eye`` that looks at a target, in a world in which ``up`` is up."""
    forward = np.subtract(target, eye)
    forward = forward / np.linalg.norm(forward)
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    rotation = np.stack([right, np.cross(forward, right), forward])
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3], world_to_camera[:3, 3] = rotation, -rotation @ np.array(eye)
    return Camera(name, *size, intrinsics, world_to_camera)


def steps_between(points: np.ndarray) -> float:
    """Mean distance from one to the next."""
    return float(np.linalg.norm(np.diff(points, axis=0), axis=1).mean())


def random_gaussians(
    camera: Camera, count: int, degree: int = 3, seed: int = 0, opacity: tuple[float, float] = (0.05, 0.95)
) -> GaussianArrays:
    """Float64 Gaussians spread over what the camera sees and a little beyond, quaternions of any length."""
    random = np.random.default_rng(seed)
    depths = random.uniform(1.5, 5.0, count)
    pixels = random.uniform(-0.1, 1.1, (count, 2)) * [camera.width, camera.height]
    local = np.concatenate([pixels, np.ones((count, 1))], 1) @ np.linalg.inv(camera.intrinsics).T * depths[:, None]
    sh = random.normal(0, 0.15, (count, (degree + 1) ** 2, 3))
    sh[:, 0] = random.uniform(-0.6, 1.6, (count, 3))
    return GaussianArrays(
        (local - camera.world_to_camera[:3, 3]) @ camera.rotation,
        random.normal(size=(count, 4)) * random.uniform(0.3, 3.0, (count, 1)),
        np.exp(random.uniform(np.log(0.03), np.log(0.4), (count, 3))),
        random.uniform(*opacity, count),
        sh,
    )


def blobs(
    means: ArrayLike,
    scales: ArrayLike = 0.1,
    *,
    colors: ArrayLike = 0.5,
    opacities: ArrayLike = 0.9,
    turns: ArrayLike = (1.0, 0.0, 0.0, 0.0),
) -> GaussianArrays:
    """Float32 Gaussians of degree 0 at (N, 3) and of display-referred colours; all but the places of each or of all."""

    def of_all(values: ArrayLike, *width: int) -> np.ndarray:
        return np.broadcast_to(np.float32(values), (len(means), *width)).copy()

    sh = (of_all(colors, 3) - 0.5) / SH_DC
    return GaussianArrays(np.float32(means), of_all(turns, 4), of_all(scales, 3), of_all(opacities), sh[:, None])


def one_gaussian(mean: tuple[float, float, float], **changes: object) -> GaussianArrays:
    """A single grey Gaussian of degree 0, 0.1 wide, with attributes replaced by name."""
    values: dict[str, object] = {
        "means": [mean],
        "quaternions": [[1.0, 0, 0, 0]],
        "scales": [[0.1, 0.1, 0.1]],
        "opacities": [0.8],
        "sh": [[[0.5, 0.5, 0.5]]],
    }
    return GaussianArrays(**{name: np.array(value, np.float64) for name, value in {**values, **changes}.items()})


MODEL = {
    "temporal_rows": 6,
    "coarse_rows": 3,
    "temporal_size": 8,
    "embedding_size": 8,
    "hidden_width": 24,
    "head_width": 0,
    "deformed_sh": 1,
    "opacity_reduction": "unit",
    "opacity_sharpness": 10.0,
    "motion_unit": 0.5,
}
"""Model settings of a small scene."""


def scene_header(cameras: Sequence[Camera], frames: int, **said: Any) -> SceneHeader:
    """Of a scene that cameras see at all frames, with a low-pass as trained ones have, and what else it is to say."""
    shots = (tuple(range(frames)),) * len(cameras)
    plain = SceneHeader(
        "frog", {}, MODEL, tuple(cameras), shots, (), (), frames, 24.0, (0.1, 0.2, 0.3), "", "n3dv", 1.0
    )
    return replace(plain, **{"low_pass": 0.1, **said})


def still_scene(gaussians: GaussianArrays, cameras: Sequence[Camera], frames: int = 1, **said: Any) -> SceneFile:
    """A scene of Gaussians that do not move, see ``scene_header``."""
    said = {"method": "static", "model": {}, "low_pass": gaussians.low_pass, **said}
    return SceneFile(scene_header(cameras, frames, **said), canonical_arrays(gaussians))


def scene_file(
    count: int = 40, seed: int = 0, sh_count: int = 4, moving: int | None = None, **model: object
) -> SceneFile:
    """A random scene that moves (all of it, or the first ``moving`` Gaussians), turns, fades and tints, seen by three
    cameras over seven frames."""
    random = np.random.default_rng(seed)
    camera = odd_camera()
    gaussians = random_gaussians(camera, count, int(sh_count**0.5) - 1, seed)
    settings = {**MODEL, **model}
    sizes = [3, 3, 4, 1] + [3 * settings["deformed_sh"]] * bool(settings["deformed_sh"])
    networks = 2 if settings.get("fusion") == "dual" else 1
    given = settings["temporal_size"] * (2 if settings.get("fusion") == "concat" else 1)
    hidden, heads, outputs = settings["hidden_width"], settings["head_width"], sum(sizes)
    arrays = {
        **canonical_arrays(gaussians),
        "embeddings": random.normal(size=(count if moving is None else moving, settings["embedding_size"])),
        "temporal_table": random.normal(1.0, 0.3, (settings["temporal_rows"], settings["temporal_size"])),
        "network.embedding_weight": random.normal(0, 0.4, (networks * hidden, settings["embedding_size"])),
        "network.temporal_weight": random.normal(0, 0.4, (networks * hidden, given)),
        "network.bias": random.normal(0, 0.2, networks * hidden),
        "network.output_weight": random.normal(0, 0.08, (outputs, networks * (heads or hidden))),
        "network.output_bias": random.normal(0, 0.02, outputs),
    }
    if settings.get("modulation"):
        arrays["network.modulation_weight"] = random.normal(0, 0.4, (networks * hidden, settings["embedding_size"]))
    if heads:
        arrays["network.head_weight"] = random.normal(0, 0.3, (networks * heads * len(sizes), hidden))
        arrays["network.head_bias"] = random.normal(0, 0.2, networks * heads * len(sizes))
    if settings.get("fusion") == "attention":
        arrays["attention_weight"] = random.normal(0, 0.5, (16, settings["temporal_size"]))
        arrays["attention_query"] = random.normal(0, 0.5, 16)
    said = {"recipe": {"name": "test"}, "test_cameras": ("odd",), "capture_path": "nowhere"}
    header = scene_header((camera, plain_camera(), plain_camera(40, 24)), 7, model=settings, **said)
    return SceneFile(header, {name: np.ascontiguousarray(array, np.float32) for name, array in arrays.items()})


def printed(done: subprocess.CompletedProcess[str]) -> str:
    """What a program printed, which has to have ended well."""
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


def run_benchmark(name: str, *arguments: object) -> str:
    """What a script of ``benchmarks/`` prints."""
    command = [sys.executable, str(REPOSITORY / "benchmarks" / name), *map(str, arguments)]
    return printed(subprocess.run(command, capture_output=True, text=True, timeout=120, check=False))


def run_python(code: str, *arguments: object, **environment: str) -> subprocess.CompletedProcess[str]:
    """Runs code in an interpreter of its own, in the repository; read ``returncode``, ``stdout`` and ``stderr``."""
    return subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        cwd=REPOSITORY,
        env={**os.environ, "PYTHONPATH": f"{REPOSITORY}{os.pathsep}{REPOSITORY / 'tests'}", **environment},
        capture_output=True,
        text=True,
        timeout=300,
    )
