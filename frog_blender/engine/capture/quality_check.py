"""Whether a capture can be trained on, measured in its images before an hour is spent: ``frog info --check``.

A few images of every camera are looked at: do matching features of two views lie on each other's epipolar lines, when
do moving ones, how bright and how blurred are they?
"""

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from math import isnan, nan
from pathlib import Path

import numpy as np

from ..arrays import Bools, Float64s, Ints
from ..errors import listed
from .capture import Capture
from .epipolar import fundamental, line_distances, mutual
from .media import read_film_header, watch
from .quality_samples import Sample, choose_pairs, take_samples
from .seeding.matching import RATIO
from .seeding.views import parallax, scene_depth
from .video import VIDEO_SUFFIXES, load_opencv

_RANSAC_PIXELS = 1.5
_ENOUGH = 20  # matches on which a fundamental matrix agrees
_ENOUGH_MOVING = 10
_NEAR = 0.02  # of the longest side: matches of moving points farther from their lines are wrong
_CROSSING = 0.25  # pixels a frame, across the epipolar line: slower points say nothing about time
_CHANGE = 6.0  # of 255, from one frame to the next: motion
_CERTAIN = 0.12  # frames
_SHARE = 0.3  # of the matches, that a fundamental matrix must explain


@dataclass(frozen=True)
class PairCheck:
    """Two cameras over the frames that were looked at; of a moving camera two images.

    Attributes:
        first, second: their names.
        matches: points on which a fundamental matrix of their own agrees, whatever the calibration says.
        distance: their median distance in pixels of the capture's images from the epipolar lines of the calibration;
            NaN for too few of them.
        offset: frames by which the second camera shows what moves later than the first does; NaN where too little
            moves.
        gain: brightness of the second over the first; NaN for too few matches.
    """

    first: str
    second: str
    matches: int
    distance: float = nan
    offset: float = nan
    gain: float = nan


def check_pair(first: Sample, second: Sample) -> PairCheck:
    """What matching features say about two images."""
    names = first.camera.name, second.camera.name
    if min(len(first.positions), len(second.positions)) < 2:
        return PairCheck(*names, 0)
    a, b = matched = mutual(first.descriptors @ second.descriptors.T, RATIO)
    matrix = fundamental(first.camera, second.camera)
    agreeing = _agreeing(first.positions[a], second.positions[b])
    if agreeing.sum() < _ENOUGH or agreeing.mean() < _SHARE:
        return PairCheck(*names, int(agreeing.sum()))
    a, b = a[agreeing], b[agreeing]
    still = ~(_is_moving(first, first.positions[a]) | _is_moving(second, second.positions[b]))
    if still.sum() >= _ENOUGH:
        a, b = a[still], b[still]
    to_b, to_a = line_distances(matrix, first.positions[a], second.positions[b])
    apart = float(np.median((np.abs(to_b) * second.scale + np.abs(to_a) * first.scale) / 2))
    offset = _offset(first, second, matched, matrix, apart / second.scale)
    return PairCheck(*names, len(a), apart, offset, _gain(first.colors[a], second.colors[b]))


def _agreeing(a: Float64s, b: Float64s) -> Bools:
    """Which of the matches (N, 2) a fundamental matrix found from them explains."""
    nothing = np.zeros(len(a), dtype=bool)
    if len(a) < _ENOUGH:
        return nothing
    cv2 = load_opencv()
    cv2.setRNGSeed(0)
    _, mask = cv2.findFundamentalMat(a, b, cv2.FM_RANSAC, _RANSAC_PIXELS, 0.999, 5000)
    return nothing if mask is None else np.asarray(mask).ravel().astype(bool)


def _is_moving(sample: Sample, positions: Float64s) -> Bools:
    """Where the image changes until the next frame."""
    if sample.following is None:
        return np.zeros(len(positions), dtype=bool)
    cv2 = load_opencv()
    change = cv2.blur(cv2.absdiff(sample.gray, sample.following), (9, 9))
    columns, lines = np.clip(positions.astype(int), 0, [sample.camera.width - 1, sample.camera.height - 1]).T
    return np.asarray(change[lines, columns] > _CHANGE)


