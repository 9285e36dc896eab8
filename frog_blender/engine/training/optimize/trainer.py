"""One training: the model, its optimizer and everything that happens at a step. Knows nothing of windows or files."""

from .. import passive_threads  # noqa: F401

# isort: split
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import torch

from ...capture.camera import Camera
from ...capture.capture import Capture
from ...capture.frame_keys import made_of
from ...capture.seeds import Seeds
from ...cuda import launch
from ...frames.store import FrameStore
from ...model.interface import RenderResult
from ...options import JobOptions
from ...rasterizer import RasterizeOptions
from ...rasterizer.cuda import PairRoom
from ...recipes import Recipe
from ...registry import DENSITY, METHODS, RASTERIZERS
from ...setting import weights_of
from ..methods import fit_to
from .camera_refinement import EXPOSED_UNTIL, CameraRig, ExposureCompensation, PoseRefinement, learnable_cameras
from .canonical_sampling import inject_anchors
from .densification import DensityStrategy
from .device import torch_threads
from .gaussian_state import GaussianState, LeastSizes, add_size_gradient, limit_sizes, sort_by_morton_code
from .initialization import first_model, scale_of
from .losses import Figures, matte_loss
from .mattes import Color, Mattes, Truth, behind_ignored
from .near_pruning import NearPruning
from .neighbours import SMOOTHED_EVERY, EmbeddingSmoothness
from .optimizer import SceneOptimizer
from .schedule import CropSampler, Every, ViewSampler, worked
from .stateful import Stateful, Tensors, Values
from .training import Training, TrainingDiverged
from .transfers import KeptImages

_SORTED_EVERY = 0.1  # of the training, while it grows
_MEASURED_EVERY = 0.01  # of the training, how large, how small and how near Gaussians may be
_MANY_CAMERAS = 8  # of four, each alone sees what is right before it
_NEAREST = 1e-3  # of the scene's scale, at which no camera sees anything
_MOST_STEPS, _MOST_LOSS = 10**12, 1e12  # in a checkpoint
_NEWEST = 0.02  # of a new value in the mean of the loss


@dataclass(frozen=True)
class _Chosen:
    """What a step draws: all of it that is left to chance, so that the same can be drawn again.

    Attributes:
        is_whole: ``camera`` has the size of its images, not half of it.
        terms, weight: of the loss, see ``matte_loss``.
    """

    step: int
    progress: float
    shot: int
    camera: Camera
    is_whole: bool
    region: tuple[int, int, int, int] | None
    background: Color | None
    terms: Mapping[str, float]
    weight: float


