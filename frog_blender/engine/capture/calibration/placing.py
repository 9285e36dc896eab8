"""Cameras from images: features, matches and structure from motion, in processes of their own, each stage kept.

Features are SIFT's, those of a standing camera's background and of what moves at each common time, pooled, or of single
images. The same point in two images are mutual nearest neighbours of one geometry. pycolmap finds features inside
Python's lock, so that threads win nothing: several processes share the cameras.
"""

import os
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations, product
from pathlib import Path

import numpy as np

from ...arrays import Array, Bools, Float32s, Float64s, ImageArray, Ints
from ...io.child_process import Progress
from ...io.work_folder import WorkFolder, key_of
from ..epipolar import mutual
from ..readers.footage import footage_at
from ..synchronization.films import CalibrationRefused, Film, Run, spread
from ..video import load_opencv, read_gray, shrunk
from . import checks
from .colmap import load_pycolmap, verified
from .model import Calibration, Lens, MovingCamera, Pairs, oriented
from .sequences import ImageSequence
from .structure import Images, Solution, solve
from .views import LONGEST_SIDE, CameraFacts, views_of

_MOST_PROCESSES = 8  # each holds pycolmap and a camera's images
BACKGROUND = -1
"""The moment of features that are there at all times."""
_PEAK = 0.003  # COLMAP's 0.0067 loses small and dark images
_MOST = 4096  # features of an image
_SMALL = 900  # pixels of the longer side up to which features are sought at twice the size as well
_MARGIN = 24  # pixels around a mask that its features see
_RATIO = 0.8
_EXHAUSTIVE = 60
"""Images of one sequence up to which every pair is matched."""
_OVERLAP = 10  # neighbours in time that an image is matched with, besides those 16, 32, ... images away
_ACROSS = 600  # pairs of images of two sequences


def place_films(run: Run, sequences: Sequence[ImageSequence], films: Sequence[Film], count: int) -> Calibration:
    """The cameras of standing cameras' films, by what does not move and what moves at so many common times.

    Args:
        sequences: walk-throughs of what the films show, which connect them.

    Raises:
        CalibrationRefused: if the films do not fix their cameras: why, and what to film next time.
        FrogError: if a film cannot be decoded, pycolmap is missing, or its process died.
    """
    views = views_of(run, films, count)
    missing = [view for view in views if not run.work.file("features", view.key).is_file()]
    processes = min(_MOST_PROCESSES, os.cpu_count() or 1, len(missing))
    if processes > 1:  # pycolmap finds features inside Python's lock
        parts = [missing[part::processes] for part in range(processes)]
        run.in_threads("features", lambda part: run.in_child(find_features, part, run.work), parts)
    return run.in_child(place_standing, views, sequences, run.work)


def place_standing(
    views: Sequence[CameraFacts], sequences: Sequence[ImageSequence], work: WorkFolder, tell: Progress
) -> Calibration:
    """The standing cameras in their own world, in the child; the images of a walk-through only connect them."""
    solution, images, matches = _solved(views, sequences, work, tell)
    names = [view.name for view in views]
    if why := checks.refusal(solution, images, matches, names):
        raise CalibrationRefused(why)
    calibration = checks.calibration_of(names, solution.adjusted, least=3 if images.connected else 2)
    pairs = tuple(checks.pair_support(solution, images, matches))
    told = tuple(checks.warnings(solution, images, calibration.cameras))
    return replace(calibration, pairs=pairs, halves_apart=solution.halves_apart, warnings=told)


def place_moving(sequence: ImageSequence, work: WorkFolder, tell: Progress) -> MovingCamera:
    """A pose for each image of a moving camera that has one, and its lens, in the child.

    Raises:
        CalibrationRefused: if the images do not fix their camera.
        FrogError: for an image that cannot be read.
    """
    solution, images, matches = _solved((), [sequence], work, tell)
    if why := checks.moving_refusal(solution, len(images.lenses)):
        raise CalibrationRefused(why)
    adjusted = solution.adjusted
    share = checks.moving_share(images, adjusted.model, matches)
    model, points = oriented(adjusted.model, adjusted.points)
    return MovingCamera(
        model.lenses[model.placed[0]],
        tuple(model.placed),
        model.poses[model.placed],
        points[adjusted.sure_points(3)].round(4),
        float(np.median(adjusted.distances[adjusted.agree])),
        adjusted.unsure,
        solution.halves_apart,
        tuple(checks.moving_warnings(solution, len(images.lenses), share)),
    )