def _offset(first: Sample, second: Sample, matched: tuple[Ints, Ints], matrix: Float64s, wrong: float) -> float:
    """By how many frames the second camera is late, from how moving points cross their epipolar lines.

    Args:
        wrong: pixels by which points that stand still are off: what the calibration may feign.
    """
    if second.following is None:
        return nan
    a, b = matched
    at_a, at_b = first.positions[a], second.positions[b]
    moving = _is_moving(first, at_a) & _is_moving(second, at_b)
    apart = np.abs(line_distances(matrix, at_a, at_b)[0])
    near = moving & (apart < _NEAR * max(second.gray.shape))
    if near.sum() < _ENOUGH_MOVING:
        return nan
    at_a, at_b = at_a[near], at_b[near]
    cv2 = load_opencv()
    start = (at_b - 0.5).astype(np.float32)[:, None]
    tracked, gone, _ = cv2.calcOpticalFlowPyrLK(second.gray, second.following, start, None)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(second.following, second.gray, tracked, None)
    sure = (gone.ravel() > 0) & (returned.ravel() > 0) & (np.linalg.norm(back - start, axis=2).ravel() < 0.5)
    now = line_distances(matrix, at_a, at_b)[0]
    then = line_distances(matrix, at_a, tracked[:, 0].astype(np.float64) + 0.5)[0]
    crossing = then - now
    sure &= np.abs(crossing) > _CROSSING
    if sure.sum() < _ENOUGH_MOVING:
        return nan
    late, weights = -now[sure] / crossing[sure], np.abs(crossing[sure])
    middle = _weighted_median(late, weights)
    doubt = 1.5 * _weighted_median(np.abs(late - middle), weights) / np.sqrt(sure.sum())
    doubt = max(doubt, 0.5 * wrong / float(np.median(weights)))
    return middle if doubt < _CERTAIN else nan


def _weighted_median(values: Float64s, weights: Float64s) -> float:
    order = np.argsort(values)
    summed = np.cumsum(weights[order])
    return float(values[order][np.searchsorted(summed, summed[-1] / 2)])


def _gain(first: Float64s, second: Float64s) -> float:
    """Median ratio of the brightness around the matches, of those that are neither dark nor clipped."""
    light_a, light_b = first.mean(axis=1), second.mean(axis=1)
    usable = (np.minimum(light_a, light_b) > 12) & (np.maximum(first, second).max(axis=1) < 240)
    if usable.sum() < _ENOUGH:
        return nan
    return float(np.exp(np.median(np.log(light_b[usable] / light_a[usable]))))


_WIDE = 35.0  # degrees between views, beyond which many matches that agree are wrong all the same
_ABSURD = 0.01  # of the longest side: how far wrong matches lie from their lines
_FAR = 2.0  # pixels of an image 1280 wide: poses or lenses that are off by more make training blurred
_LATE = 0.3  # frames: what less does is smaller than what such a short look can tell
_BRIGHTER = 1.1
_BLURRED = 0.1  # above the other cameras' median
_ALL_BLURRED = 0.6
_SHOWN = 16  # cameras, a line each


