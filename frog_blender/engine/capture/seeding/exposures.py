"""Exposures that differ between cameras, from the colours of features that two of them see at one time.

Training alone does not find a large difference: a Gaussian that one camera sees takes on that camera's exposure, and
one that several see learns a colour for each direction.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ...arrays import Float64s
from ..camera import Camera
from ..capture import Capture
from ..video import load_opencv
from .matching import Features, describe, triangulate_pair
from .views import Images, View, load_view, sample_view, spread

_LONGEST_SIDE = 480  # pixels
_FRAMES = 3
_PARTNERS = 3  # of a camera
_BLUR = 1.5  # pixels: a match is off by about one
_DARKEST, _BRIGHTEST = 0.03, 0.95  # of the display range: what lies beyond is noise or clipped
_LEAST_MATCHES = 20  # of a pair
_LEAST_ERROR = 0.02  # of a pair's logarithm, however many matches: surfaces shine, lenses darken corners
_TO_SIGMA = 1.2533 * 1.4826  # from the median absolute deviation to the standard error of a median of one value
_NOTICED = 0.06  # standard deviation of the exposures' logarithms; less is left to the training
_CERTAIN = 4.0  # times its standard error, that the logarithms' deviation has to be
_PRIOR = 1.0  # standard deviation of a logarithm of which nothing is known


def matched_exposures(capture: Capture, store: Images) -> dict[int, Float64s] | None:
    """Factors of red, green and blue (3,) by camera, of the training cameras of a rig; their median is 1.

    None where cameras are alike, or matches do not say for certain that they are not. A camera without matches is as
    bright as the mean. Only training images are read, of one frame after another until the matches suffice.
    """
    cameras = capture.train_cameras
    place = {camera: index for index, camera in enumerate(cameras)}
    ratios: dict[tuple[int, int], Float64s] = {}
    solved, error = np.zeros((len(cameras), 3)), np.inf
    for frame in spread(sorted({shot.frame for shot in capture.train_shots}), _FRAMES):
        for first, second, logs in _log_ratios(capture, store, cameras, frame):
            pair = place[first], place[second]
            ratios[pair] = np.concatenate([ratios.get(pair, np.zeros((0, 3))), logs])
        solved, error = solve_exposures(len(cameras), ratios)
        if _CERTAIN * error <= _NOTICED:
            break
    if np.sqrt((solved**2).mean()) <= max(_NOTICED, _CERTAIN * error):
        return None
    return dict(zip(cameras, np.exp(solved - np.median(solved, axis=0)), strict=True))


def solve_exposures(count: int, ratios: dict[tuple[int, int], Float64s]) -> tuple[Float64s, float]:
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
    matrix, wanted = np.vstack(rows), np.vstack(values)
    covariance = np.linalg.inv(matrix.T @ matrix)
    solved: Float64s = covariance @ (matrix.T @ wanted)
    centred = np.eye(count) - 1 / count
    return centred @ solved, float(np.sqrt(np.trace(centred @ covariance @ centred) / count))


def _log_ratios(capture: Capture, store: Images, cameras: list[int], frame: int) -> Iterator[tuple[int, int, Float64s]]:
    """Pairs of cameras and (N, 3) logarithms of the brightness of what both see, the second's over the first's."""
    cv2 = load_opencv()
    seen: dict[int, tuple[View, Features]] = {}
    for camera in cameras:
        shot = capture.shot_index(camera, frame)
        if shot is not None:
            view = load_view(capture, store, shot, _LONGEST_SIDE)
            seen[camera] = view, describe(view)
    smooth = {camera: cv2.GaussianBlur(view.image, (0, 0), _BLUR) for camera, (view, _) in seen.items()}
    for i, j in _pairs([capture.cameras[camera] for camera in seen]):
        first, second = list(seen)[i], list(seen)[j]
        (view, features), (other, others) = seen[first], seen[second]
        points, _ = triangulate_pair(view, other, (features, others))
        ours, theirs = (sample_view(each, points, smooth[of]) for each, of in ((view, first), (other, second)))
        colors = np.concatenate([ours[0], theirs[0]], axis=1)
        good = ours[1] & theirs[1] & ((colors > _DARKEST) & (colors < _BRIGHTEST)).all(axis=1)
        yield first, second, np.log(theirs[0][good].astype(np.float64)) - np.log(ours[0][good])


def _pairs(cameras: list[Camera]) -> list[tuple[int, int]]:
    """Each camera with those that look in directions nearest to its own."""
    if len(cameras) < 2:
        return []
    forwards = np.array([camera.forward for camera in cameras])
    alike = forwards @ forwards.T
    np.fill_diagonal(alike, -2.0)
    nearest = np.argsort(-alike, axis=1, kind="stable")[:, : min(_PARTNERS, len(cameras) - 1)]
    return sorted({(min(i, int(j)), max(i, int(j))) for i, row in enumerate(nearest) for j in row})
