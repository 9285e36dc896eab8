"""A training as its hooks, and whoever looks at it, see it: the scene as it stands, its images, and its loss."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import torch
from numpy.typing import NDArray

from ...capture.camera import Camera
from ...capture.capture import Capture, Shot
from ...errors import FrogError
from ...frames.store import FrameStore
from ...model.interface import Deformed, RenderResult, SceneModel, ScheduleState
from ...options import JobOptions
from ...rasterizer import RasterizeOptions, rasterize
from ...recipes import Recipe
from ...scene.scene_file import settings_json
from .camera_refinement import CameraRig
from .densification import DensityStrategy
from .gaussian_state import GaussianState
from .mattes import Color, Mattes, Truth, halved, is_halved
from .schedule import ramp
from .stateful import Stateful, Tensors, Values


class TrainingDiverged(FrogError):
    """The loss or a parameter is not finite; see session.recovery."""


class Hook:
    """Something that a training does besides its steps; this one does nothing."""

    def begin(self, training: Training) -> None:
        """Called once, before the first step and before a checkpoint is loaded."""

    def after_step(self, training: Training, before: float, now: float) -> None:
        """Called after the step that led from the progress ``before`` to ``now``."""

    def before_milestone(self) -> None:
        """Called before a hook changes the model in a way that may fail."""

    def allows_growth(self, progress: float) -> bool:
        """Whether Gaussians may be added at ``progress``."""
        return True

    def validation_at(self, progress: float) -> tuple[int, ...]:
        """Training shots that are for validation, and not to be learned from, at ``progress``."""
        return ()

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        return {}, {}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""


class Training(Stateful):
    """The scene of a training as it stands; see ``Trainer``.

    Attributes:
        options: method, seed and length.
        recipe: as the method and the capture adapted it.
        rig: the capture's cameras.
        made_of: what the capture was when the training began, see ``frame_keys.made_of``.
        store, mattes: the capture's images.
        gaussians: everything that is kept by Gaussian.
        density: who adds and removes Gaussians.
        hooks: in the order in which they are called.
        step_count: so far.
        progress: 0 to 1.
    """

    options: JobOptions
    recipe: Recipe
    rig: CameraRig
    made_of: dict[str, str]
    store: FrameStore
    mattes: Mattes
    gaussians: GaussianState
    density: DensityStrategy
    hooks: list[Hook]
    step_count: int
    progress: float

    @property
    def capture(self) -> Capture:
        """With its cameras as they are known now."""
        return self.rig.capture

    @property
    def model(self) -> SceneModel:
        """The method's."""
        return self.gaussians.model

    @property
    def count(self) -> int:
        """Gaussians."""
        return self.gaussians.count

    @property
    def description(self) -> Values:
        """What has to be the same for a checkpoint to be this training's, by name."""
        return {
            "method": self.options.method,
            "recipe": settings_json(self.recipe),
            "cameras": [camera.name for camera in self.capture.cameras],
            "shots": len(self.capture.shots),
            "made_of": self.made_of,
        }

    def add_hook(self, hook: Hook) -> None:
        """Adds a hook and lets it begin."""
        self.hooks.append(hook)
        hook.begin(self)

    def limit_gaussians(self, count: int) -> None:
        """Allows no more than ``count`` Gaussians from now on; those that there are stay."""
        self.recipe = self.density.recipe = replace(self.recipe, max_gaussians=count)

    def before_milestone(self) -> None:
        """A hook is about to change the model in a way that may fail."""
        for hook in self.hooks:
            hook.before_milestone()

    def synchronize(self) -> None:
        """Adds what the last step found and has not been waited for; TrainingDiverged when its loss is not finite."""

    def check(self) -> None:
        """Raises TrainingDiverged when the loss or a parameter is not finite. Call it before anything is saved: a
        non-finite Gaussian is not drawn, so the loss alone does not show it."""
        self.synchronize()
        for name, parameter in self.model.named_parameters():
            if not bool(torch.isfinite(parameter).all()):
                raise TrainingDiverged(f"Training became unstable at step {self.step_count} ({name} is not finite).")

    def draw(
        self,
        shot_index: int,
        progress: float,
        options: RasterizeOptions,
        pose: torch.Tensor | None = None,
        background: Color | None = None,
    ) -> tuple[Truth, RenderResult]:
        """What an image should be and its drawing, over ``background`` where that can be chosen."""
        shot = self.capture.shots[shot_index]
        camera = self.camera_at(shot.camera, progress)
        truth = self.mattes.truth(shot_index, camera, options.region_of(camera), background)
        if progress < self.recipe.warm_up:
            gaussians = self.model.canonical.gaussians(self.sh_count_at(progress))
            image = rasterize(gaussians, camera, truth.background, options, pose=pose)
            return truth, RenderResult(image, gaussians, {})
        schedules = self.schedule_state(progress)
        return truth, self.model.draw(
            self.capture.time_of(shot), camera, truth.background, options, schedules, pose=pose
        )

    def camera_at(self, index: int, progress: float) -> Camera:
        """A camera at the size at which it is drawn at ``progress``."""
        camera = self.capture.cameras[index]
        return halved(camera) if is_halved(camera, progress, self.recipe.half_size_until) else camera

    def schedule_state(self, progress: float | None = None) -> ScheduleState:
        """The schedules inside the model at ``progress``, or as they stand."""
        r, progress = self.recipe, self.progress if progress is None else progress
        rows, opacity = ramp(progress, 0.0, r.fine_rows_until), ramp(progress, *r.opacity_ramp)
        return ScheduleState(rows, opacity, self.sh_count_at(progress))

    def sh_count_at(self, progress: float) -> int:
        """Coefficients of the degrees that have begun."""
        degree = sum(progress >= start for start in self.recipe.sh_growth[: self.recipe.sh_degree])
        return min((degree + 1) ** 2, self.model.canonical.sh.shape[1])

    def deform(self, time: float) -> Deformed:
        """Gaussians and changes at a time in [0, 1], as training stands."""
        schedules = self.schedule_state()
        if self.progress >= self.recipe.warm_up:
            return self.model.deform(time, schedules)
        return self.model.canonical.gaussians(schedules.sh_count), {}

    @torch.no_grad()
    def render_image(self, shot_index: int, largest_side: int | None = None) -> NDArray[np.float32]:
        """(H, W, 3) float32 what a shot looks like as training stands, at so many pixels a side at most."""
        shot = self.capture.shots[shot_index]
        camera = self.capture.cameras[shot.camera]
        scale = (largest_side or math.inf) / max(camera.width, camera.height)
        if scale < 1:
            camera = camera.scaled(scale)
        return self._drawn(shot, camera).cpu().numpy()

    def _drawn(self, shot: Shot, camera: Camera) -> torch.Tensor:
        """(H, W, 3) as training stands."""
        return rasterize(self.deform(self.capture.time_of(shot))[0], camera, self.capture.background).rgb

    @torch.no_grad()
    def evaluate(self, limit: int) -> tuple[float, str]:
        """Mean PSNR over at most ``limit`` evenly spread held-out images (training ones when none is held out), as
        training stands.

        A figure for people: nothing in the training depends on it.
        """
        held_out = [i for i, shot in enumerate(self.capture.shots) if self.capture.is_test(shot)]
        shots = held_out or list(range(len(self.capture.shots)))
        chosen = [shots[int(i)] for i in np.linspace(0, len(shots) - 1, min(limit, len(shots)))]
        values = []
        for index in chosen:
            shot = self.capture.shots[index]
            camera = self.capture.cameras[shot.camera]
            values.append(self.mattes.truth(index, camera).psnr(self._drawn(shot, camera)))
        return float(np.mean(values)), "held-out" if held_out else "training"
