"""Times a whole training step on a GPU in several ways, all in one run.

    python benchmarks/gpu_step.py [--capture DIR] [--counts 20000 100000 300000 1000000] [--steps 100] [--scale S]
                                  [--ways ours before gsplat] [--scene 100k_b] [--device cuda]

"ours" is the step as it is. "before" is the same step of torch's own operations around our rasterizer: the field by
automatic differentiation, torch's loss, torch's Adam. "gsplat" is "before" with gsplat's rasterizer in place of ours.

One JSON object a run. Milliseconds: the median of steps that are waited for one by one, and the mean of steps that are
not, which is how a training runs. "regions" are steps as the recipes take them, most of them on a part of an image;
"whole" are steps on whole images. No rounds: the number of Gaussians stays as it is, and the same images are drawn
in every run. Without a capture, images of a generated scene are learned.
"""

from __future__ import annotations

import argparse
import gc
import json
import math
import statistics
import sys
import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

import numpy as np
import raster_scenes
import torch

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.capture.capture import Capture, Shot
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.seeds import Seeds, SeedSettings
from frog_blender.engine.cuda import launch
from frog_blender.engine.frames.image_coding import halved_image
from frog_blender.engine.frames.seed_store import stored_seeds
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.options import JobOptions
from frog_blender.engine.rasterizer import Backend, GaussianArrays, Image, RasterizeOptions, rasterize
from frog_blender.engine.recipes import recipe
from frog_blender.engine.registry import RASTERIZERS
from frog_blender.engine.training.optimize import initialization, neighbours
from frog_blender.engine.training.optimize.trainer import Trainer

WARM_UP = 20  # steps that are not counted; kernels are compiled in the first ones
CAMERAS, FRAMES = 4, 5  # of the generated capture
ROW, SPACING = 5, 0.15  # cameras side by side, and world units between them
SWING_FRAMES = 100  # of one swing, at least
SEEDS = 40_000  # that are sought in a capture's images; more are made of them
SH_DC = 0.28209479177387814


class Material(NamedTuple):
    """What is learned: a capture, its images (a FrameStore or the like) and seed points.

    ``spacings`` (N,) float32 are the points' distances to their neighbours: found once on the CPU, since a GPU takes a
    minute for a million in every trainer.
    """

    capture: Capture
    store: Any
    seeds: Seeds
    spacings: torch.Tensor | None = None

    def resampled(self, count: int) -> Material:
        """The same with exactly so many seed points."""
        seeds = resampled(self.seeds, count)
        return Material(self.capture, self.store, seeds, neighbours.spacings(torch.from_numpy(seeds.points)))


class Images:
    """Drawn images in place of a FrameStore; those of half their size are kept once they are made."""

    is_large = False

    def __init__(self, images: list[np.ndarray]) -> None:
        self._images = images
        self._halves: dict[int, np.ndarray] = {}

    def image(self, shot_index: int) -> np.ndarray:
        """(H, W, 3) uint8."""
        return self._images[shot_index]

    def part(self, shot_index: int, region: tuple[int, int, int, int], is_half: bool = False) -> np.ndarray:
        """A region (left, top, width, height) of an image, or of the one of half its size."""
        image, (left, top, width, height) = self._images[shot_index], region
        if is_half:
            if shot_index not in self._halves:
                self._halves[shot_index] = halved_image(image)
            image = self._halves[shot_index]
        return image[top : top + height, left : left + width]

    def prefetch(self, shot_index: int, region: tuple[int, int, int, int], is_half: bool = False) -> None:
        """Nothing is to be read."""


@torch.no_grad()
def generated(
    name: str, device: str, cameras: int = CAMERAS, frames: int = FRAMES, seconds: float = math.inf
) -> Material:
    """A benchmark scene whose shell swings to and fro, as so many cameras see it; the first one is held out.

    Args:
        frames: as many as there is time for.
        seconds: after which no more frames are drawn.
    """
    scene = raster_scenes.generate(raster_scenes.RECIPES[name])
    g = scene.gaussians
    tensors = [torch.tensor(array, device=device) for array in (g.means, g.quaternions, g.scales, g.opacities, g.sh)]
    moving = torch.linalg.vector_norm(tensors[0] - tensors[0].new_tensor([0.0, 0.1, 4.0]), dim=1) < 1.5
    views = [moved(scene.camera, number) for number in range(cameras)]
    shots, images, frame, started = list[Shot](), list[np.ndarray](), 0, time.monotonic()
    while frame < frames and (frame < 2 or time.monotonic() - started < seconds):
        swing = 0.2 * math.sin(2 * math.pi * frame / min(frames, SWING_FRAMES))
        means = tensors[0] + swing * moving[:, None] * tensors[0].new_tensor([1.0, 0.0, 0.0])
        for number, camera in enumerate(views):
            rgb = rasterize(GaussianArrays(means, *tensors[1:]), camera, scene.background).rgb
            images.append((rgb.clamp(0, 1) * 255 + 0.5).to(torch.uint8).cpu().numpy())
            shots.append(Shot(number, frame, Path("generated"), frame))
        frame += 1
    capture = Capture(
        path=Path("generated"),
        format="generated",
        cameras=tuple(views),
        distortions=(None,) * cameras,
        shots=tuple(shots),
        frame_count=frame,
        test_cameras=frozenset({views[0].name}),
        frames_per_second=30.0,
        background=scene.background,
    )
    seeds = Seeds(g.means, (g.sh[:, 0] * SH_DC + 0.5).clip(0, 1), "generated")
    return Material(capture, Images(images), seeds)


