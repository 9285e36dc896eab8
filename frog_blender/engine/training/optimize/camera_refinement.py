"""Cameras' poses and exposures, which are learned with the scene.

A pixel of calibration error blurs everything. Phones and webcams choose exposure and white balance each for itself:
without being told so a scene becomes brighter where the bright cameras look, which is no colour that a new view should
see. Both are learned only of cameras that can be told from what the scene does.
"""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ...capture.camera import NEUTRAL, Camera, rotation_about
from ...capture.capture import Capture, Images
from ...capture.seeding.exposures import matched_exposures
from ...rasterizer.differentiable import gains_of
from ...recipes import Recipe
from .mattes import Truth
from .schedule import Every
from .stateful import Tensors, Values, expect
from .transfers import OnItsWay


@dataclass
class CameraRig:
    """What refines cameras shares.

    Attributes:
        capture: with its cameras as they are known now.
    """

    capture: Capture

    def put(self, changed: Mapping[int, Camera]) -> None:
        """Other cameras in the places of some, by index."""
        self.capture = self.capture.with_cameras(
            changed.get(i, camera) for i, camera in enumerate(self.capture.cameras)
        )


_LEAST_IMAGES = 3
"""Of a camera: one image fits any exposure and a little of any pose, and two leave a change of the scene's unknown."""


def learnable_cameras(capture: Capture) -> list[int]:
    """Indices of the training cameras that have images at several moments, ascending; none where there is but one.

    An image that alone shows its moment from its place is brighter because the camera's exposure is longer or because
    the scene is brighter there and then: nothing in it says which. A camera that is given such a quantity for each
    image learns the images by heart. In a capture of one moment nothing changes, so that every camera is told from the
    scene by all the others.
    """
    shots = capture.train_shots
    images = Counter(shot.camera for shot in shots)
    least = 1 if len({shot.frame for shot in shots}) == 1 else _LEAST_IMAGES
    learnable = sorted(camera for camera, count in images.items() if count >= least)
    return learnable if len(learnable) > 1 else []


_MOMENTUM, _MEMORY, _TINY = 0.9, 0.99, 1e-15  # Adam's; a camera is drawn in one step of many, so a short memory
_BOUNDS, _ROUNDED = (-1e15, 1e15), 0.01  # of any number in a checkpoint, and of a rotation's own rounding
_ARRAYS = ("moments", "moved", "gathered")


