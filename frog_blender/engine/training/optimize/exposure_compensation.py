"""Cameras that see the same scene brighter or darker, or in other colours, than their neighbours do.

Phones and webcams choose exposure and white balance each for itself. Without being told so a scene becomes brighter
where the bright cameras look, which is no colour that a new view should see.
"""

from __future__ import annotations

import numpy as np
import torch

from ...capture.camera import NEUTRAL, Camera
from ...capture.capture import Capture
from ..recipe import Recipe
from .device import image_on
from .schedule import Every
from .state_checks import fitting

_OBSERVED_EVERY = 3  # steps
_EVERY_PIXEL = 2  # of rows and columns
_EVERY, _UNTIL = 0.05, 0.85  # of the training; at its end rates cool down
_REMEMBERED = 0.5  # of what was observed before, every time
_NOTICED = 0.03
"""Standard deviation of the exposures' logarithms over the cameras above which they count: of cameras that are alike
what is found spreads by a few thousandths, by two hundredths where they hardly see the same or in the dark."""
_DARKEST, _BRIGHTEST = 0.02, 0.98  # of the display range: what lies beyond is clipped, in whatever exposure
_LARGEST = 4.0  # times as bright, or as dark


class ExposureCompensation:
    """Finds the exposures of a rig's training cameras: factors of red, green and blue by which what they filmed is
    brighter than what was drawn in the same places, gathered over many steps.

    Their geometric mean over the cameras is 1, so that the scene is as bright as the cameras are in the mean; withheld
    cameras, of which nothing may be learned, have the exposure NEUTRAL. So have all where cameras are alike: drawing
    has nothing to multiply then. A single moving camera is left alone: its withheld moments have no exposure.

    Attributes:
        sums: (C, 2, 3) brightness of images, and of drawings before their camera's exposure; what is old counts less.

    Args:
        recipe: ``exposure_from``.
    """

    def __init__(self, capture: Capture, recipe: Recipe, device: torch.device) -> None:
        self._learned = capture.train_cameras
        self._from = recipe.exposure_from
        self._due = Every(self._from + _EVERY, _UNTIL, _EVERY)
        self.sums = torch.zeros(len(capture.cameras), 2, 3, device=device)

    @staticmethod
    def wanted(capture: Capture, recipe: Recipe) -> bool:
        """Whether there are cameras to compare."""
        return recipe.exposure_from < _UNTIL and not capture.is_moving and len(capture.train_cameras) > 1

    def listens(self, index: int, step: int, progress: float) -> bool:
        """Whether a step that draws this camera at ``progress`` is to be observed."""
        return step % _OBSERVED_EVERY == 0 and progress >= self._from and index in self._learned

    def observe(self, index: int, camera: Camera, rgb: torch.Tensor, pixels: np.ndarray) -> None:
        """Adds what a step drew of camera ``index``, (H, W, 3), and the bytes that it should be."""
        truth = image_on(rgb.device, np.ascontiguousarray(pixels[::_EVERY_PIXEL, ::_EVERY_PIXEL]))
        counts = (truth > _DARKEST) & (truth < _BRIGHTEST)
        drawn = rgb.detach()[::_EVERY_PIXEL, ::_EVERY_PIXEL]
        both = torch.stack([(counts * truth).sum((0, 1)), (counts * drawn).sum((0, 1))])
        if camera.exposure != NEUTRAL:
            both[1] /= torch.tensor(camera.exposure, device=both.device)
        self.sums[index] += both.nan_to_num(0.0, 0.0, 0.0)  # of a loss that is none its own check tells

    def found(self, capture: Capture, before: float, now: float) -> Capture | None:
        """The capture with exposures as what was observed says, where that is due in (before, now]; else None."""
        if not self._due.due(before, now):
            return None
        truth, drawn = self.sums.cpu()[self._learned].double().numpy().transpose(1, 0, 2)
        self.sums *= _REMEMBERED
        if not ((truth > 0) & (drawn > 0)).all():
            return None  # a camera that was not drawn yet, or all black
        logs = np.log(truth) - np.log(drawn)
        logs -= logs.mean(axis=0)
        alike = np.sqrt((logs**2).mean()) < _NOTICED
        factors = np.exp(np.clip(logs, -np.log(_LARGEST), np.log(_LARGEST)))
        cameras = list(capture.cameras)
        for index, factor in zip(self._learned, factors, strict=True):
            cameras[index] = cameras[index].with_exposure(NEUTRAL if alike else factor)
        return capture.with_cameras(cameras)

    def resume(self, sums: torch.Tensor, exposures: torch.Tensor, capture: Capture) -> Capture:
        """Goes on from a checkpoint; the capture with ``exposures`` (C, 3); ValueError for what does not fit."""
        self.sums = fitting("sums", sums, tuple(self.sums.shape)).to(self.sums.device)
        if not bool((torch.isfinite(sums) & (sums >= 0)).all()):
            raise ValueError("brightness that is not finite")
        found = fitting("exposures", exposures, (len(capture.cameras), 3), torch.float64).numpy()
        if not ((found > 0.5 / _LARGEST) & (found < 2 * _LARGEST)).all():
            raise ValueError("exposures that no training finds")
        pairs = zip(capture.cameras, found, strict=True)
        return capture.with_cameras(camera.with_exposure(exposure) for camera, exposure in pairs)
