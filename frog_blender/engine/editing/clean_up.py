"""Clean Up: which Gaussians to hide that no training image misses, and those that hang alone.

What makes no part of any image is fog from elsewhere; clusters of few Gaussians are floaters. A surface that a single
camera sees is part of a large cluster, and most of what that camera sees there: it stays. As many of both are hidden,
what covers the least first, as the images do not miss: their squared change may raise the scene's mean squared error by
so many dB at most. So a backdrop of a few large Gaussians, which lights what is before it, stays as well.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from ..arrays import Array
from ..capture.camera import Camera
from ..gaussians import NumpyGaussians
from ..playback.importance import camera_weights, sampled_views
from ..playback.player import ScenePlayer
from ..playback.render import draw
from .selections import SEEN, cluster_sizes

DEFAULT_STRENGTH = 0.5
LOOKING, CLUSTERS, _COMPARING = "Looking through the cameras", "Finding what hangs alone", "Comparing images"
CLEANING = ((LOOKING, 2.7), (CLUSTERS, 0.9), (_COMPARING, 12.0))
"""Its stages, and the seconds that each may take."""
Tell = Callable[[str, float], None]
_LEAST_SHARE = 0.004  # of a scene's Gaussians, at full strength, that a cluster must have
_MOST_LOSS = 0.02  # dB, at full strength
_UNKNOWN_PSNR = 30.0  # of a scene that does not say how well it was trained
_MOST_VIEWS = 12
_LONGEST_SIDE = 240  # pixels
_GROUPS = 12
_TRIALS = 24  # images without some are drawn so many times
_COMPARISONS = 2 * (_GROUPS + _TRIALS)  # at most


@dataclass(frozen=True)
class CleanUp:
    """Attributes:
    hidden: (N,) bool, of the scene's own rows.
    unmissed, floaters: how many are hidden as what.
    """

    hidden: Array
    unmissed: int
    floaters: int


def clean_up(
    scene: ScenePlayer,
    strength: float = DEFAULT_STRENGTH,
    weights: Array | None = None,
    tell: Tell = lambda stage, part: None,
) -> CleanUp:
    """What to hide of a scene.

    Args:
        strength: from 0, nothing, to 1.
        weights: (C, N) ``importance.camera_weights`` of the scene, if they are known. Without cameras floaters alone
            are looked for.
        tell: told one of the stages of CLEANING, and how much of it is done, 0 to 1; it may raise.
    """
    if strength == 0:
        return CleanUp(np.zeros(scene.count, bool), 0, 0)
    weights = camera_weights(scene, partial(tell, LOOKING)) if weights is None else weights
    floating = floaters(scene, _LEAST_SHARE * strength, partial(tell, CLUSTERS))
    if not len(weights):
        return CleanUp(floating, 0, int(floating.sum()))
    peaks = weights.max(axis=0)
    unmissed = (peaks < 2 * SEEN * strength) & ~floating
    allowed = 10 ** (_MOST_LOSS * strength / 10) - 1
    views = _Views(scene, partial(tell, _COMPARING))
    cover = peaks**2 * _areas(scene)
    change = allowed * _squared_error(scene)
    hidden, chosen = np.zeros(scene.count, bool), np.zeros(0, np.int64)
    for candidates, share in ((floating, 0.5), (unmissed, 1.0)):
        order = np.flatnonzero(candidates)
        chosen = views.unmissed(order[np.argsort(cover[order], kind="stable")], share * change, chosen)
    hidden[chosen] = True
    return CleanUp(hidden, int((hidden & unmissed).sum()), int((hidden & floating).sum()))


def floaters(
    scene: ScenePlayer,
    least_share: float = _LEAST_SHARE * DEFAULT_STRENGTH,
    tell: Callable[[float], None] = lambda part: None,
) -> Array:
    """(N,) bool: Gaussians in clusters of fewer than a share of all, at the beginning, the middle and the end.

    What touches something at one of these times belongs to it: an arm is no floater when it is thrown up.
    """
    alone = cluster_sizes(scene, tell) < least_share * scene.count
    return alone if not alone.all() else np.zeros(scene.count, bool)


def _areas(scene: ScenePlayer) -> Array:
    """(N,) how large each Gaussian is to the cameras: its two largest standard deviations by its squared distance from
    the nearest, at most the whole image."""
    gaussians = scene.at(0.5)
    largest = np.sort(gaussians.scales.astype(np.float64), axis=1)[:, 1:].prod(axis=1)
    distance = np.full(scene.count, np.inf)
    for camera in scene.header.cameras:
        np.minimum(distance, np.square(gaussians.means - camera.center).sum(axis=1), out=distance)
    return np.asarray(np.minimum(largest / np.maximum(distance, 1e-12), 1.0))


def _squared_error(scene: ScenePlayer) -> float:
    """The scene's mean squared error, as measured at the end of its training."""
    psnr = scene.header.metrics.get("psnr")
    known = float(psnr) if isinstance(psnr, int | float) and 0 < psnr < 100 else _UNKNOWN_PSNR
    return float(10 ** (-known / 10))


class _Views:
    """Training images of a scene as it is, small, to compare with those without some Gaussians."""

    def __init__(self, scene: ScenePlayer, tell: Callable[[float], None]) -> None:
        self._tell, self._compared = tell, 0
        self._background = scene.header.background
        self._seen: list[tuple[NumpyGaussians, Camera, Array]] = []
        for camera, frame in sampled_views(scene.header, _MOST_VIEWS, trained=True):
            if camera is not None:
                small = camera.scaled(min(1.0, _LONGEST_SIDE / max(camera.width, camera.height)))
                gaussians = scene.at_frame(frame)
                self._seen.append((gaussians, small, self._image(gaussians, small)))

    def unmissed(self, order: Array, allowed: float, hidden: Array) -> Array:
        """``hidden`` and those of ``order`` that may be hidden with them for a mean squared change of at most
        ``allowed``.

        Groups that change images the least for their number come first. One that may not be hidden is halved, so that
        a few that matter are found among many that do not.
        """
        groups = [group for group in np.array_split(order, _GROUPS) if len(group)]
        costs = [self._change(group) / len(group) for group in groups]
        waiting = [groups[index] for index in np.argsort(costs)[::-1]]
        for _ in range(_TRIALS):
            if not waiting:
                break
            group = waiting.pop()
            if self._change(np.concatenate([hidden, group])) <= allowed:
                hidden = np.concatenate([hidden, group])
            elif len(group) > 1:
                middle = len(group) // 2
                waiting += [group[middle:], group[:middle]]
        return hidden

    def _change(self, hidden: Array) -> float:
        """The mean over the images of the mean squared change."""
        self._tell(min(self._compared / _COMPARISONS, 1.0))
        self._compared += 1
        changes = []
        for gaussians, camera, image in self._seen:
            opacities = gaussians.opacities.copy()
            opacities[hidden] = 0
            changed = self._image(replace(gaussians, opacities=opacities), camera)
            changes.append(float(np.square(np.clip(changed, 0, 1) - np.clip(image, 0, 1)).mean()))
        return float(np.mean(changes))

    def _image(self, gaussians: NumpyGaussians, camera: Camera) -> Array:
        return draw(gaussians, camera, self._background).rgb
