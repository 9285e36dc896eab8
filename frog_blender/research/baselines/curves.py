"""SpacetimeGaussians (arXiv 2312.16812, its lite form): each Gaussian has a curve of its own, and no network.

With t_c a Gaussian's temporal centre and d = t - t_c:
    mean(t) = mean + b_1 d + b_2 d^2 + b_3 d^3,   quaternion(t) = quaternion + w d,
    opacity(t) = opacity * exp(-(d / s)^2).

The fifteen numbers are the Gaussian's embedding: b_1, b_2, b_3 (three each), w (four), t_c and log s, each counted from
where a fresh Gaussian begins, in a unit of its own, so that one Adam rate serves all of them (``UNITS``).
"""

import math
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar

import torch

from ... import engine as frog
from .networks import Baseline
from .playback import Playable

EMBEDDING_SIZE = 15
DEGREE = 3


@dataclass(frozen=True)
class CurveSettings:
    """Units of an embedding's numbers; written into the scene file. A whole capture is one unit of time.

    A unit is what the recipe's ``embedding_rate`` is multiplied by, so they stand for rates. The original's, for
    captures of 50 frames: motion 5.6e-4 times the scene's extent (positions' 1.6e-4 times 3.5), rotation and centre
    1e-4, log-width 3e-2. The defaults are to each other as those within a factor of four (how they were found:
    docs/experiments/baselines.md): an ``embedding_rate`` of 8.4e-3 gives the original's rate of motion.

    Attributes:
        motion_units: world units of b_1, b_2 and b_3.
        rotation_unit: of w.
        centre_unit: of t_c, which begins at one half.
        width_unit: of log s.
        first_width: s of a fresh Gaussian, which is there at all times.
    """

    motion_units: tuple[float, float, float]
    rotation_unit: float = 1 / 30
    centre_unit: float = 1 / 30
    width_unit: float = 8 / 3
    first_width: float = 1.0
    changing: ClassVar = frozenset({"means", "quaternions", "base"})


class Curves(Baseline):
    """See the module. The canonical field's embeddings (N, 15) hold all there is of motion."""

    def __init__(self, canonical: frog.CanonicalField, settings: CurveSettings) -> None:
        super().__init__(canonical, settings)
        if canonical.embeddings.shape != (len(canonical), EMBEDDING_SIZE):
            raise ValueError(f"embeddings of {tuple(canonical.embeddings.shape)}, expected {EMBEDDING_SIZE} numbers")

    def deform(self, time: float, schedule_state: frog.ScheduleState = frog.FINISHED) -> frog.Deformed:
        """See SceneModel."""
        c, s = self.canonical, self.settings
        curve, spin, centre, width = c.embeddings.split([3 * DEGREE, 4, 1, 1], dim=1)
        since = time - 0.5 - s.centre_unit * centre  # (N, 1)
        first, second, third = curve.split(3, dim=1)
        one, two, three = s.motion_units
        motion = since * (one * first + since * (two * second + since * (three * third)))
        turn = (s.rotation_unit * since) * spin
        share = since * (torch.exp(-s.width_unit * width) / s.first_width)
        presence = torch.exp(-share.square()).squeeze(1)
        gaussians = frog.GaussianArrays(
            c.means + motion,
            c.quaternions + turn,
            c.log_scales.exp(),
            c.opacity_logits.sigmoid() * presence,
            c.sh[:, : schedule_state.sh_count],
            low_pass=c.low_pass,
        )
        return gaussians, {"means": motion, "quaternions": turn}


def adapted(recipe: frog.Recipe) -> frog.Recipe:
    """The units of its coefficients make the embeddings' rate right for them (see CurveSettings). Its seeds may have
    times, as FRoG's."""
    return replace(frog.plain(recipe, EMBEDDING_SIZE), moment_seeds=recipe.moment_seeds)


def model_of(begin: frog.ModelInit) -> Curves:
    """Before its first step."""
    unit = frog.MOTION_UNIT * begin.scene_scale / 3
    settings = CurveSettings((unit, unit, unit))
    if begin.times is not None:
        _begin_at(begin.canonical.embeddings.data, begin.times, settings)
    return Curves(begin.canonical, settings)


def _begin_at(embeddings: torch.Tensor, times: torch.Tensor, settings: CurveSettings) -> None:
    """Seeds with a time have their temporal centre there, and are seen about as long as it is to the next such time."""
    chosen = torch.isfinite(times)
    width = 1 / (1 + len(times[chosen].unique()))
    embeddings[chosen, -2] = (times[chosen].to(embeddings) - 0.5) / settings.centre_unit
    embeddings[chosen, -1] = math.log(width / settings.first_width) / settings.width_unit


playable = partial(Playable, Curves, CurveSettings)
