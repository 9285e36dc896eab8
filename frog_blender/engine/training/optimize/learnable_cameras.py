"""Of which cameras exposure and pose can be told from what the scene does."""

from __future__ import annotations

from collections import Counter

from ...capture.capture import Capture

_LEAST_IMAGES = 3
"""Of a camera: one image fits any exposure and a little of any pose, and two leave a change of the scene's unknown."""


def learnable_cameras(capture: Capture) -> list[int]:
    """Indices of the training cameras that have images at several moments, ascending; none where there is but one.

    An image that alone shows its moment from its place is brighter because the camera's exposure is longer or because
    the scene is brighter there and then: nothing in it says which. A camera that is given such a quantity for each
    image learns the images by heart. In a capture of one moment nothing changes, so that every camera is told from the
    scene by all the others.
    """
    shots = capture.train_shots
    images = Counter(shot.camera for shot in shots)
    least = 1 if len({shot.frame for shot in shots}) == 1 else _LEAST_IMAGES
    found = sorted(camera for camera, count in images.items() if count >= least)
    return found if len(found) > 1 else []
