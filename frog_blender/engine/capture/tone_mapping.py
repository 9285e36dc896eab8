"""Films of high dynamic range (HLG and PQ, ITU-R BT.2100) to the display-referred sRGB of everything else.

Light is measured in units of the reference white, 203 cd/m2 (ITU-R BT.2408), the wide gamut (BT.2020) is brought to
sRGB's, and highlights are rolled off by Reinhard's extended operator (2002, equation 4), so that 1000 cd/m2 are white.
"""

import numpy as np
from numpy.typing import NDArray

from ..arrays import Float32s, ImageArray
from ..srgb import linear_to_srgb

NAMES = {"hlg": "HLG", "pq": "PQ"}
"""Curves that are tone-mapped, by their names in ``FilmHeader.transfer``, as people know them."""
_REFERENCE_WHITE, _PEAK = 203.0, 1000.0  # cd/m2
_LEVELS = 4096  # of the tables

_WIDE_LUMINANCE = np.array([0.2627, 0.6780, 0.0593], np.float32)
_LUMINANCE = np.array([0.2126, 0.7152, 0.0722], np.float32)
# Linear light of BT.2020 to that of BT.709 (ITU-R BT.2087)
_TO_SRGB = np.array(
    [[1.660491, -0.587641, -0.072850], [-0.124550, 1.132900, -0.008349], [-0.018151, -0.100579, 1.118730]], np.float32
)


class ToneMapping:
    """Decoded images of one curve to sRGB."""

    def __init__(self, transfer: str) -> None:
        """``transfer``: "hlg" or "pq"."""
        signal = np.linspace(0.0, 1.0, _LEVELS)
        self._is_hlg = transfer == "hlg"
        light = _hlg_light(signal) if self._is_hlg else _pq_light(signal) / _REFERENCE_WHITE
        self._light: Float32s = light.astype(np.float32)
        # By the square root of light: dark tones need more steps.
        self._display = (linear_to_srgb(np.linspace(0.0, 1.0, _LEVELS) ** 2) * 255 + 0.5).astype(np.uint8)

    def apply(self, image: ImageArray) -> ImageArray:
        """(H, W, 3) uint8 sRGB of an image (H, W, 3) uint8, the curve's signal of BT.2020's red, green and blue."""
        signal = image.reshape(-1, 3).astype(np.float32) / np.float32(255)
        light = self._light[_levels(signal)]
        if self._is_hlg:  # the display's gamma of 1.2 acts on luminance
            luminance = np.maximum(light @ _WIDE_LUMINANCE, np.float32(1e-6))
            light *= (np.float32(_PEAK / _REFERENCE_WHITE) * luminance ** np.float32(0.2))[:, None]
        narrow = np.maximum(light @ _TO_SRGB.T, 0)
        luminance, white = narrow @ _LUMINANCE, np.float32(_PEAK / _REFERENCE_WHITE)
        narrow *= ((1 + luminance / white**2) / (1 + luminance))[:, None]
        return self._display[_levels(np.sqrt(narrow))].reshape(image.shape)


def _levels(values: Float32s) -> NDArray[np.uint16]:
    return (values.clip(0, 1) * np.float32(_LEVELS - 1) + np.float32(0.5)).astype(np.uint16)


def _hlg_light(signal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Scene light in [0, 1] of a signal: the inverse of BT.2100's OETF."""
    a, b, c = 0.17883277, 0.28466892, 0.55991073
    return np.where(signal <= 0.5, signal**2 / 3, (np.exp((signal - c) / a) + b) / 12)


def _pq_light(signal: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displayed light in cd/m2 of a signal: BT.2100's EOTF."""
    m1, m2, c1, c2, c3 = 0.1593017578125, 78.84375, 0.8359375, 18.8515625, 18.6875
    root = signal ** (1 / m2)
    return np.asarray(10_000 * (np.maximum(root - c1, 0) / (c2 - c3 * root)) ** (1 / m1))
