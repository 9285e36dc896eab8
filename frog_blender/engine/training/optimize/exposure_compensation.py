"""Cameras that see the same scene brighter or darker, or in other colours, than their neighbours do.

Phones and webcams choose exposure and white balance each for itself. Without being told so a scene becomes brighter
where the bright cameras look, which is no colour that a new view should see.
"""

from __future__ import annotations

import numpy as np
import torch

from ...capture.camera import NEUTRAL, Camera
from ...capture.capture import Capture
from ...capture.seeding.exposures import matched_exposures
from ...capture.seeding.views import Images
from ..recipe import Recipe
from .camera_rig import CameraRig
from .device import image_on
from .learnable_cameras import learnable_cameras
from .mattes import Truth
from .schedule import Every
from .stateful import Tensors, Values, expect

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
    brighter than what was drawn in the same places, gathered over many steps. Large differences are found before the
    first step, see ``matched_exposures``: by the first update the scene has learned them.

    Their median over the cameras is 1, so that the scene is as bright as most cameras see it, whatever a few do.
    Held-out cameras, of which nothing may be learned, have the exposure NEUTRAL, and so have all where cameras are
    alike, and those of a single image (see ``learnable_cameras``).

    Attributes:
        sums: (C, 2, 3) brightness of images, and of drawings before their camera's exposure; what is old counts less.

    Args:
        recipe: ``exposure_from``.
        every: fraction of the training between updates.
    """

    def __init__(self, rig: CameraRig, recipe: Recipe, device: torch.device, every: float = _EVERY) -> None:
        self._rig, self._learned = rig, learnable_cameras(rig.capture)
        self._from = recipe.exposure_from
        self._due = Every(self._from + every, _UNTIL, every)
        self.sums = torch.zeros(len(rig.capture.cameras), 2, 3, device=device)

    @staticmethod
    def wanted(capture: Capture, recipe: Recipe) -> bool:
        """Whether there are cameras to compare."""
        return recipe.exposure_from < _UNTIL and bool(learnable_cameras(capture))

    def begin(self, store: Images) -> None:
        """Gives the rig's cameras the exposures that matched features show, where those differ for certain."""
        found = matched_exposures(self._rig.capture, store)
        if found is None:
            return
        limit = np.log(_LARGEST)
        cameras = list(self._rig.capture.cameras)
        for index, factors in found.items():
            cameras[index] = cameras[index].with_exposure(np.exp(np.clip(np.log(factors), -limit, limit)))
        self._rig.capture = self._rig.capture.with_cameras(cameras)

    def observes(self, index: int, step: int, progress: float) -> bool:
        """Whether a step that draws this camera at ``progress`` is to be observed."""
        return step % _OBSERVED_EVERY == 0 and progress >= self._from and index in self._learned

    def observe(self, index: int, camera: Camera, rgb: torch.Tensor, wanted: Truth) -> None:
        """Adds what a step drew of camera ``index``, see ``measured``."""
        self.add(index, self.measured(camera, rgb, wanted))

    @staticmethod
    def measured(camera: Camera, rgb: torch.Tensor, wanted: Truth) -> torch.Tensor:
        """(2, 3) brightness of what an image should be and of its drawing (H, W, 3), before the camera's exposure: of
        pixels that are all subject and not ignored."""
        truth = image_on(rgb.device, np.ascontiguousarray(wanted.pixels[::_EVERY_PIXEL, ::_EVERY_PIXEL]))
        counts = (truth > _DARKEST) & (truth < _BRIGHTEST)
        if (whole := wanted.whole) is not None:
            some = torch.from_numpy(np.ascontiguousarray(whole[::_EVERY_PIXEL, ::_EVERY_PIXEL]))
            counts &= some.to(counts.device)[..., None]
        drawn = rgb.detach()[::_EVERY_PIXEL, ::_EVERY_PIXEL]
        both = torch.stack([(counts * truth).sum((0, 1)), (counts * drawn).sum((0, 1))])
        if camera.exposure != NEUTRAL:
            both[1] /= torch.tensor(camera.exposure, device=both.device)
        return both.nan_to_num(0.0, 0.0, 0.0)  # a non-finite loss has its own check

    def add(self, index: int, brightness: torch.Tensor) -> None:
        """Adds what ``measured`` found of camera ``index``."""
        self.sums[index] += brightness

    def update(self, before: float, now: float) -> None:
        """Gives the rig's cameras the exposures that were observed, where that is due in (before, now]."""
        if not self._due.due(before, now):
            return
        truth, drawn = self.sums.cpu()[self._learned].double().numpy().transpose(1, 0, 2)
        self.sums *= _REMEMBERED
        if not ((truth > 0) & (drawn > 0)).all():
            return  # a camera that was not drawn yet, or all black
        logs = np.log(truth) - np.log(drawn)
        logs -= logs.mean(axis=0)
        alike = np.sqrt((logs**2).mean()) < _NOTICED
        logs -= np.median(logs, axis=0)
        factors = np.exp(np.clip(logs, -np.log(_LARGEST), np.log(_LARGEST)))
        cameras = list(self._rig.capture.cameras)
        for index, factor in zip(self._learned, factors, strict=True):
            cameras[index] = cameras[index].with_exposure(NEUTRAL if alike else factor)
        self._rig.capture = self._rig.capture.with_cameras(cameras)

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        exposures = [camera.exposure for camera in self._rig.capture.cameras]
        found = torch.tensor(exposures, dtype=torch.float64, device="cpu")
        return {"exposures": found, "exposures.sums": self.sums}, {}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
        capture, sums = self._rig.capture, tensors["exposures.sums"]
        self.sums = expect("sums", sums, tuple(self.sums.shape)).to(self.sums.device)
        if not bool((torch.isfinite(sums) & (sums >= 0)).all()):
            raise ValueError("brightness that is not finite")
        found = expect("exposures", tensors["exposures"], (len(capture.cameras), 3), torch.float64).numpy()
        if not ((found > 0.5 / _LARGEST) & (found < 2 * _LARGEST)).all():
            raise ValueError("exposures that no training finds")
        pairs = zip(capture.cameras, found, strict=True)
        self._rig.capture = capture.with_cameras(camera.with_exposure(exposure) for camera, exposure in pairs)
