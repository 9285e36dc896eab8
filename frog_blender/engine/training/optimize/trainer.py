"""One training: the model, its optimiser and everything that happens at a step. Knows nothing of windows or files."""

from __future__ import annotations

from .. import passive_threads  # noqa: F401

# isort: split
import math
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import torch

from ...capture.camera import Camera
from ...capture.capture import Capture
from ...capture.frames import FrameStore
from ...capture.seeds import Seeds
from ...capture.time import frame_to_time
from ...evaluation.metrics import psnr_of
from ...model.interface import RenderResult, SceneModel, ScheduleState
from ...rasterizer import GaussianArrays, RasterizeOptions, rasterize
from ..compression.schedule import CompressionSchedule
from ..methods import method_named
from ..recipe import Recipe
from .canonical_sampling import inject_anchors
from .crop_sampler import CropSampler
from .densification import DensificationStrategy
from .device import torch_threads
from .exposure_compensation import ExposureCompensation
from .gaussian_order import sort_by_morton_code
from .half_resolution import halved, is_halved, sized
from .initialization import first_model, scale_of
from .losses import photometric_loss
from .optimizer import SceneOptimizer
from .pose_refinement import PoseRefinement
from .running_loss import RunningLoss, TrainingDiverged
from .schedule import Every, ViewSampler, ramp
from .smoothness import SMOOTHED_EVERY, NeighbourGraph
from .working_time import worked_since

Played = Callable[[float], GaussianArrays]
"""A scene's Gaussians at a time in [0, 1]."""

_SORTED_EVERY = 0.1  # of the training, while it grows
_MOST_STEPS, _MOST_LOSS = 10**12, 1e12  # of what a checkpoint may say


@dataclass(frozen=True)
class Limits:
    """When to stop: after so many steps, or so many seconds of training, whichever comes first."""

    steps: int | None = None
    seconds: float | None = None