@dataclass(frozen=True)
class Quality:
    """What was measured.

    Attributes:
        pairs: neighbouring cameras.
        blur: of each camera's images, 0 to 1.
        gain: brightness of each camera over their mean, where matches tell.
        findings: what should be seen to, a sentence each; empty if nothing was found.
        untold: what could not be measured, a sentence each.
    """

    pairs: tuple[PairCheck, ...]
    blur: dict[str, float]
    gain: dict[str, float]
    findings: tuple[str, ...]
    untold: tuple[str, ...]

    def lines(self) -> list[str]:
        """For a terminal, a pair or camera a line."""
        shown = []
        for pair in self.pairs:
            far = "too few to tell" if isnan(pair.distance) else f"{pair.distance:.2f} px from their lines"
            late = "" if isnan(pair.offset) else f", {pair.offset:+.2f} frames apart"
            shown.append(f"{pair.first} - {pair.second}: {pair.matches} matches, {far}{late}")
        if len(self.blur) > _SHOWN:
            worst = max(self.blur, key=self.blur.__getitem__)
            usual = float(np.median(list(self.blur.values())))
            return [*shown, f"blur {usual:.2f}, at most {self.blur[worst]:.2f} ({worst})"]
        for name, blur in self.blur.items():
            gain = f", brightness {self.gain[name]:.2f}" if name in self.gain else ""
            shown.append(f"{name}: blur {blur:.2f}{gain}")
        return shown


def check_capture(capture: Capture, progress: Callable[[int, int], None] = lambda done, total: None) -> Quality:
    """Looks at a few images of every camera, or of a moving camera at some pairs of images.

    Args:
        progress: called with (images decoded, images in all).

    Raises:
        FrogError: if a file cannot be decoded.
    """
    pairs = choose_pairs(capture)
    paths = {shot.path for shot in capture.shots if shot.path.suffix.lower() in VIDEO_SUFFIXES}
    films = [sentence for film in sorted(paths) for sentence in unsaid(film)]
    if not pairs:
        return Quality((), {}, {}, tuple(films), ("No two cameras see the same things: nothing could be compared.",))
    samples = take_samples(capture, pairs, progress)
    between = _between(capture, pairs, samples)
    blur = _blur(capture, samples)
    gain = {} if capture.has_moving_cameras else _gains(between)
    longest = max(max(camera.width, camera.height) for camera in capture.cameras)
    limit = _FAR * max(1.0, longest / 1280)
    findings = [*films, *_poses(between, limit), *_times(between), *_brightness(between, gain), *_sharpness(blur)]
    return Quality(tuple(between), blur, gain, tuple(findings), tuple(_untold(capture, between)))


def _between(capture: Capture, pairs: list[tuple[int, int]], samples: dict[int, Sample]) -> list[PairCheck]:
    """The checks of all pairs, those of two cameras at several frames taken together."""
    checks: dict[tuple[str, str], list[PairCheck]] = defaultdict(list)
    depth = scene_depth(capture.cameras)
    for first, second in pairs:
        one, other = (capture.cameras[capture.shots[shot].camera] for shot in (first, second))
        check = check_pair(samples[first], samples[second])
        if check.distance > _ABSURD * max(one.width, one.height) and parallax(one, other, depth) > _WIDE:
            check = replace(check, distance=nan, offset=nan, gain=nan)  # which proves nothing
        late = capture.shots[first].offset - capture.shots[second].offset  # which the capture knows
        checks[check.first, check.second].append(replace(check, offset=check.offset - late))
    return [_median(of_pair) for of_pair in checks.values()]


def _median(checks: list[PairCheck]) -> PairCheck:
    figures = np.array([(check.distance, check.offset, check.gain) for check in checks])
    middles = (float(np.median(known)) if len(known := row[~np.isnan(row)]) else nan for row in figures.T)
    return PairCheck(checks[0].first, checks[0].second, sum(check.matches for check in checks), *middles)


def _blur(capture: Capture, samples: dict[int, Sample]) -> dict[str, float]:
    blurs: dict[str, list[float]] = defaultdict(list)
    for shot, sample in samples.items():
        if np.isfinite(sample.blur):
            blurs[capture.cameras[capture.shots[shot].camera].name].append(sample.blur)
    return {name: float(np.median(values)) for name, values in blurs.items()}


