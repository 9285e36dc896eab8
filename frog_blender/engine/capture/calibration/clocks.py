"""The films' clocks for calibration: synchronisation by sound and by what moves, as a stage of the pipeline.

Moving cameras are timed by sound alone: what moves in their images is the cameras themselves.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

from ...io.child_process import Progress
from ..synchronization import NamedTracks, Synchronization, synchronize
from ..synchronization.films import Film
from ..synchronization.run import Run, WorkFolder
from ..synchronization.synchronization import in_step
from ..synchronization.synchronize import Cameras
from ..video import load_opencv


def find_clocks(
    run: Run, films: Sequence[Film], cameras: Cameras | None = None, tracks: Mapping[str, NamedTracks] | None = None
) -> Synchronization:
    """The films' clocks, by sound, by points known by name, or by motion and moving points, in a process of its own.

    Args:
        cameras: that are known, by name.
        tracks: points that have the same names in all films, as a person's joints have.

    Raises:
        Stopped: if the run was cancelled.
        FrogError: if a film cannot be decoded, or the process of the synchronisation died.
    """
    return in_step(run.in_child(synchronized, films, cameras, tracks, run.work), films)


def synchronized(
    films: Sequence[Film],
    cameras: Cameras | None,
    tracks: Mapping[str, NamedTracks] | None,
    work: WorkFolder,
    tell: Progress,
) -> Synchronization:
    """``synchronize`` in the child, whose matrix library has one thread, for the matrices are small."""
    load_opencv().setNumThreads(1)  # films and pairs of them share the processors
    return synchronize(films, Run(work, tell, lambda: False), cameras, tracks)


def find_moving_clocks(run: Run, films: Sequence[Film]) -> Synchronization:
    """The clocks of moving cameras, and how they were found in a sentence, by default that the films are in step.

    Raises:
        Stopped: if the run was cancelled.
        FrogError: if a film cannot be decoded.
    """
    found = synchronize(films, run, tracks={})
    if found.refusal is None:
        sentence = "The films were synchronised by their sound alone, which is right to about a frame."
        return replace(found, warnings=(*found.warnings, sentence))
    sentence = (
        "Sound does not tell when the films of moving cameras began: they were taken to be in step. If they are not, "
        "give their clocks (--clock CAMERA=SECONDS)."
    )
    clocks = {film.name: (0.0, 1.0) for film in films}
    return replace(found.with_clocks(clocks), warnings=(sentence,), refusal=None)
