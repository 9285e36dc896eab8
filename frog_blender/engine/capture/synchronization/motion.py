"""The finest source: at the right lag, every point that moves lies on the epipolar line of its match.

Points are SIFT features inside the changing region of a film. Each is tracked by optical flow for a few frames to
either side of the frame it was found in: films of other cameras show the same point at times between these frames. So
lags are real numbers. What stands still, or moves along its epipolar line, says nothing and is left out. A coarse
search comes first, then a fine one.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from ...arrays import Array, Bools, Float32s, Float64s, ImageArray, Ints
from ...io.work_folder import key_of
from ..camera import Camera
from ..epipolar import alike_pairs, fundamental, mutual, sampson_distances, sampson_table
from ..video import load_opencv
from . import limits
from .films import Film, Run, spread
from .pairs import Curve, PairLag, Timing, maxima
from .starts import Motion

_ROUNDS = 8  # of reweighting
REACH = 2
"""Frames to either side of its own in which a point is tracked."""
_NODES = 2 * REACH + 1
_SHIFTS = range(-REACH, REACH + 1)

Cameras = Mapping[str, tuple[Camera, Float64s]]
"""Cameras that are known, by name, with their lenses' distortion in OpenCV's order."""


# --- points that move


@dataclass(frozen=True, eq=False)
class MovingPoints:
    """N points of one film.

    Attributes:
        keyframes: (N,) int64, which of the film's keyframes each was found in: 0, 1, ... of ``key_times``.
        key_times: (K,) float64 seconds in the film, ascending.
        times: (N, 5) float64 seconds in the film: the frame it was found in and two to either side.
        tracks: (N, 5, 2) float64 pixels of the film (centres at +0.5); NaN where the flow lost it.
        descriptors: (N, 128) float32 RootSIFT, unit length.
    """

    keyframes: Ints
    key_times: Float64s
    times: Float64s
    tracks: Float64s
    descriptors: Float32s

    def of_keyframe(self, keyframe: int) -> Ints:
        """The points found in one keyframe: their rows (M,)."""
        first, last = np.searchsorted(self.keyframes, [keyframe, keyframe + 1])
        return np.arange(first, last)

    def positions(self, which: Array, at: Float64s) -> tuple[Float64s, Bools]:
        """Positions (M, 2) in pixels of the points ``which`` (M,) at film times ``at`` (M,) seconds, and which hold.

        A parabola through the three tracked positions nearest in time; it holds up to half a frame beyond a track.
        """
        times, tracks = self.times[which], self.tracks[which]
        tracked = np.isfinite(tracks[..., 0])
        middle = np.abs(times - at[:, None]).argmin(axis=1).clip(1, _NODES - 2)
        rows = np.arange(len(middle))
        whole = tracked[rows, middle - 1] & tracked[rows, middle] & tracked[rows, middle + 1]
        middle = np.where(whole, middle, REACH)
        three = middle[:, None] + np.arange(-1, 2)
        t = times[rows[:, None], three]
        p = tracks[rows[:, None], three]
        frame = (t[:, 2] - t[:, 0]) / 2
        holds = (at >= t[:, 0] - limits.BEYOND * frame) & (at <= t[:, 2] + limits.BEYOND * frame)
        gaps, result = at[:, None] - t, np.zeros((len(middle), 2))
        for i, j, k in ((0, 1, 2), (1, 0, 2), (2, 0, 1)):  # Lagrange's polynomials
            weight = gaps[:, j] * gaps[:, k] / ((t[:, i] - t[:, j]) * (t[:, i] - t[:, k]))
            result += weight[:, None] * p[:, i]
        return result, holds


def points_in(film: Film, region: ImageArray, keyframes: Sequence[int]) -> MovingPoints:
    """The moving points of a film.

    Args:
        region: (H, W) uint8 of its gray images, where something moves.
        keyframes: ascending, with REACH frames to either side.
    """
    needed = sorted({key + shift for key in keyframes for shift in _SHIFTS})
    recent: dict[int, ImageArray] = {}
    parts = [(np.zeros(0, np.int64), np.zeros((0, _NODES, 2)), np.zeros((0, 128), np.float32))]
    for index, gray in zip(needed, film.gray(needed, limits.LONGEST_SIDE), strict=True):
        recent[index] = gray
        key = index - REACH
        if key in keyframes and region.any():
            moving = _tracked([recent[key + shift] for shift in _SHIFTS], region)
            if moving is not None:
                parts.append((np.full(len(moving[0]), keyframes.index(key)), *moving))
        recent.pop(index - 2 * REACH, None)
    rows, tracks, descriptors = (np.concatenate(part) for part in zip(*parts, strict=True))
    frames = np.array(keyframes, np.int64)
    times = film.stamps[frames[rows][:, None] + np.array(_SHIFTS)]
    scale = min(1.0, limits.LONGEST_SIDE / max(film.size))
    return MovingPoints(rows, film.stamps[frames], times, tracks / scale, descriptors)


def _tracked(images: Sequence[ImageArray], region: ImageArray) -> tuple[Float64s, Float32s] | None:
    """Tracks (M, 5, 2) in pixels of the gray images, centres at +0.5, and descriptors (M, 128), of five images; None
    where no feature moves."""
    options = {"contrastThreshold": limits.CONTRAST, "enable_precise_upscale": True}
    rows, columns = (_span(region.any(axis=axis)) for axis in (1, 0))
    sift = load_opencv().SIFT_create(nfeatures=limits.MOST_FEATURES, **options)
    features, descriptors = sift.detectAndCompute(images[REACH][rows, columns], region[rows, columns])
    if descriptors is None:
        return None
    corner = (columns.start, rows.start)
    start = (np.array([feature.pt for feature in features]) + corner).astype(np.float32)
    after, good = _flow(images[REACH], images[REACH + 1], start)
    moving = np.flatnonzero(good & (np.linalg.norm(after - start, axis=1) > limits.STILL))
    strength = np.array([features[point].response for point in moving])
    chosen = np.sort(moving[np.argsort(-strength, kind="stable")[: limits.MOST_MOVING]])
    if not len(chosen):
        return None
    tracks = np.full((len(chosen), _NODES, 2), np.nan)
    tracks[:, REACH] = start[chosen]
    for direction in (-1, 1):
        position, alive = start[chosen], np.ones(len(chosen), dtype=bool)
        for step in range(1, REACH + 1):
            before = images[REACH + direction * (step - 1)]
            position, good = _flow(before, images[REACH + direction * step], position)
            alive &= good
            tracks[alive, REACH + direction * step] = position[alive]
    whole = np.isfinite(tracks[:, REACH - 1 : REACH + 2, 0]).all(axis=1)
    roots = np.sqrt(descriptors / np.maximum(descriptors.sum(axis=1, keepdims=True), 1e-6))
    return tracks[whole] + 0.5, roots[chosen[whole]].astype(np.float32)


def _span(changes: Bools) -> slice:
    """The rows or columns that change and a margin: outside, features cost time for nothing."""
    first, last = np.flatnonzero(changes)[[0, -1]].tolist()
    return slice(max(first - limits.FEATURE_MARGIN, 0), last + limits.FEATURE_MARGIN + 1)


def _flow(before: ImageArray, after: ImageArray, points: Float32s) -> tuple[Float32s, Bools]:
    """Where points (N, 2) went, and which of them came back to where they started."""
    cv2 = load_opencv()
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 30, 0.01)
    options = {"winSize": limits.FLOW_WINDOW, "maxLevel": 3, "criteria": criteria}
    there, gone, _ = cv2.calcOpticalFlowPyrLK(before, after, points[:, None], None, **options)
    back, returned, _ = cv2.calcOpticalFlowPyrLK(after, before, there, None, **options)
    missed = np.linalg.norm(back[:, 0] - points, axis=1)
    good = (gone[:, 0] > 0) & (returned[:, 0] > 0) & (missed < limits.FLOW_BACK)
    return there[:, 0], good


@dataclass(frozen=True, eq=False)
class Matches:
    """M matches between points of two films.

    Attributes:
        first, second: (M,) int64 rows in the films' MovingPoints.
        apart: (M,) float64 seconds: the time of the point in the first film less that in the second.
    """

    first: Ints
    second: Ints
    apart: Float64s

    def near(self, lag: Float64s | float, reach: float, most: int) -> Matches:
        """Those whose two times, ``lag`` seconds apart in the films, lie within ``reach`` seconds of each other; of
        more than ``most`` evenly drawn ones."""
        kept = np.flatnonzero(np.abs(self.apart - lag) <= reach)
        if len(kept) > most:
            kept = kept[spread(len(kept), most)]
        return Matches(self.first[kept], self.second[kept], self.apart[kept])


# --- two films


@dataclass(frozen=True, eq=False)
class Views:
    """Two films of cameras that are known, and how these lie to each other.

    Attributes:
        pair: indices of the films.
        films: the two.
        points: that move in them, in pixels without lens distortion.
        matrix: (3, 3) fundamental matrix, first to second.
        frame: seconds between frames, of the slower film.
        width: pixels of the wider film.
        bias: (3,) pixels by ``bias_terms``: what the cameras' calibration leaves of every residual.
    """

    pair: tuple[int, int]
    films: tuple[Film, Film]
    points: tuple[MovingPoints, MovingPoints]
    matrix: Float64s
    frame: float
    width: int
    bias: Float64s = field(default_factory=lambda: np.zeros(3))

    @property
    def truncation(self) -> float:
        """Pixels beyond which a residual is that of a false match."""
        return max(1.0, limits.TRUNCATION * self.width)

    @property
    def reach(self) -> float:
        """Seconds in which a point is tracked to either side of its frame."""
        return REACH * self.frame

    def near(self, start: Timing, frames: float) -> tuple[float, float]:
        """The least and the greatest lag, seconds, within so many frames of clocks that are nearly right."""
        ends = [start.lag(*self.pair, at) for at in self.films[1].stamps[[0, -1]].tolist()]
        return min(ends) - frames * self.frame, max(ends) + frames * self.frame

    def matches(self, lags: tuple[float, float], most: int = 1000, clocks: Timing | None = None) -> Matches:
        """Mutual nearest neighbours between keyframes that may show the same instant.

        Args:
            lags: the least and the greatest, seconds.
            most: keyframes of the first film that are looked at, evenly spread.
            clocks: that are nearly right: of points near each other's epipolar lines alone. Fewer rivals pass the ratio
                test the more: several times as many matches where little has texture.
        """
        first, second = self.points
        rows_a, rows_b = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
        for key_a in spread(len(first.key_times), most):
            in_a = first.of_keyframe(key_a)
            later = first.key_times[key_a] - second.key_times
            for key_b in np.flatnonzero((later >= lags[0] - self.reach) & (later <= lags[1] + self.reach)).tolist():
                in_b = second.of_keyframe(key_b)
                if min(len(in_a), len(in_b)) < 2:
                    continue
                similarity = first.descriptors[in_a] @ second.descriptors[in_b].T
                if clocks is not None:
                    similarity[~self._along_lines(clocks, in_a, in_b)] = -1.0
                a, b = mutual(similarity, limits.MATCH_RATIO, limits.MATCH_FARTHEST)
                rows_a.append(in_a[a])
                rows_b.append(in_b[b])
        a, b = np.concatenate(rows_a), np.concatenate(rows_b)
        return Matches(a, b, first.key_times[first.keyframes[a]] - second.key_times[second.keyframes[b]])

    def _along_lines(self, clocks: Timing, in_first: Ints, in_second: Ints) -> Bools:
        """(M, K) which points of the films lie near each other's epipolar lines."""
        first, second = self.points
        time_a, time_b = first.times[in_first[0], REACH], second.times[in_second[0], REACH]
        half = (time_b + clocks.lag(*self.pair, time_b) - time_a) / 2
        a, _ = first.positions(in_first, np.full(len(in_first), time_a + half))
        b, _ = second.positions(in_second, np.full(len(in_second), time_b - half))
        return np.abs(sampson_table(self.matrix, a, b)) < limits.BAND * self.truncation

    def residuals(self, matches: Matches, lags: Float64s | float) -> tuple[Float64s, Bools]:
        """(M,) pixels at lags (M,) seconds, and which of them could be had."""
        first, second = self.points
        middle = first.times[matches.first, REACH], second.times[matches.second, REACH]
        carried = (middle[1] + lags - middle[0]) / 2  # each goes half of the way
        a, good_a = first.positions(matches.first, middle[0] + carried)
        b, good_b = second.positions(matches.second, middle[1] - carried)
        return sampson_distances(self.matrix, a, b) + self.bias_terms(matches) @ self.bias, good_a & good_b

    def bias_terms(self, matches: Matches) -> Float64s:
        """(M, 3): one, and where the points lie in the first image, in half widths from its points' middle."""
        where = self.points[0].tracks[matches.first, REACH]
        middle = self.points[0].tracks[:, REACH].mean(axis=0) if len(where) else np.zeros(2)
        return np.column_stack([np.ones(len(where)), 2 * (where - middle) / self.width])

    def slopes(self, matches: Matches, lags: Float64s | float) -> tuple[Float64s, Float64s, Bools]:
        """Residuals (M,) pixels, their derivatives (M,) in pixels a second of lag, and which of them tell the lag."""
        step = 0.25 * self.frame
        before, good_before = self.residuals(matches, lags - step)
        after, good_after = self.residuals(matches, lags + step)
        slopes = (after - before) / (2 * step)
        tells = good_before & good_after & (np.abs(slopes) * self.frame > limits.LEAST_SLOPE)
        return (before + after) / 2, slopes, tells


