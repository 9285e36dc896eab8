"""Cameras from images, as the caller sees it: requests to the child's tasks (``placing_task``), and their results."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass

import numpy as np

from ...arrays import Array, Float64s
from ...errors import FrogError, brief
from ...io.atomic_files import write_atomically
from ...io.child_process import REQUEST, Progress, Stopped
from ...io.plain_values import JsonObject
from ..synchronization import NamedTracks
from .board_detection import Board, Corners
from .calibration import Calibration, child_task
from .features import missing_features
from .films import View, arrays_of
from .points import CameraFacts
from .sequences import ImageSequence
from .work_folder import WorkFolder, key_of

_MOST_PROCESSES = 8  # each holds pycolmap and a camera's images
_FEWEST_IMAGES = 4  # in which features are worth a process's start


@dataclass(frozen=True)
class Run:
    """What all stages of a calibration share.

    Attributes:
        work: keeps the stages, so that a second run with the same footage continues.
        progress: told a stage's name, and how much of how much is done.
        cancelled: asked several times a second; what it ends raises Stopped.
    """

    work: WorkFolder
    progress: Progress
    cancelled: Callable[[], bool]

    def check(self) -> None:
        """Called before each image: ends the work when it was cancelled."""
        if self.cancelled():
            raise Stopped


def place_views(views: Sequence[View], run: Run, sequences: Sequence[ImageSequence] = ()) -> Calibration:
    """The cameras of standing views.

    Args:
        sequences: walk-throughs of what the views show, which connect them.

    Raises:
        CalibrationRefused: if the views do not fix their cameras: why, and what to film next time.
        FrogError: if pycolmap is missing, or its process died.
    """
    entries = []
    for view in views:
        arrays = arrays_of(view)
        key = key_of(view.name, list(view.size), view.group, *(arrays[name] for name in sorted(arrays)))
        if run.work.load("view", key) is None:  # a damaged one is written anew
            run.work.keep("view", key, arrays)
        entries.append({"name": view.name, "size": list(view.size), "group": view.group, "key": key})
    _find_features(views, entries, run)
    return _calibration(place_images(entries, sequences, run), run.work)


def place_images(entries: Sequence[JsonObject], sequences: Sequence[ImageSequence], run: Run) -> JsonObject:
    """The child's result (``placing_task.place_images``) for views that the work folder keeps, and for sequences."""
    folder = run.work.path / "images"
    plain = [sequence.plain() for sequence in sequences]
    request = {"work": str(run.work.path), "views": list(entries), "sequences": plain}
    write_atomically(folder / REQUEST, json.dumps(request).encode())
    return child_task("placing_task:place_images").run(folder, run.progress, run.cancelled)


def _calibration(result: JsonObject, work: WorkFolder) -> Calibration:
    """The calibration that a child's result describes; FrogError where it is damaged."""
    try:
        return Calibration.of_plain(result)
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise FrogError(f"{work.path}: found a damaged result ({brief(error)}), expected a whole one.") from error


def place_by_clicks(
    facts: Sequence[CameraFacts], groups: Sequence[int], clicks: Mapping[str, Array], run: Run
) -> Calibration:
    """``points.calibrate_clicks`` in the child."""
    plain = {name: points.tolist() for name, points in clicks.items()}
    return _placed("clicks", facts, {"groups": list(groups), "clicks": plain}, run)


def place_by_board(
    facts: Sequence[CameraFacts], board: Board, corners: Sequence[Sequence[Corners | None]], run: Run
) -> Calibration:
    """``board.calibrate_board`` in the child."""
    plain = [
        [None if shown is None else [shown.numbers.tolist(), shown.pixels.tolist()] for shown in found]
        for found in corners
    ]
    return _placed("board", facts, {"board": asdict(board), "corners": plain}, run)


def place_by_joints(facts: Sequence[CameraFacts], groups: Sequence[int], pixels: Float64s, run: Run) -> Calibration:
    """``joint_rig.calibrate_joints`` in the child."""
    return _placed("joints", facts, {"groups": list(groups), "pixels": pixels.tolist()}, run)


def place_by_tracks(
    facts: Sequence[CameraFacts],
    groups: Sequence[int],
    tracks: Sequence[NamedTracks],
    clocks: tuple[Sequence[Float64s], float],
    run: Run,
) -> tuple[Calibration, Float64s]:
    """``joint_rig.calibrate_unsynchronised`` in the child.

    Args:
        clocks: where to start, and the seconds between frames of the slowest film.
    """
    plain = [[track.times.tolist(), track.positions.tolist()] for track in tracks]
    starts, frame = clocks
    seen = {"groups": list(groups), "tracks": plain, "starts": [start.tolist() for start in starts], "frame": frame}
    result = _result("tracks", facts, seen, run)
    return _calibration(result, run.work), np.asarray(result["offsets"], np.float64)


def _placed(task: str, facts: Sequence[CameraFacts], seen: JsonObject, run: Run) -> Calibration:
    return _calibration(_result(task, facts, seen, run), run.work)


def _result(task: str, facts: Sequence[CameraFacts], seen: JsonObject, run: Run) -> JsonObject:
    """What the child's ``place_by_`` that task returns."""
    folder = run.work.path / task
    request = {"cameras": [asdict(camera) for camera in facts], **seen}
    write_atomically(folder / REQUEST, json.dumps(request).encode())
    return child_task(f"placing_task:place_by_{task}").run(folder, run.progress, run.cancelled)


def _find_features(views: Sequence[View], entries: Sequence[JsonObject], run: Run) -> None:
    """Finds in several processes what features the work folder lacks; of a few of them the next stage takes care."""
    missing = [missing_features(run.work, view) for view in views]
    images = [(entry, moment) for entry, moments in zip(entries, missing, strict=True) for moment in moments]
    count = min(_MOST_PROCESSES, os.cpu_count() or 1, len(images) // _FEWEST_IMAGES)
    if count < 2:
        return
    folders = []
    for process in range(count):  # neighbours together: a process reads the views that it needs
        part = images[len(images) * process // count : len(images) * (process + 1) // count]
        asked = [entry | {"moments": [moment for own, moment in part if own is entry]} for entry in entries]
        request = {"work": str(run.work.path), "views": [entry for entry in asked if entry["moments"]]}
        folders.append(run.work.path / f"features-{process}")
        write_atomically(folders[-1] / REQUEST, json.dumps(request).encode())
    child_task("placing_task:find_features").run_several(folders, len(images), run.progress, run.cancelled)
