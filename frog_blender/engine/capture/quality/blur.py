"""How blurred an image is: what blurring it once more takes from its edges (Crete, Dolmiere, Ladret, Nicolas 2007).

A sharp image loses most of the differences between neighbouring pixels, a blurred one hardly any.
"""

from __future__ import annotations

import numpy as np

from ...arrays import ImageArray
from ..video import load_opencv

_TAPS = 9


def blur_of(gray: ImageArray) -> float:
    """0 (sharp) to 1 (nothing but blur) of brightness (H, W) uint8: of the worse of the two directions.

    NaN for an image without edges.
    """
    cv2 = load_opencv()
    values = gray.astype(np.float32)
    shares = []
    for axis, kernel in ((0, (1, _TAPS)), (1, (_TAPS, 1))):
        before = np.abs(np.diff(values, axis=axis))
        after = np.abs(np.diff(cv2.blur(values, kernel), axis=axis))
        total = float(before.sum())
        if total < 0.5 * before.size**0.5:
            return float("nan")
        shares.append((total - float(np.maximum(before - after, 0).sum())) / total)
    return max(shares)