def _solved(
    views: Sequence[CameraFacts], sequences: Sequence[ImageSequence], work: WorkFolder, tell: Progress
) -> tuple[Solution, Images, Pairs]:
    """Structure from motion of standing views, of image sequences, or of both in one world; and the matches."""
    files = [(path, sequence) for sequence in sequences for path in sequence.images]
    asked = [partial(view_features, work, view) for view in views]
    asked += [partial(image_features, work, path, sequence.size) for path, sequence in files]
    features = []
    for index, ask in enumerate(asked):
        tell("features", index, len(asked))
        features.append(ask())
    first = 1 + max((view.group for view in views), default=-1)  # a camera that moves may stabilise its images
    sizes = [view.size for view in views] + [sequence.size for _, sequence in files]
    images = Images(
        tuple(Lens(*size, 1.2 * size[0]) for size in sizes),
        (*(view.group for view in views), *(first + sequence.group for _, sequence in files)),
        tuple(own.pixels for own in features),
        len(views),
    )
    lengths = [1] * len(views) + [len(sequence.images) for sequence in sequences]
    compared = pairs_to_match(lengths)

    def matched() -> dict[str, Array]:
        matches, checked = match_pairs(features, images.lenses, compared, tell)
        return _flat(matches, "matches") | _flat(checked, "verified")

    key = key_of([view.key for view in views], [footage_at(path).state for path, _ in files], lengths)
    kept = work.kept("pairs", key, matched)
    matches, checked = (
        dict(zip(compared, np.split(kept[name], kept[f"{name}_ends"]), strict=False))
        for name in ("matches", "verified")
    )
    return solve(images, matches, checked, tell), images, matches


def _flat(pairs: Pairs, name: str) -> dict[str, Array]:
    """Matches in two arrays: all of them, and where each pair's end."""
    rows = list(pairs.values())
    ends = np.cumsum([len(matches) for matches in rows])[:-1]
    return {name: np.concatenate([np.empty((0, 2), np.int64), *rows]), f"{name}_ends": np.array(ends, np.int64)}


# --- features


@dataclass(frozen=True, eq=False)
class Features:
    """Features of one camera.

    Attributes:
        pixels: (N, 2) float64 in the film's own pixels; the centre of the first is (0.5, 0.5).
        descriptors: (N, 128) uint8.
        moments: (N,) int64 index of the common time, or BACKGROUND.
    """

    pixels: Array
    descriptors: ImageArray
    moments: Ints


def view_features(work: WorkFolder, camera: CameraFacts) -> Features:
    """All features of a standing camera, in pixels of its film, of an earlier run or new."""

    def found() -> dict[str, Array]:
        view = camera.view(work)
        parts = [_within(view.background, ~view.changing), *(_within(image, view.changing) for image in view.images)]
        pixels, descriptors = (np.concatenate(part) for part in zip(*parts, strict=True))
        return {
            "pixels": pixels * (np.array(camera.size) / view.background.shape[::-1]),
            "descriptors": descriptors,
            "moments": np.repeat([BACKGROUND, *view.moments], [len(part[0]) for part in parts]),
        }

    return Features(**work.kept("features", camera.key, found))


def find_features(cameras: Sequence[CameraFacts], work: WorkFolder, tell: Progress) -> None:
    """Keeps the features of standing cameras, for ``view_features``."""
    load_opencv().setNumThreads(1)  # the other processors are taken by the other processes
    for index, camera in enumerate(cameras):
        tell("features", index, len(cameras))
        view_features(work, camera)


def image_features(work: WorkFolder, path: Path, size: tuple[int, int]) -> Features:
    """The features of an image file of a camera that moves, of an earlier run or new; FrogError if it is unreadable."""

    def found() -> dict[str, Array]:
        gray = shrunk(read_gray(path), LONGEST_SIDE)
        pixels, descriptors = _sift(gray, max(gray.shape))
        pixels = pixels * (np.array(size) / gray.shape[::-1])
        return {"pixels": pixels, "descriptors": descriptors, "moments": np.full(len(pixels), BACKGROUND)}

    return Features(**work.kept("image", key_of(footage_at(path).state), found))


