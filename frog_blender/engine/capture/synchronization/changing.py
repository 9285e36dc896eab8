"""Where a standing camera's film changes: what moves, and nothing of the background."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...arrays import ImageArray
from ..video import load_opencv

SAMPLES = 30
"""Frames that suffice to tell the background from what moves."""
_DEVIATION = 6.0  # gray levels of 255: more than what encoders and sensors add
_MARGIN = 0.008  # of the width: features on an outline have their centre beside it


def changing_region(images: Sequence[ImageArray]) -> ImageArray:
    """(H, W) uint8 mask, 255 where gray images (each (H, W) uint8) of one view deviate from their median."""
    cv2 = load_opencv()
    stack = np.stack([cv2.GaussianBlur(image, (0, 0), 1.0) for image in images])
    median = np.median(stack, axis=0).astype(np.float32)
    # A high percentile, not the mean: a hand that passes once changes a pixel in few of the images.
    deviation = np.percentile(np.abs(stack.astype(np.float32) - median), 90, axis=0)
    mask = (deviation > _DEVIATION).astype(np.uint8) * 255
    mask = cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    radius = max(2, round(_MARGIN * mask.shape[1]))
    shape = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * radius + 1, 2 * radius + 1))
    grown: ImageArray = cv2.dilate(mask, shape)
    return grown
