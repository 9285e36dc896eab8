"""Frames that another program made: where they come from, and what changes from one to the next."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from ..arrays import Bools, SceneArrays
from ..capture.camera import Camera
from ..capture.world import FILES_OWN, World
from ..gaussians import NumpyGaussians
from ..playback.frame_delta import column_names, column_of
from ..playback.player import PlayableCurves

_NOWHERE = 1e-6  # size of the rows that fill a frame with fewer Gaussians than another has
_SAMPLED = 4096  # Gaussians whose steps are looked at
_STEP = 0.1  # of the distance between two of them: a Gaussian that goes farther in a frame is another one
STILL_RATE = 24.0
"""Frames a second of a scene of one frame."""


class FrameSource:
    """Frames that can be read in any order, any number of times.

    Attributes:
        origin: the file's format, for the scene's header.
        frame_count: at least one.
        rate: frames a second.
        keeps_identity: whether the same row is the same Gaussian in all frames; None where the file does not say.
        cameras: of the capture, where the file has any.
        left_out: rows that could not be drawn and are in no frame, so far.
        arrays: a scene file's, where the file has the same: of a single frame, or with CURVES; else None.
        world: what was taken off places in double precision, which no float32 holds.
        notes: sentences about what looks otherwise than in the program that wrote it.
    """

    origin: str
    frame_count, rate, left_out = 1, STILL_RATE, 0
    keeps_identity: bool | None = True
    cameras: tuple[Camera, ...] = ()
    arrays: SceneArrays | None = None
    world = FILES_OWN
    notes: tuple[str, ...] = ()

    def at(self, frame: int) -> NumpyGaussians:
        """A frame, counted from 0: finite numbers, unit quaternions, at least one Gaussian; FrogError for others."""
        raise NotImplementedError


@dataclass
class StillSource(FrameSource):
    """A source of one frame; see ``FrameSource``."""

    gaussians: NumpyGaussians
    left_out: int = 0
    origin: str = ""
    arrays: SceneArrays | None = None
    world: World = FILES_OWN
    notes: tuple[str, ...] = ()

    def at(self, _frame: int) -> NumpyGaussians:
        return self.gaussians


class CurveSource(StillSource):
    """Gaussians whose ``arrays`` have CURVES over the time of all frames.

    No file says how many frames those are: as many as SpacetimeGaussians trains.
    """

    frame_count = 50

    def at(self, frame: int) -> NumpyGaussians:
        return PlayableCurves(self.arrays or {}).at(frame / (self.frame_count - 1))


@dataclass
class Survey:
    """What was seen of all frames: the most Gaussians, which of them change, and in which columns."""

    first: NumpyGaussians
    count: int
    moves: Bools
    columns: set[str]
    keeps_identity: bool


def survey(source: FrameSource, done: Callable[[int], None]) -> Survey:
    first = source.at(0)
    counts, degree = {len(first)}, first.sh.shape[1]
    moves, columns = np.zeros(len(first), bool), set()
    before, is_same = first, source.keeps_identity
    done(1)
    for frame in range(1, source.frame_count):
        gaussians = source.at(frame)
        counts.add(len(gaussians))
        degree = max(degree, gaussians.sh.shape[1])
        if len(counts) == 1 and is_same is not False:
            if is_same is None and not _same_rows(before, gaussians):
                is_same = False
            gaussians = filled(gaussians, len(first), max(gaussians.sh.shape[1], first.sh.shape[1]))
            for name in column_names(first.sh.shape[1]):
                changed = (column_of(gaussians, name) != column_of(first, name)).any(axis=1)
                if changed.any():
                    moves |= changed
                    columns.add(name)
        before = gaussians
        done(frame + 1)
    count = max(counts)
    if len(counts) > 1 or is_same is False or degree != first.sh.shape[1]:
        return Survey(filled(first, count, degree), count, np.ones(count, bool), set(column_names(degree)), False)
    return Survey(first, count, moves, columns, True)


def _same_rows(before: NumpyGaussians, after: NumpyGaussians) -> bool:
    """Whether rows are likely the same Gaussians: they move little against the distance to another row."""
    chance = np.random.default_rng(0)
    rows = chance.permutation(len(before))[:_SAMPLED]
    if len(rows) < 2:
        return True
    step = np.median(np.linalg.norm(after.means[rows] - before.means[rows], axis=1))
    apart = np.median(np.linalg.norm(before.means[rows] - before.means[np.roll(rows, 1)], axis=1))
    return bool(step <= _STEP * apart)


def filled(gaussians: NumpyGaussians, count: int, degree: int) -> NumpyGaussians:
    """With rows that cannot be seen up to ``count``, and SH coefficients of zero up to ``degree``."""
    more, g = count - len(gaussians), gaussians
    if not more and g.sh.shape[1] == degree:
        return g
    whole = g.part(np.append(np.arange(len(g)), np.zeros(more, np.int64)))
    whole.scales[len(g) :], whole.opacities[len(g) :] = _NOWHERE, 0
    whole.sh = np.zeros((count, degree, 3), np.float32)
    whole.sh[: len(g), : g.sh.shape[1]] = g.sh
    return whole