def _within(image: ImageArray, mask: Bools) -> tuple[Float64s, ImageArray]:
    """Those of an image within a mask (H, W); of the rest all would be thrown away."""
    if not mask.any():
        return np.empty((0, 2)), np.empty((0, 128), np.uint8)
    rows, columns = (np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0))
    top, left = max(int(rows[0]) - _MARGIN, 0), max(int(columns[0]) - _MARGIN, 0)
    pixels, descriptors = _sift(image[top : rows[-1] + _MARGIN, left : columns[-1] + _MARGIN], max(image.shape))
    pixels = pixels + np.array([left, top])
    column, row = pixels.astype(int).clip(0, [image.shape[1] - 1, image.shape[0] - 1]).T
    inside = mask[row, column]
    return pixels[inside], descriptors[inside]


def _sift(image: ImageArray, side: int) -> tuple[Float64s, ImageArray]:
    """Pixels (N, 2) and descriptors (N, 128) by pycolmap on the CPU, of an image (H, W) or a part of one of that side.

    OpenCV's lie a quarter of a pixel to the right and below: never mix them.
    """
    pycolmap = load_pycolmap()
    options = pycolmap.FeatureExtractionOptions()
    options.sift.peak_threshold = _PEAK
    options.sift.max_num_features = _MOST
    options.sift.first_octave = -1 if side < _SMALL else 0
    options.use_gpu = False
    extractor = pycolmap.FeatureExtractor.create(options, pycolmap.Device.cpu)
    keypoints, descriptors = extractor.extract_from_uint8_array(np.ascontiguousarray(image))
    pixels = np.asarray(pycolmap.keypoints_to_matrix(keypoints), np.float64)[:, :2]
    return pixels, np.asarray(descriptors.data, np.uint8)


# --- matches


def pairs_to_match(lengths: Sequence[int]) -> list[tuple[int, int]]:
    """Pairs of images to match, of sequences one after the other, a camera that stands being one of one image.

    Within a sequence they are those of COLMAP's sequential pairing with quadratic overlap, between two all of few, else
    those of evenly spread images.
    """
    starts = np.cumsum([0, *lengths]).tolist()
    steps = sorted({*range(1, _OVERLAP + 1), *(2**power for power in range(4, 12))})
    pairs: list[tuple[int, int]] = []
    for start, length in zip(starts, lengths, strict=False):
        near = range(1, length) if length <= _EXHAUSTIVE else steps
        pairs += [(start + one, start + one + step) for one in range(length) for step in near if one + step < length]
    for one, other in combinations(range(len(lengths)), 2):
        share = min(1.0, (_ACROSS / (lengths[one] * lengths[other])) ** 0.5)
        chosen = (spread(lengths[index], max(1, round(share * lengths[index]))) for index in (one, other))
        pairs += [(starts[one] + i, starts[other] + j) for i, j in product(*chosen)]
    return sorted(pairs)


def match_pairs(
    features: Sequence[Features], lenses: Sequence[Lens], pairs: Sequence[tuple[int, int]], tell: Progress
) -> tuple[Pairs, Pairs]:
    """The matches of pairs of images, and those that pass the two-view check."""

    def of_pair(pair: tuple[int, int]) -> tuple[Ints, Ints]:
        one, other = pair
        rows = match(features[one], features[other])
        return rows, verified(lenses[one], features[one].pixels, lenses[other], features[other].pixels, rows)

    matches, checked = {}, {}
    with ThreadPoolExecutor(os.cpu_count()) as threads:  # numpy and pycolmap compute outside Python's lock
        for index, (pair, (rows, good)) in enumerate(zip(pairs, threads.map(of_pair, pairs), strict=True)):
            tell("matches", index, len(pairs))
            matches[pair], checked[pair] = rows, good
    return matches, checked


def match(one: Features, other: Features) -> Ints:
    """(M, 2) int64 indices of matching features; only features of one moment are compared."""
    matches = [np.empty((0, 2), np.int64)]
    for moment in np.intersect1d(one.moments, other.moments):
        here, there = np.flatnonzero(one.moments == moment), np.flatnonzero(other.moments == moment)
        if min(len(here), len(there)) > 1:
            likeness = _unit(one.descriptors[here]) @ _unit(other.descriptors[there]).T
            nearest, likest = mutual(likeness, _RATIO)
            matches.append(np.stack([here[nearest], there[likest]], axis=1))
    return np.concatenate(matches)


def _unit(descriptors: ImageArray) -> Float32s:
    values = descriptors.astype(np.float32)
    values /= np.maximum(np.linalg.norm(values, axis=1, keepdims=True), 1e-6)
    return values
