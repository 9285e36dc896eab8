"""Raw films of several cameras to one clock a camera: by sound, else by motion; then moving points.

The answer has each camera's offset and rate, how sure they are, what a person should know, and when it is refused.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from ...arrays import Float32s, ImageArray
from ...errors import FrogError, found_instead
from ...io.child_process import Progress
from ...io.work_folder import WorkFolder
from ..video import load_opencv
from . import limits, starts
from .films import Clocks, Film, Run
from .motion import Cameras, coarse_lags, fine_lags, views_of
from .pairs import Curve, PairLag, Solution, Source, Timing, maxima, solve

_IN_STEP = 0.1  # of a frame: films that begin within it began together
_SAME_RATE = 1e-4
_ROW, _LEFT, _WIDTH = 96, 130, 900  # pixels of a drawn curve: its height, its caption, the whole
_INK, _LINE, _CHOSEN, _OTHER = (40, 40, 40), (60, 110, 190), (30, 150, 70), (200, 120, 40)


@dataclass(frozen=True)
class RunnerUp:
    """Another offset that fits a camera, seconds, and its score as a share of the best one's."""

    offset: float
    share: float

    @property
    def is_as_likely(self) -> bool:
        """Its score comes within a tenth of the best."""
        return self.share >= limits.RIVAL


@dataclass(frozen=True, eq=False)
class CameraClock:
    """One camera's clock: capture time = ``offset`` + ``rate`` * film time.

    Attributes:
        name: the camera.
        offset: seconds of capture time at the film's time 0.
        rate: seconds of capture time for each second of film.
        confidence: 0 to 1; below 0.5 a person should look at the curve.
        sources: who contributed, such as ("motion",).
        runner_up: the next best offset, if the curve has another maximum.
        curve: the score over the camera's offset (seconds), all other cameras held.
    """

    name: str
    offset: float
    rate: float
    confidence: float
    sources: tuple[Source, ...]
    runner_up: RunnerUp | None
    curve: Curve


@dataclass(frozen=True, eq=False)
class Synchronization:
    """The clocks of a capture's cameras; none where they were given or assumed.

    Attributes:
        cameras: in the order of the films.
        frame: seconds between frames of the slowest film: the unit of "half a frame" below.
        residual: seconds by which the pairs of films miss the clocks (median).
        warnings: sentences for the user.
        refusal: a sentence, where the offsets must not be used; else None.
    """

    cameras: tuple[CameraClock, ...] = ()
    frame: float = 1.0
    residual: float = 0.0
    warnings: tuple[str, ...] = ()
    refusal: str | None = None

    @property
    def clocks(self) -> Clocks:
        """Offset in seconds, and seconds of capture time for each second of film, by camera."""
        return {camera.name: (camera.offset, camera.rate) for camera in self.cameras}

    def with_clocks(self, clocks: Clocks) -> Synchronization:
        """The same with other clocks for all cameras, such as offsets that were measured closer."""
        timed = ((camera, *clocks[camera.name]) for camera in self.cameras)
        return replace(self, cameras=tuple(replace(camera, offset=offset, rate=rate) for camera, offset, rate in timed))


def in_step(answer: Synchronization, films: Sequence[Film]) -> Synchronization:
    """The same with equal clocks where all began together and ran alike: what is left is the error of finding it."""
    offsets, rates = zip(*answer.clocks.values(), strict=True)
    frame = 1 / max(film.facts.frames_per_second for film in films)
    if max(offsets) - min(offsets) < 2 * _IN_STEP * frame and all(abs(rate - 1) < _SAME_RATE for rate in rates):
        return answer.with_clocks(dict.fromkeys(answer.clocks, (0.0, 1.0)))
    return answer


def differ(one: Clocks, other: Clocks, films: Sequence[Film]) -> bool:
    """Whether any film's clock differs by more than a tenth of a frame at its start."""
    known = [(film.name, film.facts.frames_per_second) for film in films if film.name in one and film.name in other]
    return any(abs(one[name][0] - other[name][0]) * rate > _IN_STEP for name, rate in known)