class Trainer(Training):
    """Call ``step`` until ``progress`` is 1.

    Everything that grows with the Gaussians lies on ``device``. Random numbers are drawn on the CPU, so that a seed
    picks the same images and crops anywhere.

    Args:
        capture, store, seeds: what to train on.
        recipe: before the method adapts it.
        options: method, seed of everything random, and when to stop: after so many steps, or so many seconds of
            training, whichever comes first; without either after as many steps as the recipe says.
        device: where to compute.

    Attributes:
        steps: after which to stop; None where that depends on seconds alone.
        seconds: so far, without evaluation, saving, and what the process was stopped for.
        loss: a running mean, NaN before the first step. On a GPU, where nobody waits for it, the newest step's is added
            by ``synchronize``.
        loss_terms: what the newest loss is the sum of, see ``Figures``.
    """

    def __init__(
        self,
        capture: Capture,
        store: FrameStore,
        seeds: Seeds,
        recipe: Recipe,
        options: JobOptions,
        device: torch.device | str = "cpu",
    ) -> None:
        self.options, seed = options, options.seed
        self.steps = options.steps or (None if options.seconds else recipe.steps_for(capture.frame_count))
        self.recipe = recipe = fit_to(METHODS[options.method].adapted(recipe), capture)
        self.rig, self.store, self.device = CameraRig(capture), store, torch.device(device)
        self.made_of = made_of(capture)
        self.generator = torch.Generator().manual_seed(seed)
        self.scene_scale = scale_of(capture, seeds.points)
        with torch.random.fork_rng(devices=[]):  # whoever else uses the CPU's generator finds it as it was
            torch.default_generator.manual_seed(seed)
            model = first_model(capture, seeds, recipe, options.method, self.scene_scale, self.device)
        if recipe.rasterizer != "auto":
            model.backend = RASTERIZERS[recipe.rasterizer]
        if launch.on_gpu(model.canonical.means):
            model.pair_room = PairRoom()
        self.gaussians = GaussianState(model, recipe, self.scene_scale)
        self.least_sizes = LeastSizes(self.gaussians, capture, recipe.least_size) if recipe.least_size else None
        many = len(capture.train_cameras) >= _MANY_CAMERAS
        self.near = NearPruning(capture, seeds.points, recipe.near_share) if many and recipe.near_share else None
        self.density: DensityStrategy = DENSITY[recipe.density](self.gaussians, recipe, self.scene_scale)
        self._more_losses = weights_of(recipe.losses)
        self.smoothness = EmbeddingSmoothness(self.gaussians, recipe, self.generator)
        center, learnable = np.median(seeds.points, axis=0), bool(learnable_cameras(capture))
        moved, exposed = learnable and recipe.pose_reach > 0, learnable and recipe.exposure_from < EXPOSED_UNTIL
        self.poses = PoseRefinement(self.rig, recipe, center, self.scene_scale) if moved else None
        self.exposures = ExposureCompensation(self.rig, recipe, self.device) if exposed else None
        if self.exposures:
            self.exposures.begin(store)
        self.views, self.mattes = ViewSampler(capture), Mattes(capture, store, KeptImages(self.device))
        self.crops = CropSampler(capture.cameras, recipe.region_share, recipe.region_size)
        self.hooks = []
        self.step_count, self.seconds, self.progress, self._burst_shot = 0, 0.0, 0.0, -1
        self.loss, self.loss_terms = math.nan, dict[str, float]()
        self._arriving: tuple[_Chosen, Callable[[], Figures]] | None = None
        self._densify = Every(recipe.densify_from, recipe.densify_until, recipe.densify_every)
        self._sort = Every(recipe.densify_from, recipe.densify_until, _SORTED_EVERY)
        self._sample = Every(recipe.sampling_from, recipe.sampling_until, recipe.sampling_every)
        self._measure_sizes = Every(0.0, 1.0, _MEASURED_EVERY)

    @property
    def optimizer(self) -> SceneOptimizer:
        """Of all the model's parameters."""
        return self.gaussians.optimizer

    @property
    def finished(self) -> bool:
        return self.progress >= 1.0

    # Checkpoints -----------------------------------------------------------------------------------------------------

    def _parts(self) -> list[Stateful]:
        optional = [part for part in (self.poses, self.exposures, self.least_sizes) if part]
        return [self.gaussians, self.density, self.smoothness, self.crops, *optional, *self.hooks]

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        self.synchronize()
        tensors: Tensors = {"random": self.generator.get_state()}
        values: Values = {"step_count": self.step_count, "seconds": self.seconds, "progress": self.progress}
        values |= {"loss": self.loss if math.isfinite(self.loss) else None, "burst_shot": self._burst_shot}
        for part in self._parts():
            own_tensors, own_values = part.state()
            tensors, values = tensors | own_tensors, values | own_values
        return tensors, values

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
        for part in self._parts():
            part.load_state(tensors, values)
        self.generator.set_state(tensors["random"])
        self.step_count, self.seconds = int(values["step_count"]), float(values["seconds"])
        self._burst_shot, before = int(values["burst_shot"]), float(values["progress"])
        if not (0 <= self.step_count < _MOST_STEPS and 0 <= self.seconds < math.inf and 0 <= before <= 1):
            raise ValueError(f"{before} of a training at step {self.step_count} after {self.seconds} s")
        if not -1 <= self._burst_shot < len(self.capture.shots):
            raise ValueError(f"no shot {self._burst_shot}")
        loss = math.nan if values["loss"] is None else float(values["loss"])
        if abs(loss) > _MOST_LOSS:
            raise ValueError(f"a loss of {loss}")
        self.loss, self._arriving = loss, None
        if self.model.pair_room:  # memory may have run out because of it
            self.model.pair_room = PairRoom()
        # A shorter limit makes progress jump: then the milestones in between are due at the next step.
        now = self._progress_now()
        self.progress = min(before, now)
        if self.poses and now != before:
            self.poses.begin_at(now)
        self._exclude_validation()
        self.check()

    def synchronize(self) -> None:
        """See Training."""
        self._take_figures()
        if self.poses:
            self.poses.synchronize()

    # Steps -----------------------------------------------------------------------------------------------------------

    def step(self) -> None:
        """One optimizer step on an image or a part of it, and what is due after it."""
        with torch_threads(1):
            before, started = self.progress, (time.perf_counter(), time.process_time())
            shot = self._optimize(before)
            self.step_count += 1
            self._count_seconds(started)
            self.progress = self._progress_now()
            started = time.perf_counter(), time.process_time()
            self._after_step(before, self.progress, shot)
            self._count_seconds(started)

    def _count_seconds(self, started: tuple[float, float]) -> None:
        self.seconds += worked(time.perf_counter() - started[0], time.process_time() - started[1])

    def _optimize(self, progress: float) -> int:
        """Draws a training image and moves the parameters; returns its shot."""
        self.synchronize()
        self.optimizer.schedule(progress)
        chosen = self._choose(progress)
        self._learn_from(chosen)
        return chosen.shot

    def _choose(self, progress: float) -> _Chosen:
        shot = self._next_shot(progress)
        index = self.capture.shots[shot].camera
        camera = self.camera_at(index, progress)
        is_whole = camera is self.capture.cameras[index]
        region = self.crops.pick(index, self.generator) if is_whole else None
        background = self.mattes.random_background(self.generator)
        dssim_weight = self.recipe.dssim_weight if self._in_burst(progress) else 0.0
        terms = {"square": self.recipe.square_weight, "dssim": dssim_weight}
        for name, more in self._more_losses.items():
            terms[name] = terms.get(name, 0.0) + more
        share = 1.0 if region is None else region[2] * region[3] / (camera.width * camera.height)
        weight = share ** (1 - self.recipe.region_emphasis)
        return _Chosen(self.step_count, progress, shot, camera, is_whole, region, background, terms, weight)

    def _learn_from(self, chosen: _Chosen, again: bool = False) -> None:
        """Draws what was chosen and moves the parameters; ``again`` where nothing was moved before."""
        step, progress, camera = chosen.step, chosen.progress, chosen.camera
        index = self.capture.shots[chosen.shot].camera
        pose = self._learned_pose(index, progress)
        if self.store.is_large:
            self._read_ahead(progress)
        grows = progress < self.recipe.densify_until
        options = RasterizeOptions(region=chosen.region, weights=grows and self.recipe.replaced_below > 0)
        truth, drawn = self.draw(chosen.shot, progress, options, pose, chosen.background)
        image = drawn.image
        errors = matte_loss(image, truth, self.recipe.alpha_weight, chosen.terms, chosen.weight, drawn.state)
        self._arriving = chosen, errors.figures
        if not launch.on_gpu(errors.gradient) and errors.gradient.device.type == "cpu":
            self._take_figures()
        drawn.backward(errors.gradient, errors.alpha_gradient)
        if grows:
            ignored, seen = truth.ignored, drawn.gaussians
            hidden = None
            if ignored is not None:
                hidden = behind_ignored(ignored, seen.means.detach(), camera, options.region_of(camera))
            self.density.observe(image, seen.opacities.detach(), camera, hidden, drawn.state)
        brightness = None
        if self.exposures and self.exposures.observes(index, step, progress):
            brightness = self.exposures.measured(camera, image.rgb, truth)
            if drawn.state is not None:  # an image without room for its pairs is none
                brightness = brightness * (drawn.state[1] == 0)
        if drawn.changes and step % SMOOTHED_EVERY == 0:
            self._regularize(step)
        if self.recipe.size_weight:
            add_size_gradient(self.gaussians.canonical, self.recipe.size_weight, self.scene_scale)
        self.optimizer.step(drawn.state, again)
        if self.least_sizes:
            self.least_sizes.apply()
        if self.poses and pose is not None and pose.grad is not None:
            self.poses.observe(index, pose.grad, progress)
        if self.exposures and brightness is not None:
            self.exposures.add(index, brightness)

    def _take_figures(self) -> None:
        """Adds the newest step's loss; makes the step again if its image had no room. TrainingDiverged when the loss is
        not finite."""
        if self._arriving is None:
            return
        (chosen, asked), self._arriving = self._arriving, None
        figures = asked()
        pairs, has_no_room = figures.state
        if has_no_room and self.model.pair_room:
            self.model.pair_room.grow(pairs, self.device)
            if self.poses:
                self.poses.forget()
            self._learn_from(chosen, again=True)
            return self._take_figures()
        if chosen.is_whole:
            index = self.capture.shots[chosen.shot].camera
            region = RasterizeOptions(region=chosen.region).region_of(chosen.camera)
            self.crops.observe(index, region, figures.cell_errors)
        loss, self.loss_terms = figures.loss, figures.terms
        if not math.isfinite(loss):
            raise TrainingDiverged(f"Training became unstable at step {chosen.step} (the loss is not a number).")
        self.loss = loss if math.isnan(self.loss) else (1 - _NEWEST) * self.loss + _NEWEST * loss

    def _read_ahead(self, progress: float) -> None:
        """Begins to read the next step's image. It is another one where random numbers are drawn before, in rounds of
        density control, or where this step changes the errors of its camera: then what was read is not used."""
        if self._in_burst(progress):
            return
        generator = self.generator.clone_state()
        shot = self.views.pick(generator)
        index = self.capture.shots[shot].camera
        camera = self.camera_at(index, progress)
        region = self.crops.pick(index, generator) if camera is self.capture.cameras[index] else None
        self.mattes.prefetch(shot, camera, RasterizeOptions(region=region).region_of(camera))

    def _regularize(self, step: int) -> None:
        """Adds the gradients of what keeps the model smooth, of SMOOTHED_EVERY steps at once."""
        extra = self.model.regularization()
        if extra is not None:
            extra.backward(torch.full_like(extra, SMOOTHED_EVERY))
        self.smoothness.add_gradient(step)

    def _progress_now(self) -> float:
        shares = [0.0]
        if self.steps:
            shares.append(self.step_count / self.steps)
        if self.options.seconds:
            shares.append(self.seconds / self.options.seconds)
        return min(1.0, max(shares))

    def _in_burst(self, progress: float) -> bool:
        r = self.recipe
        return bool(r.dssim_weight) and progress >= r.dssim_from and self.step_count % r.dssim_period < r.dssim_burst

    def _next_shot(self, progress: float) -> int:
        """A burst of D-SSIM stays at one frame and changes the camera (E-D3DGS's multi-view SSIM)."""
        if self._in_burst(progress) and self.step_count % self.recipe.dssim_period and self._burst_shot >= 0:
            return self.views.pick_same_frame(self._burst_shot, self.generator)
        self._burst_shot = self.views.pick(self.generator)
        return self._burst_shot

    def _learned_pose(self, camera: int, progress: float) -> torch.Tensor | None:
        """(3, 4) the pose of a camera, to receive its gradient in this step; None where it is not learned."""
        if self.poses is None or not self.poses.learns(camera, progress):
            return None
        pose = torch.from_numpy(self.capture.cameras[camera].world_to_camera[:3]).float()
        return launch.sent(pose, self.device).requires_grad_()

    def _after_step(self, before: float, now: float, shot: int) -> None:
        if self.exposures:
            self.exposures.update(before, now)
        if all(hook.allows_growth(now) for hook in self.hooks):
            self._grow(before, now, shot)
        if self._measure_sizes.due(before, now):
            if self.near:
                self.near.prune(self.gaussians, self.capture)
            if self.recipe.size_limit and now >= self.recipe.size_limit_from:
                limit_sizes(self.gaussians.canonical, self.capture, self.recipe.size_limit, _NEAREST * self.scene_scale)
            if self.least_sizes:
                self.least_sizes.measure_again()
        for hook in list(self.hooks):
            hook.after_step(self, before, now)
        self._exclude_validation()

    def _grow(self, before: float, now: float, shot: int) -> None:
        """Densifies, adds anchors and sorts, where that is due in (before, now]."""
        densifies = self._densify.due(before, now)
        if densifies:
            self.density.round(self.gaussians, self.recipe.growth_limit_at(now), self.generator)
        if self.recipe.sampling != "off" and self._sample.due(before, now):
            self.inject_anchors(now, shot)
        if densifies and self.recipe.smoothness_weight:
            self.smoothness.resample()
        if self._sort.due(before, now):
            sort_by_morton_code(self.gaussians)

    def inject_anchors(self, progress: float, shot: int) -> None:
        """Canonical field sampling where the drawing of a shot is wrong, see ``canonical_sampling``."""

        def draw() -> tuple[Truth, RenderResult, Camera]:
            camera = self.camera_at(self.capture.shots[shot].camera, progress)
            return *self.draw(shot, progress, RasterizeOptions(depth=True)), camera

        limit = self.recipe.growth_limit_at(progress)
        inject_anchors(self.gaussians, self.density, limit, draw, self.generator)

    def _exclude_validation(self) -> None:
        self.views.exclude(tuple(shot for hook in self.hooks for shot in hook.validation_at(self.progress)))


TrainerFactory = Callable[..., Trainer]
"""Makes a trainer of what ``Trainer`` takes."""