def moved(camera: Camera, number: int) -> Camera:
    """The camera of this number, in rows of ROW around the scene's own."""
    view = camera.world_to_camera.copy()
    view[0, 3] += SPACING * (number % ROW - ROW // 2)
    view[1, 3] += SPACING * (number // ROW) * (-1) ** (number // ROW)
    return replace(camera, name=f"cam{number}", world_to_camera=view)


def filmed(folder: Path, scale: float | None) -> Material:
    """A capture with its frames."""
    capture = open_capture(folder)
    if scale:
        capture = capture.scaled(scale)
    store = FrameStore.open(capture)
    return Material(capture, store, stored_seeds(capture, store, SeedSettings(SEEDS)))


def resampled(seeds: Seeds, count: int) -> Seeds:
    """Exactly ``count`` seed points: some of them, or all and more beside them."""
    random, found = np.random.default_rng(0), len(seeds.points)
    if count <= found:
        chosen, shift = random.choice(found, count, replace=False), np.zeros((count, 3))
    else:
        chosen = np.concatenate([np.arange(found), random.integers(found, size=count - found)])
        shift = random.normal(scale=0.01, size=(count, 3)) * seeds.points.std(0) * (np.arange(count) >= found)[:, None]
    points = (seeds.points[chosen] + shift).astype(np.float32)
    return Seeds(points, np.ascontiguousarray(seeds.colors[chosen], np.float32), seeds.origin)


class _Screen:
    """Where the density control finds gsplat's gradient of the pixel positions (N, 2)."""

    def __init__(self, means2d: torch.Tensor) -> None:
        self._means2d = means2d

    @property
    def grad(self) -> torch.Tensor | None:
        gradient = self._means2d.grad
        return None if gradient is None else gradient.reshape(-1, 2)


def gsplat_rasterize(
    gaussians: GaussianArrays,
    camera: Camera,
    background: tuple[float, float, float],
    options: RasterizeOptions,
    pose: torch.Tensor | None = None,
) -> Image:
    """A backend of ``rasterizer.rasterize``: gsplat. Its poses get no gradients here."""
    from gsplat import rasterization

    if pose is not None:
        raise ValueError("found a pose, expected an ordinary image for gsplat")
    device = gaussians.means.device
    camera = camera.cropped(*options.region_of(camera))
    rgb, alpha, info = rasterization(
        gaussians.means,
        gaussians.quaternions,
        gaussians.scales,
        gaussians.opacities,
        gaussians.sh,
        torch.tensor(camera.world_to_camera, device=device, dtype=torch.float32)[None],
        torch.tensor(camera.intrinsics, device=device, dtype=torch.float32)[None],
        camera.width,
        camera.height,
        sh_degree=gaussians.sh_degree,
        near_plane=options.near_plane,
        eps2d=gaussians.low_pass,
        packed=False,
        backgrounds=torch.tensor([background], device=device, dtype=torch.float32),
    )
    means2d, radii = info["means2d"], info["radii"][0]
    if means2d.requires_grad:
        means2d.retain_grad()
    radii = radii.amax(-1) if radii.dim() == 2 else radii  # newer versions: one for each axis
    screen: Any = _Screen(means2d)
    return Image(rgb[0], alpha[0, ..., 0], radii, screen)


WAYS = ("ours", "before", "gsplat")


class TorchAdam(torch.optim.Adam):
    """Torch's, in the place of ours."""

    def step(self, *_: object, **__: object) -> None:  # type: ignore[override]
        """What ours is told of the drawing is not known here."""
        super().step()


def of_torch_alone(name: str) -> AbstractContextManager[object]:
    """A block in which trainings are made and run without kernels of our own, but the rasterizer's, where the way
    ``name`` asks for that."""
    return nullcontext() if name == "ours" else mock.patch.object(launch, "on_gpu", lambda tensor: False)


def settled_trainer(material: Material, name: str, region_share: float, device: str) -> Trainer:
    """A training whose steps go the way ``name``, without end and without rounds; within ``of_torch_alone``."""
    capture, store, seeds, spacings = material
    still = {"densify_from": 2.0, "sampling": "off", "warm_up": 0.0, "dssim_from": 0.0, "half_size_until": 0.0}
    arrived = {"sh_growth": (0.0, 0.0, 0.0), "opacity_ramp": (0.0, 0.0), "fine_rows_until": 0.0}  # as at the end
    settings = recipe("standard", **still, **arrived, region_share=region_share)
    settings = replace(settings, max_gaussians=max(len(seeds.points), settings.max_gaussians))
    found = (
        nullcontext()
        if spacings is None
        else mock.patch.object(initialization, "spacings", lambda points: spacings.to(points.device))
    )
    with found:
        trainer = Trainer(capture, store, seeds, settings, JobOptions(steps=10**6), device=device)
    if name != "ours":  # with a backend that is named, torch computes the field
        backend: Backend = gsplat_rasterize if name == "gsplat" else RASTERIZERS[device]
        trainer.model.backend = backend
        groups = [dict(group) for group in trainer.optimizer.adam.param_groups]
        adam: Any = TorchAdam(groups, eps=groups[0]["eps"], fused=True)
        trainer.optimizer.adam = adam
    trainer.smoothness.resample()
    return trainer


def wait(device: str) -> None:
    if device == "cuda":
        torch.cuda.synchronize()


def timed(trainer: Trainer, steps: int, device: str) -> dict[str, float]:
    """Milliseconds, see above."""
    for _ in range(WARM_UP):
        trainer.step()
    wait(device)
    seconds = []
    for _ in range(steps):
        started = time.perf_counter()
        trainer.step()
        wait(device)
        seconds.append(time.perf_counter() - started)
    started = time.perf_counter()
    for _ in range(steps):
        trainer.step()
    wait(device)
    together = (time.perf_counter() - started) / steps
    figures = {"median_ms": statistics.median(seconds), "fastest_ms": min(seconds), "back_to_back_ms": together}
    return {name: round(1e3 * value, 3) for name, value in figures.items()}


def runs(material: Material, steps: int, device: str, names: list[str], share: float) -> Iterator[dict[str, Any]]:
    """The records for one number of Gaussians; one with "failed" where a run did not come to its end."""
    compared: np.ndarray | None = None
    for name in names:
        images = "regions" if share else "whole"
        record: dict[str, Any] = {"gaussians": len(material.seeds.points), "images": images, "way": name}
        gc.collect()  # the training before, which would count as memory
        if device == "cuda":
            torch.cuda.reset_peak_memory_stats()
        try:
            with of_torch_alone(name):
                trainer = settled_trainer(material, name, share, device)
                with torch.no_grad():
                    image = trainer.draw(0, 1.0, RasterizeOptions())[1].image.rgb.cpu().numpy()
                if compared is not None:
                    record["mean_difference"] = float(np.abs(image - compared).mean())
                compared = image if compared is None else compared
                record |= timed(trainer, steps, device)
                del trainer
            if device == "cuda":
                record["peak_device_mb"] = round(torch.cuda.max_memory_allocated() / 1e6)
        except Exception as error:
            record["failed"] = f"{type(error).__name__}: {error}"
        yield record


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--capture", type=Path)
    parser.add_argument("--scale", type=float)
    parser.add_argument("--scene", default="100k_b", help="the generated scene where there is no capture")
    parser.add_argument("--counts", type=int, nargs="+", default=[20_000, 100_000, 300_000, 1_000_000])
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--ways", nargs="+", choices=WAYS, default=["ours", "before"])
    parser.add_argument("--device", choices=["cuda", "cpu"], default="cuda")
    options = parser.parse_args()
    if options.capture:
        material = filmed(options.capture, options.scale)
    else:
        material = generated(options.scene, options.device)
    camera, failed = material.capture.cameras[0], False
    sizes = [material.resampled(count) for count in options.counts]
    for share in (recipe("standard").region_share, 0.0):
        for material in sizes:
            for record in runs(material, options.steps, options.device, options.ways, share):
                print(json.dumps({"size": f"{camera.width} x {camera.height}", **record}), flush=True)
                failed |= "failed" in record
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
