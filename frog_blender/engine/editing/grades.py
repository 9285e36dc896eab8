"""A colour grade as one matrix, which spherical harmonics pass through without loss.

Everything happens in the scene's own display-referred sRGB, in which Gaussians are blended: a colour c becomes A c + b.
What a camera sees is linear in the coefficients, so the grade of a coefficient is exact, and costs nothing per pixel.
"""

import math
from dataclasses import dataclass, fields

import numpy as np

from ..arrays import Array
from ..spherical_harmonics import SH_DC
from .marks import Marks

GAMMA = 2.2
"""The display's: a stop of exposure is this root of two in its values."""
LUMA = (0.2126, 0.7152, 0.0722)
"""Rec. 709's weights, of sRGB."""
RANGES = {
    "exposure": (-20.0, 20.0),
    "contrast": (0.0, 10.0),
    "saturation": (0.0, 10.0),
    "temperature": (-4.0, 4.0),
    "tint": (-4.0, 4.0),
    "opacity": (0.0, 100.0),
    "size": (0.0, 100.0),
}
"""Smallest and largest value of each setting of a grade, which files and drivers are held to."""
_Row = tuple[float, float, float]


@dataclass(frozen=True)
class Grade:
    """A grade; the settings' own values change nothing.

    Attributes:
        exposure: in stops.
        contrast: factor about middle grey (one half).
        saturation: factor of the distance from grey of the same luma; 0 for none.
        temperature: in stops between red and blue; positive is warmer.
        tint: in stops between green and magenta; positive is more magenta.
        opacity, size: factors; opacities end at 1.
        gains, offsets: (3,) factors and summands of red, green and blue after the others, for matching.
        only: the Gaussians that it is for; None for all.

    Raises:
        ValueError: for gains or offsets that cannot be.
    """

    exposure: float = 0.0
    contrast: float = 1.0
    saturation: float = 1.0
    temperature: float = 0.0
    tint: float = 0.0
    opacity: float = 1.0
    size: float = 1.0
    gains: _Row = (1.0, 1.0, 1.0)
    offsets: _Row = (0.0, 0.0, 0.0)
    only: Marks | None = None

    def __post_init__(self) -> None:
        for name in ("gains", "offsets"):
            values = getattr(self, name)
            if len(values) != 3 or not all(math.isfinite(value) and abs(value) <= 100 for value in values):
                raise ValueError(f"a grade whose {name} are {values}; three numbers up to 100 are possible")

    @property
    def is_neutral(self) -> bool:
        """Whether it changes nothing."""
        return all(getattr(self, field.name) == field.default for field in fields(self) if field.name != "only")

    def colors(self) -> tuple[Array, Array]:
        """(3, 3) A and (3,) b, float64, of c -> A c + b on display-referred colours."""
        luma = np.array(LUMA)
        gains = 2.0 ** np.array([self.temperature / 2, -self.tint / 2, -self.temperature / 2])
        gains = gains / (gains @ luma) * 2.0 ** (self.exposure / GAMMA)  # grey keeps its luma but for the exposure
        matrix = self.saturation * np.eye(3) + (1 - self.saturation) * np.tile(luma, (3, 1))
        matrix = self.contrast * matrix @ np.diag(gains)
        offset = np.full(3, 0.5 * (1 - self.contrast))
        after = np.array(self.gains)
        return after[:, None] * matrix, after * offset + np.array(self.offsets)


NOTHING = Grade(opacity=0.0)
"""After which nothing is seen."""


def of_coefficients(matrix: Array, offset: Array) -> tuple[Array, Array]:
    """(3, 3) and (3,) float32: what a first SH coefficient is multiplied by from the right, and what is added to it.
    Further coefficients are multiplied alone."""
    shift = (matrix @ np.full(3, 0.5) + offset - 0.5) / SH_DC
    return np.ascontiguousarray(matrix.T, np.float32), shift.astype(np.float32)