class PoseRefinement:
    """Rotates and moves the training cameras of a rig, a little at every step that draws one.

    The world moves before a camera rather than the camera in the world: by a turn about the scene's centre and a
    shift. What all cameras have in common is taken out again: the whole rig neither turns, moves nor grows, so
    that the scene stays where the held-out cameras, which are never moved, see it. Cameras of a single image are left
    as they were measured (see ``learnable_cameras``), and so is a moving camera.

    Gradients are gathered over as many steps as there are such cameras, then all move at once.

    Attributes:
        moments: (2, C, 6) Adam's moments of the gradients by camera: three of rotation, three of translation.
        moved: (C, 2) times that each camera was moved, and the training's progress at the last of them.
        gathered: (C, 13) sum of the gradients (3, 4) since then by row, and of how many steps.

    Args:
        rig: whose capture is as it was opened.
        recipe: ``pose_reach`` and ``pose_from``.
        center: (3,) of the scene, world units.
        distance: from which cameras see it, world units.
    """

    def __init__(self, rig: CameraRig, recipe: Recipe, center: NDArray[np.float64], distance: float) -> None:
        capture = rig.capture
        self._rig, self._recipe = rig, recipe
        self._center, self._distance = center.astype(np.float64), distance
        self._learned = np.array(learnable_cameras(capture))
        count = len(capture.cameras)
        self.moments, self.gathered = np.zeros((2, count, 6)), np.zeros((count, 13))
        self.moved = np.tile([0.0, recipe.pose_from], (count, 1))
        self._arriving: tuple[int, OnItsWay, float] | None = None

    def learns(self, camera: int, progress: float) -> bool:
        """Whether a step that draws this camera at ``progress`` needs the gradient of its pose."""
        return progress > self._recipe.pose_from and camera in self._learned

    def observe(self, index: int, gradient: torch.Tensor, progress: float) -> None:
        """Remembers a step's gradient (3, 4) by a camera's pose; ``synchronize`` adds it, before the next step."""
        self.synchronize()
        self._arriving = index, OnItsWay(gradient), progress

    def synchronize(self) -> None:
        """Adds the last step's gradient, if it was not, and moves the cameras when enough have been gathered."""
        if self._arriving is None:
            return
        index, gradient, progress = self._arriving
        self._arriving = None
        self.gathered[index, :12] += gradient.here().numpy().ravel()
        self.gathered[index, 12] += 1
        if self.gathered[:, 12].sum() >= len(self._learned):
            self._step(progress)

    def forget(self) -> None:
        """Leaves the last step's gradient out: that step is made again."""
        self._arriving = None

    def _step(self, progress: float) -> None:
        """One step of Adam for each camera that was drawn, as long as the training that went by since its last one."""
        drawn = self.gathered[:, 12].nonzero()[0]
        means = self.gathered[drawn, :12] / self.gathered[drawn, 12:]
        self.gathered[:] = 0.0
        if not np.isfinite(means).all():
            return  # the loss's own check says so
        cameras = [self._rig.capture.cameras[index] for index in drawn]
        slopes = np.array([self._slope(*pair) for pair in zip(cameras, means.reshape(-1, 3, 4), strict=True)])
        self.moved[drawn, 0] += 1
        last = self.moved[drawn, 1]
        self.moved[drawn, 1] = np.maximum(last, progress)
        counts, since = self.moved[drawn, :1], (self.moved[drawn, 1] - last)[:, None]
        first = _MOMENTUM * self.moments[0, drawn] + (1 - _MOMENTUM) * slopes
        second = _MEMORY * self.moments[1, drawn] + (1 - _MEMORY) * slopes**2
        self.moments[:, drawn] = first, second
        directions = (first / (1 - _MOMENTUM**counts)) / (np.sqrt(second / (1 - _MEMORY**counts)) + _TINY)
        widths = np.array([[camera.width / camera.intrinsics[0, 0]] for camera in cameras])  # of the images, radians
        lengths = self._recipe.pose_reach * widths * 2 * (1 - progress) * since
        changes = np.zeros_like(self.moments[0])
        changes[drawn] = -lengths * directions * np.repeat([1.0, self._distance], 3)
        centers = np.array([self._rig.capture.cameras[index].center for index in self._learned])
        self._move(without_common(changes[self._learned], centers))

    def _slope(self, camera: Camera, gradient: NDArray[np.float64]) -> NDArray[np.float64]:
        """(6,) of the loss by the world's turn about the centre and its shift in distances, as this camera sees it."""
        by_shift = gradient[:, 3] @ camera.rotation
        by_rotation = camera.rotation.T @ gradient[:, :3] - by_shift[:, None] * self._center
        by_turn = (by_rotation - by_rotation.T)[(2, 0, 1), (1, 2, 0)]
        return np.concatenate([by_turn, by_shift * self._distance])

    def _move(self, changes: NDArray[np.float64]) -> None:
        """Moves the world before the learned cameras: (L, 6) radians about the centre, and world units."""
        cameras, moved = self._rig.capture.cameras, dict[int, Camera]()
        for index, change in zip(self._learned, changes, strict=True):
            pose = cameras[index].world_to_camera[:3]
            center = pose[:, :3] @ self._center + pose[:, 3]  # which stays in its place but for the shift
            rotation = pose[:, :3] @ rotation_about(change[:3])
            shift = center + rotation @ (change[3:] - self._center)
            moved[index] = cameras[index].with_pose(np.column_stack([rotation, shift]))
        self._rig.put(moved)

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        poses = np.stack([camera.world_to_camera for camera in self._rig.capture.cameras])
        arrays = {f"poses.{name}": torch.from_numpy(getattr(self, name)) for name in _ARRAYS}
        return {"poses": torch.from_numpy(poses), **arrays}, {}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
        for name in _ARRAYS:
            shape = getattr(self, name).shape
            setattr(self, name, expect(name, tensors[f"poses.{name}"], shape, torch.float64, _BOUNDS).numpy())
        self._arriving = None
        count = len(self._rig.capture.cameras)
        poses = expect("poses", tensors["poses"], (count, 4, 4), torch.float64, _BOUNDS).numpy()
        turns = poses[:, :3, :3]
        if not (np.abs(turns @ turns.swapaxes(1, 2) - np.eye(3)) < _ROUNDED).all():
            raise ValueError("poses that do not only turn and shift")
        if (self.moments[1] < 0).any() or (self.moved < 0).any() or (self.gathered[:, 12] < 0).any():
            raise ValueError("squares or counts below zero")
        pairs = zip(self._rig.capture.cameras, poses, strict=True)
        self._rig.capture = self._rig.capture.with_cameras(camera.with_pose(pose) for camera, pose in pairs)

    def begin_at(self, progress: float) -> None:
        """After a jump of the training's progress to ``progress``: no camera's step spans what lies before."""
        self.moved[:, 1] = max(progress, self._recipe.pose_from)