def _gains(between: list[PairCheck]) -> dict[str, float]:
    """Brightness of each camera over the mean of all, by least squares over the pairs, if these join all."""
    known = [pair for pair in between if not isnan(pair.gain)]
    names = sorted({name for pair in known for name in (pair.first, pair.second)})
    if len(names) < 2:
        return {}
    rows = [[(name == pair.second) - float(name == pair.first) for name in names] for pair in known]
    values = [np.log(pair.gain) for pair in known]
    solved, _, rank, _ = np.linalg.lstsq([*rows, [1.0] * len(names)], [*values, 0.0], rcond=None)  # their mean is 1
    return dict(zip(names, np.exp(solved).tolist(), strict=True)) if rank == len(names) else {}


def unsaid(film: Path) -> Iterator[str]:
    """What the first images of a film show and its file does not say; FrogError if it cannot be decoded."""
    fields, repeats = watch(film)
    better = f"ffmpeg -i {film.name} -crf 12 -vf"
    if fields in ("tff", "bff") and not read_film_header(film).fields:
        yield f"{film.name} shows two times in each image, and its file does not say so: {better} bwdif=0 NEW.mp4"
    if repeats > 1:
        often = f"{film.name} shows each picture {repeats:.2g} times, most of them late"
        yield f"{often}: {better} mpdecimate -fps_mode vfr NEW.mp4"


def _poses(between: list[PairCheck], limit: float) -> Iterator[str]:
    if far := [pair for pair in between if pair.distance > limit]:
        worst = max(far, key=lambda pair: pair.distance)
        names = [name for pair in far for name in (pair.first, pair.second)]
        often = max(set(names), key=names.count)
        blamed = f"; {often} is in {names.count(often)} of them" if len(far) > 1 and names.count(often) > 1 else ""
        yield (
            f"Poses, lenses or image sizes may be wrong: matches of {len(far)} of {len(between)} pairs lie more than "
            f"{limit:.1f} px from where the calibration puts them ({worst.first} - {worst.second}: "
            f"{worst.distance:.1f}){blamed}."
        )


def _times(between: list[PairCheck]) -> Iterator[str]:
    if late := [pair for pair in between if abs(pair.offset) > _LATE]:
        worst = max(late, key=lambda pair: abs(pair.offset))
        yield (
            f"Cameras may be out of step: {worst.second} shows what moves {worst.offset:+.2f} frames later than "
            f"{worst.first} ({len(late)} of {len(between)} pairs)."
        )


def _brightness(between: list[PairCheck], gain: dict[str, float]) -> Iterator[str]:
    """Of all cameras where matches join them, else of the pair that differs most."""
    known = [pair for pair in between if not isnan(pair.gain)]
    if not gain and known:
        pair = max(known, key=lambda pair: abs(np.log(pair.gain)))
        gain = {pair.first: 1.0, pair.second: pair.gain}
    if gain:
        dark, bright = min(gain, key=gain.__getitem__), max(gain, key=gain.__getitem__)
        if (ratio := gain[bright] / gain[dark]) >= _BRIGHTER:
            yield (
                f"Exposure differs: {bright} is {100 * (ratio - 1):.0f} % brighter than {dark}; "
                "training finds and removes such differences."
            )


def _sharpness(blur: dict[str, float]) -> Iterator[str]:
    usual = float(np.median(list(blur.values()))) if blur else 0.0
    blurred = [name for name, value in blur.items() if value > usual + _BLURRED]
    if usual > _ALL_BLURRED:
        yield f"The images are blurred (typically {usual:.2f} of 1): out of focus, moved, or enlarged."
    elif blurred:
        yield f"More blurred than the others: {listed(blurred)}."


def _untold(capture: Capture, between: list[PairCheck]) -> Iterator[str]:
    if few := sum(isnan(pair.distance) for pair in between):
        yield (
            f"{few} of {len(between)} pairs of neighbouring views have too few matches to check the poses: "
            "cameras more than about 30 degrees apart, little texture, or poses of other cameras."
        )
    if not capture.has_moving_cameras and all(isnan(pair.offset) for pair in between):
        yield "Too little moves across the epipolar lines to check whether the cameras are in step."
