"""Exposures that differ between cameras, from the colours of features that two of them see at one time.

Training alone does not find a large difference: a Gaussian that one camera sees takes on that camera's exposure, and
one that several see learns a colour for each direction.
"""

from collections.abc import Iterator

import numpy as np

from ...arrays import Float64s
from ..capture import Capture, Images
from ..epipolar import alike_pairs
from ..video import load_opencv
from .matching import describe, triangulate_pair
from .views import TrainingImages, spread

_LONGEST_SIDE = 480  # pixels
_FRAMES = 3
_PARTNERS = 3  # of a camera
_BLUR = 1.5  # pixels: a match is off by about one
_DARKEST, _BRIGHTEST = 0.03, 0.95  # of the display range: what lies beyond is noise or clipped
_LEAST_MATCHES = 20  # of a pair
_LEAST_ERROR = 0.02  # of a pair's logarithm, however many matches: surfaces shine, lenses darken corners
_TO_SIGMA = 1.2533 * 1.4826  # from the median absolute deviation to the standard error of a median of one value
_NOTICED = 0.03  # standard deviation of the exposures' logarithms: 0.001 to 0.009 was found of rendered cameras, which
# are alike, and 0.066 to 0.26 of four real rigs
_CERTAIN = 2.0  # times its standard error, that the logarithms' deviation has to be
_PRIOR = 1.0  # standard deviation of a logarithm of which nothing is known


def matched_exposures(capture: Capture, store: Images) -> dict[int, Float64s] | None:
    """Factors of red, green and blue (3,) by camera, of the training cameras of a rig; their median is 1.

    None where cameras are alike, or matches do not say for certain that they are not. A camera without matches is as
    bright as the mean. Only training images are read, of one frame after another until the matches suffice.
    """
    images, cameras = TrainingImages(capture, store), capture.train_cameras
    ratios: dict[tuple[int, int], Float64s] = {}
    solved, error = np.zeros((len(cameras), 3)), np.inf
    for frame in spread(sorted(images.by_frame), _FRAMES):
        for first, second, logs in _log_ratios(images, frame):
            pair = cameras.index(first), cameras.index(second)
            ratios[pair] = np.concatenate([ratios.get(pair, np.zeros((0, 3))), logs])
        solved, error = _solved(len(cameras), ratios)
        if _CERTAIN * error <= _NOTICED:
            break
    if np.sqrt((solved**2).mean()) <= max(_NOTICED, _CERTAIN * error):
        return None
    return dict(zip(cameras, np.exp(solved - np.median(solved, axis=0)), strict=True))


def _solved(count: int, ratios: dict[tuple[int, int], Float64s]) -> tuple[Float64s, float]:
    """Logarithms (count, 3) of exposures, of mean zero, and their standard error over all cameras.

    Args:
        count: cameras.
        ratios: by pair of cameras (N, 3) logarithms of the second one's brightness over the first one's.
    """
    rows, values = [np.eye(count) / _PRIOR], [np.zeros((count, 3))]
    for (first, second), logs in ratios.items():
        if len(logs) < _LEAST_MATCHES:
            continue
        middle = np.median(logs, axis=0)
        deviation = _TO_SIGMA * float(np.median(np.abs(logs - middle)))
        error = float(np.hypot(deviation / np.sqrt(len(logs)), _LEAST_ERROR))
        row = np.zeros((1, count))
        row[0, first], row[0, second] = -1 / error, 1 / error
        rows.append(row)
        values.append(middle[None] / error)
    matrix = np.vstack(rows)
    covariance = np.linalg.inv(matrix.T @ matrix)
    solved: Float64s = covariance @ (matrix.T @ np.vstack(values))
    centred = np.eye(count) - 1 / count
    return centred @ solved, float(np.sqrt(np.trace(centred @ covariance @ centred) / count))


def _log_ratios(images: TrainingImages, frame: int) -> Iterator[tuple[int, int, Float64s]]:
    """Pairs of cameras and (N, 3) logarithms of the brightness of what both see, the second's over the first's."""
    cv2 = load_opencv()
    views = images.views(images.by_frame[frame], _LONGEST_SIDE)
    features = [describe(view) for view in views]
    smooth = [cv2.GaussianBlur(view.image, (0, 0), _BLUR) for view in views]
    for i, j in alike_pairs([view.camera for view in views], _PARTNERS):
        points = triangulate_pair(views[i], views[j], (features[i], features[j])).points
        (ours, in_first), (theirs, in_second) = (views[view].camera.sample(points, smooth[view]) for view in (i, j))
        colors = np.concatenate([ours, theirs], axis=1)
        good = in_first & in_second & ((colors > _DARKEST) & (colors < _BRIGHTEST)).all(axis=1)
        first, second = (images.capture.shots[views[view].shot].camera for view in (i, j))
        yield first, second, np.log(theirs[good].astype(np.float64)) - np.log(ours[good])
