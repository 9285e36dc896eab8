"""Settings of one drawing, and the constants of the blending rule that all implementations share."""

from __future__ import annotations

from dataclasses import dataclass

ALPHA_MIN = 1.0 / 255.0
"""Fainter contributions are skipped."""
ALPHA_MAX = 0.999
"""Alpha is clamped here, and passes no gradient to the Gaussian's shape beyond it."""
TRANSMITTANCE_MIN = 1e-4
"""The Gaussian that would take a pixel's transmittance below this is left out, and so is everything behind it."""


@dataclass(frozen=True)
class RasterizeOptions:
    """What to draw besides RGB and alpha, and how.

    Attributes:
        depth: also median depth, median z and mean depth.
        weights: also each Gaussian's largest blending weight.
        low_pass: variance in pixels squared added to every screen covariance (3DGS: 0.3).
        near_plane: planar depth below which a Gaussian is culled, world units.
    """

    depth: bool = False
    weights: bool = False
    low_pass: float = 0.3
    near_plane: float = 0.01
