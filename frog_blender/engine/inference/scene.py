"""A finished scene, played: time in, Gaussians out. Numpy and the native library alone."""

from __future__ import annotations

import math
import threading
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np

from ..capture.time import frame_to_time
from ..files import SceneFile, SceneHeader, read_scene
from ..rasterizer.arrays import GaussianArrays
from .deformation import PlayableDeformation
from .rest import at_rest, unit
from .rivals import RIVALS

PLAYABLE: dict[str, Callable[[dict[str, np.ndarray], dict], Any]] = {
    "frog": PlayableDeformation,
    "ed3dgs": PlayableDeformation,
    **RIVALS,
}
"""What moves a scene, by the method in its header, unless there is no more in the file than CANONICAL: nothing moves
then. Quaternions may be of any length unless the class has a true ``unit_quaternions``."""

CANONICAL = {"means", "log_scales", "quaternions", "opacity_logits", "sh"}

TIMES_KEPT = 4
"""Times a scene remembers: a render asks for the same one for every view layer, playback for its neighbours."""


class PlayableScene:
    """Stateless to its callers: any time, in any order, from any thread.

    Attributes:
        header: the scene file's header.
        count, moving: Gaussians, and those of them that the method moves.
        sh_degree: of their colours.
    """

    def __init__(self, scene: SceneFile) -> None:
        self.header: SceneHeader = scene.header
        self._arrays = scene.arrays
        self.count = len(scene.arrays["means"])
        nothing_moves = not scene.header.model and scene.arrays.keys() <= CANONICAL
        playable = None if nothing_moves else PLAYABLE.get(scene.header.method)
        self._deformation = playable(scene.arrays, scene.header.model) if playable else None
        self.sh_degree = math.isqrt(scene.arrays["sh"].shape[1]) - 1
        self.moving = int(getattr(self._deformation, "moving", self.count)) if self._deformation is not None else 0
        self._recent: OrderedDict[float, GaussianArrays] = OrderedDict()
        self._lock = threading.Lock()

    @classmethod
    def load(cls, path: str | Path) -> PlayableScene:
        """FrogError in one sentence when the file cannot be used."""
        return cls(read_scene(path))

    def at_frame(self, frame: float) -> GaussianArrays:
        """Gaussians at a frame counted from 0; fractions are legal, frames outside are held."""
        return self.at(frame_to_time(frame, self.header.frame_count))

    def at(self, time: float) -> GaussianArrays:
        """Gaussians at a time in [0, 1] (clamped): unit quaternions, scales and opacities activated.

        The arrays are read-only: others may be shown the same.
        """
        time = min(max(float(time), 0.0), 1.0) if self._deformation is not None else 0.0
        with self._lock:
            known = self._recent.get(time)
            if known is not None:
                self._recent.move_to_end(time)
                return _read_only(known)
            while len(self._recent) >= TIMES_KEPT:
                self._recent.popitem(last=False)  # before the new one is computed, which may use its memory again
        gaussians = _read_only(self._compute(time))
        with self._lock:
            self._recent[time] = gaussians
        return _read_only(gaussians)

    def _compute(self, time: float) -> GaussianArrays:
        if self._deformation is None:
            return at_rest(self._arrays).checked()
        gaussians = self._deformation.at(time)
        if not getattr(self._deformation, "unit_quaternions", False):
            gaussians.quaternions = unit(gaussians.quaternions)
        return gaussians.checked()


def _read_only(gaussians: GaussianArrays) -> GaussianArrays:
    """Other views of the same arrays, which cannot be written through."""
    views = {field.name: getattr(gaussians, field.name).view() for field in fields(GaussianArrays)}
    for view in views.values():
        view.flags.writeable = False
    return GaussianArrays(**views)
