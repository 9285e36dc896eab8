"""Camera poses that are learned with the scene: calibrations are never exact, and a pixel of error blurs everything."""

from __future__ import annotations

import numpy as np
import torch

from ..capture.camera import Camera
from ..capture.capture import Capture
from .device import OnItsWay
from .recipe import Recipe

_MOMENTUM, _MEMORY, _TINY = 0.9, 0.99, 1e-15  # Adam's; a camera is drawn in one step of many, so a short memory


class PoseRefinement:
    """Turns and moves the training cameras of a rig, a little at every step that draws one.

    The world moves before a camera rather than the camera in the world: by a turn about the scene's centre and a
    shift. What all cameras have in common is taken out again: the whole rig neither turns, moves nor grows, so
    that the scene stays where the cameras that judge, which are never moved, see it. A single moving camera stays as it
    was measured too, since its withheld moments have no pose but that.

    Attributes:
        capture: the capture with its cameras as they stand now.
        moments: (2, C, 6) Adam's memory of the gradients by camera: three of turning, three of moving.
        drawn: (C, 2) steps that drew each camera, and the training's progress at the last of them.
        uneven: (C, 6) what each was moved by since the common part was taken out.

    Args:
        capture: as it was opened.
        recipe: ``pose_reach`` and ``pose_from``.
        center: (3,) of the scene, world units.
        distance: from which cameras see it, world units.
    """

    def __init__(self, capture: Capture, recipe: Recipe, center: np.ndarray, distance: float) -> None:
        self.capture, self._recipe = capture, recipe
        self._center, self._distance = center.astype(np.float64), distance
        self._moved = np.array(sorted({shot.camera for shot in capture.train_shots}))
        self._moved = self._moved[[capture.cameras[i].name not in capture.test_cameras for i in self._moved]]
        self.moments = np.zeros((2, len(capture.cameras), 6))
        self.uneven = np.zeros((len(capture.cameras), 6))
        self._arriving: tuple[int, OnItsWay, float] | None = None
        self.drawn = np.tile([0.0, recipe.pose_from], (len(capture.cameras), 1))

    @staticmethod
    def wanted(capture: Capture, recipe: Recipe) -> bool:
        """Whether there is a rig to refine."""
        return recipe.pose_reach > 0 and not capture.is_moving and len({s.camera for s in capture.train_shots}) > 1

    def learns(self, camera: int, progress: float) -> bool:
        """Whether a step that draws this camera at ``progress`` needs the gradient of its pose."""
        return progress > self._recipe.pose_from and camera in self._moved

    def observe(self, index: int, gradient: torch.Tensor, progress: float) -> None:
        """Remembers a step's gradient (3, 4) by a camera's pose; ``settle`` moves the camera, before the next step."""
        self.settle()
        self._arriving = index, OnItsWay(gradient), progress

    def settle(self) -> None:
        """Moves the camera that the last step drew, if it has not been."""
        if self._arriving is not None:
            index, gradient, progress = self._arriving
            self._arriving = None
            self.step(index, gradient.here().double().numpy(), progress)

    def step(self, index: int, gradient: np.ndarray, progress: float) -> None:
        """One step of Adam for one camera, as long as the training that went by since its last one.

        Args:
            index: of the camera.
            gradient: (3, 4) of the loss by ``world_to_camera``.
            progress: of the training.
        """
        camera = self.capture.cameras[index]
        slope = self._slope(camera, gradient)
        if not np.isfinite(slope).all():
            return  # the loss's own check says so
        count, before = self.drawn[index] + (1, 0)
        self.drawn[index] = count, progress
        first, second = self.moments[:, index]
        first += (1 - _MOMENTUM) * (slope - first)
        second += (1 - _MEMORY) * (slope**2 - second)
        direction = (first / (1 - _MOMENTUM**count)) / (np.sqrt(second / (1 - _MEMORY**count)) + _TINY)
        width = camera.width / camera.intrinsics[0, 0]  # of the picture, radians
        length = self._recipe.pose_reach * width * 2 * (1 - progress) * (progress - before)
        change = -length * direction * np.repeat([1.0, self._distance], 3)
        self._move({index: change})
        self.uneven[index] += change
        if self.drawn[:, 0].sum() % len(self._moved) == 0:
            self._even_out()

    def _even_out(self) -> None:
        """Takes back what all cameras did in common since it was last taken back."""
        changes = self.uneven[self._moved]
        own = changes - changes.mean(axis=0)
        centers = np.array([self.capture.cameras[index].center for index in self._moved])
        centers -= centers.mean(axis=0)
        growth = (own[:, 3:] * centers).sum() / max((centers**2).sum(), _TINY)  # all nearer to the middle, or away
        own[:, 3:] -= growth * centers
        self._move(dict(zip(self._moved.tolist(), own - changes, strict=True)))
        self.uneven[:] = 0.0

    def _slope(self, camera: Camera, gradient: np.ndarray) -> np.ndarray:
        """(6,) of the loss by the world's turn about the centre and its shift in distances, as this camera sees it."""
        by_rotation, by_shift = camera.rotation.T @ gradient[:, :3], camera.rotation.T @ gradient[:, 3]
        twice = by_rotation - by_rotation.T
        by_turn = np.array([twice[2, 1], twice[0, 2], twice[1, 0]]) - np.cross(self._center, by_shift)
        return np.concatenate([by_turn, by_shift * self._distance])

    def _move(self, changes: dict[int, np.ndarray]) -> None:
        """Moves the world before some cameras: (6,) radians about the centre, and world units."""
        cameras = list(self.capture.cameras)
        for index, change in changes.items():
            camera = cameras[index]
            turned = camera.moved(camera.rotation @ change[:3], np.zeros(3))
            back = (camera.rotation - turned.rotation) @ (self._center - camera.center)  # the centre stays in its place
            cameras[index] = turned.moved(np.zeros(3), back + turned.rotation @ change[3:])
        self.capture = self.capture.with_cameras(cameras)

    def resume(self, poses: np.ndarray, moments: np.ndarray, drawn: np.ndarray, uneven: np.ndarray) -> None:
        """Goes on from poses (C, 4, 4) and the rest; ValueError for arrays that do not fit."""
        if np.shape(poses) != (len(self.capture.cameras), 4, 4):
            raise ValueError(f"poses of {np.shape(poses)} instead of {(len(self.capture.cameras), 4, 4)}")
        for array, own in ((moments, self.moments), (drawn, self.drawn), (uneven, self.uneven)):
            if array.shape != own.shape:
                raise ValueError(f"memory of poses of {array.shape} instead of {own.shape}")
        self.moments, self.drawn, self.uneven, self._arriving = moments.copy(), drawn.copy(), uneven.copy(), None
        pairs = zip(self.capture.cameras, poses, strict=True)
        self.capture = self.capture.with_cameras(camera.with_pose(pose) for camera, pose in pairs)