def without_common(changes: NDArray[np.float64], centers: NDArray[np.float64]) -> NDArray[np.float64]:
    """(L, 6) changes of cameras with ``centers`` (L, 3) without what all of them do together."""
    own = np.asarray(changes - changes.mean(axis=0))
    centers = centers - centers.mean(axis=0)
    growth = (own[:, 3:] * centers).sum() / max((centers**2).sum(), _TINY)  # all nearer to the middle, or away
    own[:, 3:] -= growth * centers
    return own


_OBSERVED_EVERY = 3  # steps
_EVERY_PIXEL = 2  # of rows and columns
_EVERY = 0.05  # of the training
EXPOSED_UNTIL = 0.85
"""Fraction of the training after which exposures stay: at its end rates cool down."""
_REMEMBERED = 0.5  # of what was observed before, every time
_NOTICED = 0.03
"""Standard deviation of the exposures' logarithms over the cameras above which they count: of cameras that are alike
what is found spreads by a few thousandths, by two hundredths where they hardly see the same or in the dark."""
_DARKEST, _BRIGHTEST = 0.02, 0.98  # of the display range: what lies beyond is clipped, in whatever exposure
_LARGEST = 4.0  # times as bright, or as dark


class ExposureCompensation:
    """Finds the exposures of a rig's training cameras: factors of red, green and blue by which what they filmed is
    brighter than what was drawn in the same places, gathered over many steps. Differences that matched features show
    are known before the first step, see ``matched_exposures``, and stay: once the scene has learned colours that depend
    on the direction, its drawings no longer tell what is exposure.

    Their median over the cameras is 1, so that the scene is as bright as most cameras see it, whatever a few do.
    Held-out cameras, of which nothing may be learned, have what the training cameras around them suggest (see
    ``expected_exposures``). All are NEUTRAL where cameras are alike, and so are those of a single image (see
    ``learnable_cameras``).

    Attributes:
        sums: (C, 2, 3) brightness of images, and of drawings before their camera's exposure; what is old counts less.

    Args:
        recipe: ``exposure_from``.
        every: fraction of the training between updates.
    """

    def __init__(self, rig: CameraRig, recipe: Recipe, device: torch.device, every: float = _EVERY) -> None:
        self._rig, self._learned = rig, learnable_cameras(rig.capture)
        self._from, self._matched = recipe.exposure_from, False
        self._due = Every(self._from + every, EXPOSED_UNTIL, every)
        self.sums = torch.zeros(len(rig.capture.cameras), 2, 3, device=device)

    def begin(self, store: Images) -> None:
        """Gives the rig's cameras the exposures that matched features show, where those differ for certain."""
        if (matched := matched_exposures(self._rig.capture, store)) is not None:
            self._expose({index: np.log(factors) for index, factors in matched.items()})
            self._matched = True

    def _expose(self, logs: Mapping[int, NDArray[np.float64]]) -> None:
        """Training cameras by index with logarithms (3,) of their exposures, which are limited."""
        cameras, limit = self._rig.capture.cameras, np.log(_LARGEST)
        known = {index: np.clip(values, -limit, limit) for index, values in logs.items()}
        centers = np.array([camera.center for camera in cameras])
        held_out = [i for i, camera in enumerate(cameras) if camera.name in self._rig.capture.test_cameras]
        expected = expected_exposures(np.array(list(known.values())), centers[list(known)], centers[held_out])
        factors = {i: np.exp(values) for i, values in (known | dict(zip(held_out, expected, strict=True))).items()}
        self._rig.put({index: cameras[index].with_exposure(values) for index, values in factors.items()})

    def observes(self, index: int, step: int, progress: float) -> bool:
        """Whether a step that draws this camera at ``progress`` is to be observed."""
        unknown = not self._matched and index in self._learned
        return unknown and progress >= self._from and step % _OBSERVED_EVERY == 0

    @staticmethod
    def measured(camera: Camera, rgb: torch.Tensor, target: Truth) -> torch.Tensor:
        """(2, 3) brightness of what an image should be and of its drawing (H, W, 3), before the camera's exposure: of
        pixels that are all subject and not ignored."""
        truth = target.colors[::_EVERY_PIXEL, ::_EVERY_PIXEL]
        counts = (truth > _DARKEST) & (truth < _BRIGHTEST)
        if (whole := target.whole) is not None:
            counts &= whole[::_EVERY_PIXEL, ::_EVERY_PIXEL, None]
        drawn = rgb.detach()[::_EVERY_PIXEL, ::_EVERY_PIXEL]
        both = torch.stack([(counts * truth).sum((0, 1)), (counts * drawn).sum((0, 1))])
        if camera.exposure != NEUTRAL:
            both[1] /= gains_of(camera, both)
        return both.nan_to_num(0.0, 0.0, 0.0)  # a non-finite loss has its own check

    def add(self, index: int, brightness: torch.Tensor) -> None:
        """Adds what ``measured`` found of camera ``index``."""
        self.sums[index] += brightness

    def update(self, before: float, now: float) -> None:
        """Gives the rig's cameras the exposures that were observed, where that is due in (before, now]."""
        if self._matched or not self._due.due(before, now):
            return
        truth, drawn = self.sums.cpu()[self._learned].double().numpy().transpose(1, 0, 2)
        self.sums *= _REMEMBERED
        if not ((truth > 0) & (drawn > 0)).all():
            return  # a camera that was not drawn yet, or all black
        logs = np.log(truth) - np.log(drawn)
        logs -= logs.mean(axis=0)
        alike = np.sqrt((logs**2).mean()) < _NOTICED
        logs -= np.median(logs, axis=0)
        self._expose(dict(zip(self._learned, np.zeros_like(logs) if alike else logs, strict=True)))

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        exposures = [camera.exposure for camera in self._rig.capture.cameras]
        tensor = torch.tensor(exposures, dtype=torch.float64, device="cpu")
        return {"exposures": tensor, "exposures.sums": self.sums}, {}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
        capture, sums = self._rig.capture, tensors["exposures.sums"]
        self.sums = expect("sums", sums, tuple(self.sums.shape), within=(0, 1e30)).to(self.sums.device)
        shape, within = (len(capture.cameras), 3), (0.5 / _LARGEST, 2 * _LARGEST)
        exposures = expect("exposures", tensors["exposures"], shape, torch.float64, within)
        pairs = zip(capture.cameras, exposures.numpy(), strict=True)
        self._rig.capture = capture.with_cameras(camera.with_exposure(exposure) for camera, exposure in pairs)


def expected_exposures(
    logs: NDArray[np.float64], centers: NDArray[np.float64], places: NDArray[np.float64]
) -> NDArray[np.float64]:
    """(P, 3) logarithms of exposures at ``places`` (P, 3), by those of the cameras at ``centers`` (L, 3).

    Each is a mean weighted by one over the squared distance (Shepard 1968): cameras side by side see the same lamps and
    walls, and automatic exposure follows these. Zeros where the cameras' own are not told so, each from all
    the others, better than by zeros.
    """

    def weights(some: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(1 / np.maximum(((some[:, None] - centers) ** 2).sum(axis=2), _TINY))

    own = weights(centers)
    np.fill_diagonal(own, 0.0)
    told = own @ logs / own.sum(axis=1, keepdims=True)
    if ((told - logs) ** 2).sum() >= (logs**2).sum():
        return np.zeros((len(places), 3))
    near = weights(places)
    return np.asarray(near @ logs / near.sum(axis=1, keepdims=True))