def views_of(films: Sequence[Film], motions: Sequence[Motion], known: Cameras, start: Timing, run: Run) -> list[Views]:
    """Each film with those whose cameras look at the scene most alike; ``start`` has their clocks as far as known."""
    cameras = [known[film.name][0].resized(*film.size) for film in films]

    def of_film(index: int) -> MovingPoints:
        film, keyframes = films[index], _keyframes(films[index], start, index)
        region, key = motions[index].region, key_of(film.state, keyframes)
        points = MovingPoints(**run.work.kept("moving_points", key, lambda: vars(points_in(film, region, keyframes))))
        return replace(points, tracks=straightened(cameras[index], known[film.name][1], points.tracks))

    points = run.in_threads("moving points", of_film, range(len(films)))
    return [
        Views(
            pair=(i, j),
            films=(films[i], films[j]),
            points=(points[i], points[j]),
            matrix=fundamental(cameras[i], cameras[j]),
            frame=max(films[i].interval, films[j].interval),
            width=max(cameras[i].width, cameras[j].width),
        )
        for i, j in alike_pairs(cameras, limits.NEIGHBORS)
    ]


def _is_short(film: Film) -> bool:
    """Every third frame of it can be looked at."""
    return film.facts.frame_count <= limits.KEYFRAME_EVERY * limits.MOST_KEYFRAMES