# --- from films to clocks


def find_clocks(run: Run, films: Sequence[Film], cameras: Cameras | None = None) -> Synchronization:
    """``synchronize`` in a process of its own; films that began together and ran alike have equal clocks.

    Raises:
        Stopped: if the run was cancelled.
        FrogError: if a film cannot be decoded, or the process of the synchronization died.
    """
    return in_step(run.in_child(synchronize, films, run.work, cameras), films)


def synchronize(
    films: Sequence[Film],
    work: WorkFolder,
    cameras: Cameras | None = None,
    tell: Progress = lambda stage, done, total: None,
) -> Synchronization:
    """The offset and the rate of every camera's clock, whatever the films' are taken to be.

    Sound comes first: where it joins all films, nothing else is asked but moving points, which measure closer.

    Args:
        work: keeps what is found in each film.
        cameras: of all films, where known: the answer is right to a few hundredths of a frame. At the films' sizes or
            others of the same proportions.
        tell: told a stage's name, and how much of how much is done.

    Raises:
        FrogError: if a film cannot be decoded, or has fewer than three frames.
    """
    load_opencv().setNumThreads(1)  # films and pairs of them share the processors
    run = Run(work, tell, lambda: False)
    for film in films:
        if film.facts.frame_count < limits.LEAST_FRAMES:
            found = f"a video of {film.facts.frame_count} frames"
            raise found_instead(film.path, found, "at least three, in which something moves")
    if len(films) < 2:
        return reported(films, _solved(films, []), [])
    pairs, unheard = _heard(films, run)
    is_heard = bool(_solved(films, pairs).connected.all())
    motions: list[starts.Motion] = []
    if cameras or not is_heard:
        motions = run.in_threads("motion", lambda film: starts.motion_of(film, run.work), films)
    if not is_heard:
        pairs += _alike(films, motions, {(pair.first, pair.second) for pair in pairs})
    solution = _solved(films, pairs)
    if cameras:
        is_sure = bool(solution.connected.all() and (solution.support >= limits.SURE).all())
        views = views_of(films, motions, cameras, solution.clocks, run)
        coarse = _joined(coarse_lags(views, solution.clocks, is_sure, run), pairs)
        pairs = _joined(fine_lags(views, _solved(films, coarse).clocks, run), pairs)
        solution = _solved(films, pairs)
    answer = reported(films, solution, pairs)
    return replace(answer, warnings=(*unheard, *answer.warnings))


def _solved(films: Sequence[Film], pairs: Sequence[PairLag]) -> Solution:
    frame = max(film.interval for film in films)
    return solve(len(films), pairs, frame, max(film.duration for film in films))


def _heard(films: Sequence[Film], run: Run) -> tuple[list[PairLag], list[str]]:
    """Lags of the films that sound alike, and a warning about each film that has sound which cannot be read."""
    sounds = run.in_threads("sound", _sound_of, films)
    pairs = combinations(((index, sound) for index, sound in enumerate(sounds) if isinstance(sound, np.ndarray)), 2)
    lags = [starts.audio_lag((first, second), (one, other)) for (first, one), (second, other) in pairs]
    unheard = [f"The clocks are found without the sound of {sound}" for sound in sounds if isinstance(sound, str)]
    return [lag for lag in lags if lag is not None], unheard


def _sound_of(film: Film) -> Float32s | str | None:
    """Its samples; which film and why, where there is sound that cannot be read; None where there is none."""
    try:
        return starts.read_audio(film)
    except FrogError as error:
        return f"{film.name}. {error}"


def _alike(films: Sequence[Film], motions: Sequence[starts.Motion], heard: set[tuple[int, int]]) -> Iterator[PairLag]:
    """Lags of the other films, by how much moves in them; a timecode chooses between several."""
    codes = [starts.read_timecode(film) for film in films]
    energies = [(motion.times, motion.energies) for motion in motions]
    for first, second in combinations(range(len(films)), 2):
        if (first, second) not in heard:
            step = min(films[first].interval, films[second].interval)
            lag = starts.energy_lag((first, second), (energies[first], energies[second]), step)
            if lag is not None:
                yield starts.preferred(lag, (codes[first], codes[second]))


