"""The sRGB transfer curve (IEC 61966-2-1), for arrays of any shape and floating-point type."""

import numpy as np

from .arrays import Array


def srgb_to_linear(display: Array) -> Array:
    """Linear light of display-referred values, not negative; values above one continue along the same curve."""
    return np.where(display <= 0.04045, display / 12.92, ((display + 0.055) / 1.055) ** 2.4)


def linear_to_srgb(linear: Array) -> Array:
    """Display-referred values of linear light, not negative: the inverse of ``srgb_to_linear``."""
    return np.where(linear <= 0.0031308, linear * 12.92, 1.055 * linear ** (1 / 2.4) - 0.055)
