"""The scenes that the rasterizer benchmark draws: generated ones of fixed seed, stored ones.

A generated scene looks to a rasterizer like a trained one: a wavy shell in front, the ground, a far shell and floaters,
log-normal sizes, mostly faint opacities, spherical harmonics of degree 3.  Sizes shrink with the root of the number, so
that a pixel of the ``standard`` scenes blends about a hundred Gaussians whether there are ten thousand or a million.
In the ``sweep`` the image grows with the number instead, and with it the work: pairs are proportional to Gaussians.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.errors import found_instead
from frog_blender.engine.gaussians import GaussianArrays

SEED = 1234
FOCAL_LENGTH = 0.85  # in image widths
BACKGROUND = (0.1, 0.2, 0.3)
NEAREST = 0.4  # world units; not every rasterizer has a near plane
_ARRAYS = ("means", "scales", "quats", "opac", "sh", "view", "K", "W", "H", "bg", "v_out", "v_alpha")


@dataclass(frozen=True)
class Recipe:
    """What a generated scene consists of: how many Gaussians, how large an image (pixels), how large the Gaussians."""

    gaussians: int
    width: int
    height: int
    size: float = 1.5


RECIPES = {
    "tiny": Recipe(1_000, 160, 120),
    "10k_s": Recipe(10_000, 320, 240),
    "100k_s": Recipe(100_000, 320, 240),
    "10k_b": Recipe(10_000, 1352, 1014),
    "100k_b": Recipe(100_000, 1352, 1014),
    "1M_b": Recipe(1_000_000, 1352, 1014, 0.75 * 1.5),
    "sweep_10k": Recipe(10_000, 320, 240),
    "sweep_32k": Recipe(31_623, 569, 427),
    "sweep_100k": Recipe(100_000, 1012, 759),
    "sweep_316k": Recipe(316_228, 1800, 1350),
    "sweep_1M": Recipe(1_000_000, 3200, 2400),
}
STANDARD = ("10k_s", "100k_s", "10k_b", "100k_b", "1M_b")
SWEEP = tuple(name for name in RECIPES if name.startswith("sweep"))
GROUPS = {"standard": STANDARD, "sweep": SWEEP}


@dataclass(frozen=True)
class Scene:
    """What is drawn, and what is sent back through the drawing.

    Attributes:
        gaussians: float32 numpy arrays.
        camera: the view.
        background: three display-referred numbers.
        by_rgb, by_alpha: (H, W, 3) and (H, W) float32, dL/drgb and dL/dalpha.
    """

    gaussians: GaussianArrays
    camera: Camera
    background: tuple[float, float, float]
    by_rgb: np.ndarray
    by_alpha: np.ndarray


def generate(recipe: Recipe, seed: int = SEED) -> Scene:
    """The scene of a recipe: the same arrays for the same seed."""
    random, count = np.random.default_rng(seed), recipe.gaussians
    world_to_camera = _slightly_turned()
    means = random.permutation(_positions(random, count))
    common, by_axis = random.normal(size=(count, 1)), random.normal(size=(count, 3))
    log_scales = np.log(recipe.size * 0.052 * np.sqrt(1e4 / count)) + 0.6 * common + 0.55 * by_axis
    scales = np.exp(log_scales) * np.where(means[:, 2:] > 6.5, 2.0, 1.0)  # far ones are larger, as trained ones are
    quaternions = random.normal(size=(count, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    opacities = 1 / (1 + np.exp(-(random.normal(size=count) * 1.6 - 2.2)))  # median 0.1, up to 0.95
    sh = np.zeros((count, 16, 3), np.float32)
    sh[:, 0] = random.normal(size=(count, 3)) * 0.6 + 0.1
    sh[:, 1:] = random.normal(size=(count, 15, 3)) * 0.08

    depths = means @ world_to_camera[2, :3].astype(np.float32) + np.float32(world_to_camera[2, 3])
    means[~(depths > NEAREST)] = 0, 0, 6
    width, height, focal = recipe.width, recipe.height, FOCAL_LENGTH * recipe.width
    intrinsics = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]], np.float32)
    return Scene(
        GaussianArrays(means, quaternions, scales, opacities, sh).checked(),
        Camera("benchmark", width, height, intrinsics, world_to_camera.astype(np.float32)),
        BACKGROUND,
        *_image_gradients(random, width, height),
    )


def _positions(random: np.random.Generator, count: int) -> np.ndarray:
    """(count, 3) float32: 45 % wavy shell, 20 % ground, 20 % far shell, the rest floaters, in this order."""
    shell, ground, far = int(count * 0.45), int(count * 0.2), int(count * 0.2)
    floaters = count - shell - ground - far
    directions = random.normal(size=(shell, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    waves = 0.25 * np.sin(5 * directions[:, :1]) * np.cos(4 * directions[:, 1:2])
    radii = 1.0 + waves + 0.02 * random.normal(size=(shell, 1))
    in_shell = directions * radii * [1.3, 1.0, 1.0] + [0, 0.1, 4.0]
    x, y, z = random.uniform(-4, 4, ground), random.normal(size=ground), random.uniform(1.5, 9, ground)
    on_ground = np.stack([x, 1.3 + 0.03 * y, z], 1)
    z = random.uniform(7, 10, far)
    behind = np.stack([random.uniform(-0.7, 0.7, far) * z, random.uniform(-0.6, 0.4, far) * z, z], 1)
    z = random.uniform(0.8, 9, floaters)
    around = np.stack([random.uniform(-0.65, 0.65, floaters) * z, random.uniform(-0.5, 0.5, floaters) * z, z], 1)
    return np.concatenate([in_shell, on_ground, behind, around]).astype(np.float32)


def _slightly_turned() -> np.ndarray:
    """(4, 4) world to camera: neither its rotation nor its translation is trivial."""
    (sin_a, sin_b), (cos_a, cos_b) = np.sin([0.07, -0.05]), np.cos([0.07, -0.05])
    about_x = np.array([[1, 0, 0], [0, cos_b, -sin_b], [0, sin_b, cos_b]])
    about_y = np.array([[cos_a, 0, sin_a], [0, 1, 0], [-sin_a, 0, cos_a]])
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = about_x @ about_y
    world_to_camera[:3, 3] = 0.1, -0.05, 0.2
    return world_to_camera


def _image_gradients(random: np.random.Generator, width: int, height: int) -> tuple[np.ndarray, np.ndarray]:
    pixels = height * width
    by_rgb = random.normal(size=(height, width, 3)).astype(np.float32) / pixels
    return by_rgb, random.normal(size=(height, width)).astype(np.float32) / pixels


def save(path: Path, scene: Scene) -> None:
    """Writes an .npz: means, scales, quats, opac, sh, view (4, 4), K (3, 3), W, H, bg, v_out, v_alpha."""
    g, camera = scene.gaussians, scene.camera
    values = (g.means, g.scales, g.quaternions, g.opacities, g.sh, camera.world_to_camera, camera.intrinsics)
    size = (camera.width, camera.height)
    np.savez(path, **dict(zip(_ARRAYS, (*values, *size, scene.background, scene.by_rgb, scene.by_alpha), strict=True)))


def load(path: Path) -> Scene:
    """A scene that ``save`` wrote; FrogError in one sentence when the file is something else."""
    if not path.is_file():
        raise found_instead(path, "no file", "an .npz scene")
    try:
        with np.load(path) as file:
            missing = [name for name in _ARRAYS if name not in file.files]
            if missing:
                raise found_instead(path, f"no array {missing[0]!r}", f"an .npz scene with {', '.join(_ARRAYS)}")
            data: dict[str, Any] = {name: file[name] for name in _ARRAYS}
        width, height = int(data["W"]), int(data["H"])
        gaussians = GaussianArrays(*(data[name] for name in ("means", "quats", "scales", "opac", "sh"))).checked()
        camera = Camera("benchmark", width, height, data["K"], data["view"])
        red, green, blue = (float(value) for value in data["bg"])
        by_rgb = np.ascontiguousarray(data["v_out"], np.float32).reshape(height, width, 3)
        by_alpha = np.ascontiguousarray(data["v_alpha"], np.float32).reshape(height, width)
    except (OSError, ValueError, TypeError, AttributeError, EOFError, zipfile.BadZipFile) as error:
        raise found_instead(path, f"something that cannot be read ({error})", "an .npz scene") from error
    return Scene(gaussians, camera, (red, green, blue), by_rgb, by_alpha)