def _joined(lags: list[PairLag], pairs: Sequence[PairLag]) -> list[PairLag]:
    """Lags of moving points, and the start's of films that share nothing that moves."""
    reached = {film for lag in lags for film in (lag.first, lag.second)}
    return lags + [pair for pair in pairs if not {pair.first, pair.second} <= reached]


# --- from solved clocks to the answer


def reported(films: Sequence[Film], solution: Solution, pairs: Sequence[PairLag]) -> Synchronization:
    """The clocks of films as the user sees them; ``pairs`` are the lags that they were solved from."""
    frame = max(film.interval for film in films)
    clocks, cameras = solution.clocks, []
    for index, film in enumerate(films):
        own = [pair for pair in pairs if index in (pair.first, pair.second)]
        curve, offset = camera_curve(index, own, clocks, frame), float(clocks.offsets[index])
        sources = tuple(sorted({pair.source for pair in own}))
        confidence = 1.0 if len(films) == 1 else _confidence(index, solution, own)
        runner = runner_up(curve, offset, frame)
        cameras.append(CameraClock(film.name, offset, float(clocks.rates[index]), confidence, sources, runner, curve))
    warnings = [sentence for camera in cameras for sentence in _doubts(camera, frame)]
    if coarse := [camera.name for camera in cameras if camera.sources == ("energy",)]:
        which = ", ".join(coarse) if len(coarse) < len(cameras) else "all cameras"
        warnings.append(f"The offsets of {which} come from the amount of motion alone and may be a frame wrong.")
    residual = float(np.median(np.abs(solution.misses))) if len(solution.misses) else 0.0
    return Synchronization(tuple(cameras), frame, residual, tuple(warnings), _refusal(solution, cameras))


def _confidence(film: int, solution: Solution, pairs: Sequence[PairLag]) -> float:
    """0 to 1: the share of a film's pairs that agree, times how well they do, less where no triangle checks them."""
    if not pairs:
        return 0.0
    is_open = solution.open_triangles[film]
    checked = 1.0 if len(solution.support) == 2 else 0.5 if np.isnan(is_open) else 1 - float(is_open)
    if {pair.source for pair in pairs} == {"energy"}:
        checked *= limits.ENERGY_TRUST  # views that see motion unlike each other may agree on a wrong lag
    # A third of the moving matches on their epipolar lines is as good as it gets where things hide each other.
    agreement = min(1.0, 2.5 * float(np.median([pair.score for pair in pairs])))
    return float(np.clip(solution.support[film] * np.sqrt(checked) * agreement, 0, 1))


def _doubts(camera: CameraClock, frame: float) -> list[str]:
    """What the user should know about one camera."""
    sentences = []
    if camera.confidence < limits.UNSURE:
        sentences.append(
            f"Camera {camera.name}: its offset of {camera.offset:.3f} s is uncertain "
            f"(confidence {camera.confidence:.2f}); look at its curve, or type the offset."
        )
    rival = camera.runner_up
    if rival is not None and rival.is_as_likely and abs(rival.offset - camera.offset) > frame:
        sentences.append(
            f"Camera {camera.name}: an offset of {rival.offset:.3f} s fits nearly as well as {camera.offset:.3f} s; "
            "does the motion repeat itself?"
        )
    return sentences


def _refusal(solution: Solution, cameras: Sequence[CameraClock]) -> str | None:
    """Why the offsets must not be used, and what to do; None if they may."""
    clap = "clap once where all cameras see and hear it, or type"
    lost = [camera.name for camera, connected in zip(cameras, solution.connected, strict=True) if not connected]
    if lost and len(cameras) > 1:
        return f"Camera {lost[0]} shares neither sound nor motion with another: {clap} its offset."
    unsure = [camera.name for camera in cameras if camera.confidence < limits.LEAST_CONFIDENCE]
    if unsure:
        return f"The films' lags contradict each other for camera {', '.join(unsure)}: {clap} the offset."
    return None