def _keyframes(film: Film, clocks: Timing, index: int) -> list[int]:
    """Every third frame of a film; of a long one those near times that all films share."""
    count, every, most = film.facts.frame_count, limits.KEYFRAME_EVERY, limits.MOST_KEYFRAMES
    if _is_short(film):
        step = max(1, min(every, count // limits.FEWEST_KEYFRAMES), count // most)
        return list(range(REACH, count - REACH, step))
    # Frames of other films are compared only where they were taken at nearly the same time.
    apart = every * film.interval * max(1.0, count / (every * most))
    apart = 2.0 ** np.ceil(np.log2(apart))  # the same grid for all films, though they differ in length
    start, end = (clocks.capture_time(index, time) for time in film.stamps[[0, -1]].tolist())
    times = np.arange(np.ceil(start / apart), np.floor(end / apart) + 1) * apart
    nearest = {int(np.abs(film.stamps - clocks.film_time(index, time)).argmin()) for time in times.tolist()}
    return sorted(frame for frame in nearest if REACH <= frame < count - REACH)


def coarse_lags(rig: Sequence[Views], start: Timing, is_sure: bool, run: Run) -> list[PairLag]:
    """Lags right to a fraction of a frame: near a start that is sure, else over all of two short films."""

    def of_pair(views: Views) -> PairLag | None:
        first, second = views.films
        if is_sure or not (_is_short(first) and _is_short(second)):
            lags = views.near(start, limits.START_FRAMES)
        else:
            least = limits.LEAST_OVERLAP * min(first.duration, second.duration)
            lags = least - second.duration, first.duration - least
        return epipolar_lag(views, views.matches(lags, limits.COARSE_KEYFRAMES), lags, limits.COARSE_STEP)

    return [lag for lag in run.in_threads("coarse offsets", of_pair, rig) if lag is not None]


def fine_lags(rig: Sequence[Views], start: Timing, run: Run) -> list[PairLag]:
    """Lags to a few hundredths of a frame, near clocks that are right to a frame or two."""

    def of_pair(views: Views) -> PairLag | None:
        lags = views.near(start, limits.FINE_FRAMES)
        return epipolar_lag(views, views.matches(lags, clocks=start), lags)

    return [lag for lag in run.in_threads("offsets", of_pair, rig) if lag is not None]


def straightened(camera: Camera, distortion: Float64s, positions: Float64s) -> Float64s:
    """Positions (..., 2) in pixels of ``camera``, pixel centres at +0.5, without its lens's distortion; NaN stays."""
    lens = camera.intrinsics.copy()
    lens[:2, 2] -= 0.5  # OpenCV counts pixel centres from 0
    given = np.ascontiguousarray(positions.reshape(-1, 1, 2) - 0.5)
    straight: Float64s = load_opencv().undistortPoints(given, lens, distortion, P=lens) if len(given) else given
    return (straight + 0.5).reshape(positions.shape)


def epipolar_lag(views: Views, matches: Matches, lags: tuple[float, float], step: float = 0.25) -> PairLag | None:
    """The lag between two films at which their moving points agree best; None where too few points move.

    Args:
        matches: between their points.
        lags: the least and the greatest lag to be considered, seconds.
        step: frames between the lags that are tried first.
    """
    curve = score_curve(views, matches, lags, step)
    fits = []
    for start, _ in maxima(curve, views.frame, most=limits.REFINED_PEAKS):
        if (fit := _refined(views, matches, start)) is not None:
            lag, unbiased = fit
            scores = score_curve(unbiased, matches, (lag.lag, lag.lag), step).scores
            fits.append((float(np.nan_to_num(scores).max()), lag, unbiased))
    score, best, unbiased = max(fits, key=lambda fit: fit[0], default=(0.0, None, views))
    if best is None or score <= 0:
        return None
    curve = score_curve(unbiased, matches, lags, step)
    others = tuple(other for other in maxima(curve, views.frame) if abs(other[0] - best.lag) >= views.frame)
    return replace(best, score=score, others=others, curve=curve)


def score_curve(views: Views, matches: Matches, lags: tuple[float, float], step: float) -> Curve:
    """How many of the moving matches lie on their epipolar lines, 0 to 1, over lags ``step`` frames apart."""
    step = step * views.frame
    grid = np.arange(np.floor(lags[0] / step), np.ceil(lags[1] / step) + 1) * step
    scores = np.full(len(grid), np.nan)
    for position, lag in enumerate(grid):
        near = matches.near(lag, views.reach, limits.MOST_TRIED)
        if len(near.apart) < limits.LEAST_MATCHES:
            continue
        residuals, _, tells = views.slopes(near, lag)
        agreement = np.maximum(1 - (residuals[tells] / views.truncation) ** 2, 0)
        scores[position] = agreement.sum() / (tells.sum() + limits.DOUBT)
    return Curve(grid, scores)


def _refined(views: Views, matches: Matches, lag: float) -> tuple[PairLag, Views] | None:
    """The lag near one that is right to a frame or so, and the views with their bias; None where too few matches move.

    Reweighted least squares on residuals that are linear in the lag, in a rate where the films are long, and in where
    a point lies: cameras that were calibrated from little leave residuals that no lag can explain.
    """
    start, at, rate, sigmas = lag, 0.0, 0.0, (np.inf, np.inf)
    scale, bias = views.truncation, np.zeros(3)
    for turn in range(_ROUNDS):
        times = views.points[1].times[matches.second, REACH]
        near = matches.near(lag + rate * (times - at), views.reach, limits.MOST_FITTED)
        times = views.points[1].times[near.second, REACH]
        residuals, slopes, good = views.slopes(near, lag + rate * (times - at))
        bias_terms = views.bias_terms(near)
        residuals = residuals + bias_terms @ bias
        good &= np.abs(residuals) < 3 * scale
        if good.sum() < limits.LEAST_MATCHES:
            return None
        r, g, t = residuals[good], slopes[good], times[good]
        weights = np.maximum(1 - (r / (3 * scale)) ** 2, 0) ** 2  # Tukey's
        noise = float((weights * r**2).sum() / max(weights.sum(), 1e-9))
        middle = float(np.average(t, weights=weights * g**2 + 1e-12))
        lag, at = lag + rate * (middle - at), middle
        drifts = bool(np.ptp(t) >= limits.MOTION_DRIFT_SECONDS) and turn >= 2
        clocks = [g, g * (t - middle)] if drifts else [g]
        columns = np.column_stack([*clocks, bias_terms[good]])
        prior = np.zeros(columns.shape[1])
        prior[-3:] = limits.CORRELATED * noise / (limits.BIAS * views.width) ** 2
        normal = columns.T @ (weights[:, None] * columns) + np.diag(prior + 1e-12)
        pulled = np.concatenate([np.zeros(len(clocks)), bias])  # the prior is that there is no bias
        change = -np.linalg.solve(normal, columns.T @ (weights * r) + prior * pulled)
        lag += float(np.clip(change[0], -views.frame / 2, views.frame / 2))
        rate += float(change[1]) if drifts else 0.0
        bias = bias + change[-3:]
        scale = max(0.1, 0.5 * scale, min(scale, 2.5 * float(np.median(np.abs(r)))))
        inverse = np.linalg.inv(normal) * limits.CORRELATED * noise
        sigmas = (float(np.sqrt(inverse[0, 0])), float(np.sqrt(inverse[1, 1])) if drifts else np.inf)
    if abs(lag - start) > 2 * views.frame and abs(rate) < limits.SLOWEST:
        return None
    sigma = max(sigmas[0], 1e-3 * views.frame)
    return PairLag(*views.pair, lag, at, sigma, 0.0, "motion", 1 + rate, sigmas[1]), replace(views, bias=bias)