class Trainer:
    """Call ``step`` until ``progress`` is 1.

    Everything that grows with the Gaussians lives on ``device``. Random numbers are drawn on the CPU, so that a seed
    picks the same images and regions anywhere.

    Attributes:
        model: ``model.deform(time, schedule_state)`` gives Gaussians and changes.
        step_count, seconds: so far; seconds leave out evaluation, saving, and what the process was stopped for.
        progress: 0 to 1.
        before_round: called before a round of compression, which may fail (see Recovery.without_round).
    """

    def __init__(
        self,
        capture: Capture,
        store: FrameStore,
        seeds: Seeds,
        recipe: Recipe,
        method: str,
        limits: Limits,
        seed: int,
        device: torch.device | str = "cpu",
    ) -> None:
        recipe = method_named(method).adapt(recipe)
        self.capture, self.recipe, self.method, self.limits = capture, recipe, method, limits
        self.store, self.device = store, torch.device(device)
        torch.manual_seed(seed)
        self.generator = torch.Generator().manual_seed(seed)
        self.scene_scale = scale_of(capture, seeds.points)
        self.model: SceneModel = first_model(capture, seeds, recipe, method, self.scene_scale, self.device)
        self.optimizer = SceneOptimizer(self.model, recipe, self.scene_scale)
        center = np.median(seeds.points, axis=0)
        refined = PoseRefinement.wanted(capture, recipe)
        self.poses = PoseRefinement(capture, recipe, center, self.scene_scale) if refined else None
        compared = ExposureCompensation.wanted(capture, recipe)
        self.exposures = ExposureCompensation(capture, recipe, self.device) if compared else None
        self.density = DensificationStrategy(recipe, self.scene_scale, self.count, self.device)
        self.neighbourhood: NeighbourGraph | None = None
        self.step_count, self.seconds, self.progress = 0, 0.0, 0.0
        self.before_round: Callable[[], None] = lambda: None
        self._loss = RunningLoss()
        self.burst_shot = -1
        self.compression = CompressionSchedule(self, seed) if recipe.capacity == "auto" else None
        self.picker = ViewSampler(capture, recipe.frame_choice)
        self.regions = CropSampler(capture.cameras, recipe.region_share, recipe.region_size)
        self._densify = Every(recipe.densify_from, recipe.densify_until, recipe.densify_every)
        self._sort = Every(recipe.densify_from, recipe.densify_until, _SORTED_EVERY)
        self._sample = Every(recipe.sampling_from, recipe.sampling_until, recipe.sampling_every)
        if self.compression:
            self.compression.begin(self)

    def rebuild_optimizer(self) -> None:
        """A fresh optimiser, after the model's parameters were replaced from outside."""
        self.optimizer = SceneOptimizer(self.model, self.recipe, self.scene_scale)

    def limit_gaussians(self, count: int) -> None:
        """No more than these from now on; those that there are stay."""
        self.recipe = self.density.recipe = replace(self.recipe, max_gaussians=count)

    def resume_at(self, state: dict[str, Any]) -> None:
        """Sets the counters of a checkpoint; ValueError for what no training counts."""
        self.step_count, self.seconds = int(state["step_count"]), float(state["seconds"])
        self.burst_shot, before = int(state["burst_shot"]), float(state["progress"])
        if not (0 <= self.step_count < _MOST_STEPS and 0 <= self.seconds < math.inf and 0 <= before <= 1):
            raise ValueError(f"{before} of a training at step {self.step_count} after {self.seconds} s")
        if not -1 <= self.burst_shot < len(self.capture.shots):
            raise ValueError(f"no shot {self.burst_shot}")
        loss = math.nan if state["loss"] is None else float(state["loss"])
        if abs(loss) > _MOST_LOSS:
            raise ValueError(f"a loss of {loss}")
        self._loss.resume(loss)
        # A shorter limit makes progress jump: then the rounds in between are due at the next step.
        now = self._progress_now()
        self.progress = min(before, now)
        if self.poses and now != before:
            self.poses.begin_at(now)
        if self.compression:
            self.picker.withhold(self.compression.withheld_at(self.progress))

    @property
    def count(self) -> int:
        """Gaussians."""
        return len(self.model.canonical)

    @property
    def finished(self) -> bool:
        return self.progress >= 1.0

    @property
    def loss(self) -> float:
        """A running mean, NaN before the first step."""
        return self._loss.mean

    def check(self) -> None:
        """Raises TrainingDiverged when the loss or a parameter is not finite. Call it before anything is saved: a
        non-finite Gaussian is not drawn, so the loss alone does not show it."""
        self._loss.check(self.step_count)
        for name, parameter in self.model.named_parameters():
            if not bool(torch.isfinite(parameter).all()):
                raise TrainingDiverged(f"Training became unstable at step {self.step_count} ({name} is not finite).")

    def settle(self) -> None:
        """Takes in what the last step found and has not been waited for."""
        self.regions.settle()
        if self.poses:
            self.poses.settle()
            self.capture = self.poses.capture

    def step(self) -> None:
        """One optimiser step on one image, and whatever round is due after it."""
        with torch_threads(1):
            self._step()

    def _step(self) -> None:
        started = time.perf_counter(), time.process_time()
        before = self.progress
        self.settle()
        self.optimizer.schedule(before)
        shot = self._next_shot(before)
        camera_index = self.capture.shots[shot].camera
        camera = self.camera_at(camera_index, before)
        whole_size = camera is self.capture.cameras[camera_index]
        region = self.regions.pick(camera_index, self.generator) if whole_size else None
        grows = before < self.recipe.densify_until
        options = RasterizeOptions(region=region, weights=grows and self.recipe.replaced_below > 0)
        pose = self._learned_pose(camera_index, before)
        pixels, drawn = self.draw(shot, before, options, pose)
        image = drawn.image
        share = 1.0 if region is None else region[2] * region[3] / (camera.width * camera.height)
        dssim_weight = self.recipe.dssim_weight if self._in_burst(before) else 0.0
        weight = share ** (1 - self.recipe.region_emphasis)
        found = photometric_loss(image.rgb, pixels, dssim_weight=dssim_weight, weight=weight)
        if whole_size:
            self.regions.observe(camera_index, options.region_of(camera), found.cell_errors)
        self.picker.observe(shot, found.error)
        self._loss.add(found.loss, self.step_count)
        drawn.backward(found.gradient)
        if drawn.changes and self.step_count % SMOOTHED_EVERY == 0:
            self._regularize()
        if grows:
            self.density.observe(image, drawn.gaussians.opacities.detach(), camera)
        self.optimizer.step()
        if self.poses and pose is not None and pose.grad is not None:
            self.poses.observe(camera_index, pose.grad, before)
        if self.exposures and self.exposures.listens(camera_index, self.step_count, before):
            self.exposures.observe(camera_index, camera, image.rgb, pixels)
        self.step_count += 1
        self.seconds += worked_since(*started)
        self.progress = self._progress_now()
        started = time.perf_counter(), time.process_time()
        self._rounds(before, self.progress, shot)
        self.seconds += worked_since(*started)

    def _regularize(self) -> None:
        """Adds the gradients of what keeps the model smooth, of SMOOTHED_EVERY steps at once."""
        extra, weight = self.model.regularization(), self.recipe.smoothness_weight
        if extra is not None:
            (SMOOTHED_EVERY * extra).backward()
        if self.neighbourhood is not None and weight:
            self.neighbourhood.add_gradient(self.model.canonical.embeddings, self.step_count, weight)

    def _progress_now(self) -> float:
        shares = [0.0]
        if self.limits.steps:
            shares.append(self.step_count / self.limits.steps)
        if self.limits.seconds:
            shares.append(self.seconds / self.limits.seconds)
        return min(1.0, max(shares))

    def _in_burst(self, progress: float) -> bool:
        r = self.recipe
        return bool(r.dssim_weight) and progress >= r.dssim_from and self.step_count % r.dssim_period < r.dssim_burst

    def _next_shot(self, progress: float) -> int:
        """A burst of D-SSIM stays at one moment and changes the camera (E-D3DGS's multi-view SSIM)."""
        if self._in_burst(progress) and self.step_count % self.recipe.dssim_period and self.burst_shot >= 0:
            return self.picker.pick_same_moment(self.burst_shot, self.generator)
        self.burst_shot = self.picker.pick(self.generator)
        return self.burst_shot

    def draw(
        self, shot_index: int, progress: float, options: RasterizeOptions, pose: torch.Tensor | None = None
    ) -> tuple[np.ndarray, RenderResult]:
        """An image (H, W, 3) uint8 and its drawing."""
        shot = self.capture.shots[shot_index]
        camera = self.camera_at(shot.camera, progress)
        pixels = sized(self.store.image(shot_index), camera)
        left, top, width, height = options.region_of(camera)
        pixels = pixels[top : top + height, left : left + width]
        background, sh_count = self.capture.background, self.sh_count_at(progress)
        if progress < self.recipe.warm_up:
            gaussians = self.model.canonical.gaussians(sh_count)
            return pixels, RenderResult(rasterize(gaussians, camera, background, options, pose=pose), gaussians, {})
        time_, schedules = frame_to_time(shot.frame, self.capture.frame_count), self.schedule_state(progress)
        return pixels, self.model.draw(time_, camera, background, options, schedules, sh_count, pose)

    def _learned_pose(self, camera: int, progress: float) -> torch.Tensor | None:
        """(3, 4) the pose of a camera, to receive its gradient in this step; None where it is not learned."""
        if self.poses is None or not self.poses.learns(camera, progress):
            return None
        pose = torch.from_numpy(self.capture.cameras[camera].world_to_camera[:3]).float()
        return pose.to(self.device, non_blocking=True).requires_grad_()

    def camera_at(self, index: int, progress: float) -> Camera:
        """A camera at the size at which it is drawn at ``progress``."""
        camera = self.capture.cameras[index]
        return halved(camera) if is_halved(camera, progress, self.recipe.half_size_until) else camera

    def schedule_state(self, progress: float) -> ScheduleState:
        """The schedules inside the model at ``progress``."""
        r = self.recipe
        return ScheduleState(ramp(progress, 0.0, r.fine_rows_until), ramp(progress, *r.opacity_ramp))

    def sh_count_at(self, progress: float) -> int:
        """Coefficients of the degrees that have begun."""
        degree = sum(progress >= start for start in self.recipe.sh_growth[: self.recipe.sh_degree])
        return min((degree + 1) ** 2, self.model.canonical.sh.shape[1])

    def gaussians_at(self, time_: float, progress: float) -> tuple[GaussianArrays, dict[str, torch.Tensor]]:
        """Gaussians and changes at a time, with the schedules as they stand at ``progress``."""
        sh_count = self.sh_count_at(progress)
        if progress >= self.recipe.warm_up:
            return self.model.deform(time_, self.schedule_state(progress), sh_count)
        return self.model.canonical.gaussians(sh_count), {}

    def _rounds(self, before: float, now: float, shot: int) -> None:
        if self.exposures and (exposed := self.exposures.found(self.capture, before, now)):
            self.see_through(exposed)
        grows = not (self.compression and self.compression.settled(now))
        densified = grows and self._densify.due(before, now)
        if densified:
            limit = self.recipe.growth_limit_at(now)
            self.density.round(self.model.canonical, self.optimizer, limit, self.generator)
        if grows and self.recipe.sampling != "off" and self._sample.due(before, now):
            inject_anchors(self, now, shot)
        if densified and self.recipe.smoothness_weight:
            self.find_neighbours()
        if grows and self._sort.due(before, now):
            sort_by_morton_code(self)
        if self.compression:
            self.compression.after_step(self, before, now)
            self.picker.withhold(self.compression.withheld_at(now))

    def see_through(self, capture: Capture) -> None:
        """The same capture, whose cameras are known better."""
        self.capture = capture
        if self.poses:
            self.poses.capture = capture

    def find_neighbours(self) -> None:
        """Draws the embedding smoothness's sample anew, among the Gaussians that move."""
        means = self.model.canonical.means.detach()[: self.model.canonical.num_dynamic]
        self.neighbourhood = NeighbourGraph.drawn(means, self.recipe, self.generator)

    @torch.no_grad()
    def render_image(
        self, shot_index: int, largest_side: int | None = None, played: Played | None = None
    ) -> np.ndarray:
        """(H, W, 3) float32 what a shot looks like as training stands, or as it is ``played``, at so many pixels a side
        at most."""
        shot = self.capture.shots[shot_index]
        camera = self.capture.cameras[shot.camera]
        scale = (largest_side or math.inf) / max(camera.width, camera.height)
        if scale < 1:
            camera = camera.resized(max(1, round(camera.width * scale)), max(1, round(camera.height * scale)))
        moment = frame_to_time(shot.frame, self.capture.frame_count)
        gaussians = played(moment) if played else self.gaussians_at(moment, self.progress)[0]
        return rasterize(gaussians, camera, self.capture.background).rgb.cpu().numpy()

    def evaluate(self, limit: int, played: Played | None = None) -> tuple[float, str]:
        """Mean PSNR over at most ``limit`` evenly spread held-out images (training ones when none is withheld), as
        training stands or of Gaussians ``played`` at a time.

        A figure for people: nothing in the training looks at it.
        """
        held_out = [i for i, shot in enumerate(self.capture.shots) if self.capture.is_test(shot)]
        shots = held_out or list(range(len(self.capture.shots)))
        chosen = [shots[int(i)] for i in np.linspace(0, len(shots) - 1, min(limit, len(shots)))]
        values = []
        for index in chosen:
            truth = self.store.image(index).astype(np.float32) / 255
            values.append(psnr_of(float(np.mean((self.render_image(index, None, played).clip(0, 1) - truth) ** 2))))
        return float(np.mean(values)), "held-out" if held_out else "training"