def camera_curve(film: int, pairs: Sequence[PairLag], clocks: Timing, frame: float) -> Curve:
    """The mean of a film's pair curves over its offset, seconds; each weighs by its score.

    Args:
        film: index of the film.
        pairs: that it is one of, with curves.
        clocks: the answer.
        frame: seconds between frames.
    """
    shifted = []
    for pair in pairs:
        known = pair.curve.known
        if len(known.lags) > 1:
            # A greater offset of the second film is a greater lag; of the first, a smaller one.
            sign = 1 if film == pair.second else -1
            moved = sign * (known.lags - clocks.lag(pair.first, pair.second, pair.at))
            shifted.append((moved[::sign], known.scores[::sign], max(pair.score, 1e-3)))
    if not shifted:
        return Curve()
    step = 0.25 * frame
    low, high = min(lags[0] for lags, *_ in shifted), max(lags[-1] for lags, *_ in shifted)
    grid = np.arange(np.ceil(low / step), np.floor(high / step) + 1) * step
    total, weights = np.zeros(len(grid)), np.zeros(len(grid))
    for lags, scores, weight in shifted:
        values = np.interp(grid, lags, scores, left=np.nan, right=np.nan)
        total += weight * np.nan_to_num(values)
        weights += weight * np.isfinite(values)
    # Where few pairs overlap, chance decides.
    enough = weights >= 0.5 * weights.max(initial=0)
    return Curve(grid + clocks.offsets[film], np.where(enough, total / np.maximum(weights, 1e-12), np.nan))


def runner_up(curve: Curve, offset: float, frame: float) -> RunnerUp | None:
    """The best maximum of a camera's curve at least a frame from its offset, seconds."""
    known = curve.known
    if len(known.lags) < 3:
        return None
    best = float(np.interp(offset, known.lags, known.scores))
    for lag, score in maxima(curve, frame, most=8):
        if abs(lag - offset) > frame and score > 0 and best > 0:
            return RunnerUp(lag, score / best)
    return None


def draw_curves(result: Synchronization) -> ImageArray:
    """(H, W, 3) uint8 RGB: a row a camera, its chosen offset in green, a runner-up as likely in orange."""
    cv2 = load_opencv()
    image = np.full((_ROW * max(len(result.cameras), 1), _WIDTH, 3), 255, np.uint8)
    for row, camera in enumerate(result.cameras):
        top = row * _ROW
        cv2.line(image, (0, top + _ROW - 1), (_WIDTH, top + _ROW - 1), (220, 220, 220), 1)
        captions = (camera.name[:16], f"{camera.offset:+.4f} s", f"confidence {camera.confidence:.2f}")
        for line, caption in enumerate(captions):
            corner = (6, top + 24 + 24 * line)
            cv2.putText(image, caption, corner, cv2.FONT_HERSHEY_SIMPLEX, 0.42, _INK, 1, cv2.LINE_AA)
        lags, scores = camera.curve.known.lags, camera.curve.known.scores
        if len(lags) < 2:
            continue
        ends, columns = (lags[0], lags[-1]), (_LEFT, _WIDTH - 8)
        marks = [(camera.offset, _CHOSEN, 2)]
        if camera.runner_up is not None and camera.runner_up.is_as_likely:
            marks.insert(0, (camera.runner_up.offset, _OTHER, 1))
        for offset, color, thickness in marks:
            x = round(float(np.interp(offset, ends, columns)))
            cv2.line(image, (x, top + 4), (x, top + _ROW - 6), color, thickness)
        bottom, peak = min(0.0, float(scores.min())), max(float(scores.max()), 1e-6)
        heights = top + _ROW - 6 - (_ROW - 12) * (scores - bottom) / (peak - bottom)
        points = np.stack([np.interp(lags, ends, columns), heights], axis=1).round().astype(np.int32)
        cv2.polylines(image, [points[:, None]], False, _LINE, 1, cv2.LINE_AA)
    return image
