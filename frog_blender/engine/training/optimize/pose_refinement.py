"""Camera poses that are learned with the scene: a pixel of calibration error blurs everything."""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray

from ...capture.camera import Camera, rotation_about
from ...capture.capture import Capture
from ..recipe import Recipe
from .camera_rig import CameraRig
from .device import OnItsWay
from .learnable_cameras import learnable_cameras
from .stateful import Tensors, Values, expect

_MOMENTUM, _MEMORY, _TINY = 0.9, 0.99, 1e-15  # Adam's; a camera is drawn in one step of many, so a short memory
_MOST, _ROUNDED = 1e15, 0.01  # of any number in a checkpoint, and of a rotation's own rounding
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

    @staticmethod
    def wanted(capture: Capture, recipe: Recipe) -> bool:
        """Whether there is a rig to refine."""
        return recipe.pose_reach > 0 and bool(learnable_cameras(capture))

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
        cameras = list(self._rig.capture.cameras)
        for index, change in zip(self._learned, changes, strict=True):
            pose = cameras[index].world_to_camera[:3]
            center = pose[:, :3] @ self._center + pose[:, 3]  # which stays in its place but for the shift
            rotation = pose[:, :3] @ rotation_about(change[:3])
            shift = center + rotation @ (change[3:] - self._center)
            cameras[index] = cameras[index].with_pose(np.column_stack([rotation, shift]))
        self._rig.capture = self._rig.capture.with_cameras(cameras)

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        poses = np.stack([camera.world_to_camera for camera in self._rig.capture.cameras])
        arrays = {f"poses.{name}": torch.from_numpy(getattr(self, name)) for name in _ARRAYS}
        return {"poses": torch.from_numpy(poses), **arrays}, {}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
        for name in _ARRAYS:
            shape = getattr(self, name).shape
            setattr(self, name, expect(name, tensors[f"poses.{name}"], shape, torch.float64).numpy())
        self._arriving = None
        count = len(self._rig.capture.cameras)
        found = expect("poses", tensors["poses"], (count, 4, 4), torch.float64).numpy()
        _check_poses(found)
        if not all((np.abs(array) < _MOST).all() for array in (self.moments, self.gathered, self.moved)):
            raise ValueError("moments of poses that no training has")
        if (self.moments[1] < 0).any() or (self.moved < 0).any() or (self.gathered[:, 12] < 0).any():
            raise ValueError("squares or counts below zero")
        pairs = zip(self._rig.capture.cameras, found, strict=True)
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


def _check_poses(found: NDArray[np.float64]) -> None:
    """ValueError unless (C, 4, 4) turn and shift, and no more."""
    turns = found[:, :3, :3]
    if not (np.abs(found) < _MOST).all() or not (np.abs(turns @ turns.swapaxes(1, 2) - np.eye(3)) < _ROUNDED).all():
        raise ValueError("poses that do not only turn and shift")
