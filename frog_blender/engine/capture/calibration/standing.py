"""The poses and lenses of standing cameras from their views: what the caller sees of the child's work."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Sequence
from dataclasses import fields

import numpy as np

from ...errors import FrogError, brief
from ...io.atomic_files import write_atomically
from ...io.child_process import REQUEST, Progress
from ...io.plain_values import JsonObject
from .calibration import CalibratedCamera, Calibration
from .child_process import run, run_several
from .evidence import CameraEvidence, PairEvidence
from .feature_task import arrays_of, missing_features
from .films import View
from .lens import Lens
from .walk import Walk
from .work_folder import WorkFolder, key_of

_MOST_PROCESSES = 8  # each holds pycolmap and a camera's images
_FEWEST_IMAGES = 4  # in which features are worth a process's start


def calibrate_standing(
    views: Sequence[View],
    work: WorkFolder,
    progress: Progress,
    cancelled: Callable[[], bool],
    walks: Sequence[Walk] = (),
) -> Calibration:
    """The cameras of standing views.

    Args:
        work: keeps the stages, so that a second call with the same views continues.
        progress: told a stage's name, and how much of how much is done.
        cancelled: asked several times a second.
        walks: walk-throughs of what the views show, which connect them.

    Raises:
        CalibrationRefused: if the views do not fix their cameras: why, and what to film next time.
        Stopped: if ``cancelled`` said so.
        FrogError: if pycolmap is missing, or its process died.
    """
    entries = []
    for view in views:
        arrays = arrays_of(view)
        key = key_of(view.name, list(view.size), view.group, *(arrays[name] for name in sorted(arrays)))
        if work.load("view", key) is None:  # a damaged one is written anew
            work.keep("view", key, arrays)
        entries.append({"name": view.name, "size": list(view.size), "group": view.group, "key": key})
    _find_features(views, entries, work, progress, cancelled)
    task = "scan" if walks else "standing"
    folder = work.path / task
    request = {"work": str(work.path), "views": entries, "walks": [walk.plain() for walk in walks]}
    write_atomically(folder / REQUEST, json.dumps(request).encode())
    result = run(task, folder, progress, cancelled)
    try:
        return _calibration(result)
    except (KeyError, TypeError, ValueError) as error:
        raise FrogError(f"{folder}: found a result that is damaged ({brief(error)}), expected a whole one.") from error


def _find_features(
    views: Sequence[View],
    entries: Sequence[JsonObject],
    work: WorkFolder,
    progress: Progress,
    cancelled: Callable[[], bool],
) -> None:
    """Finds in several processes what features the work folder lacks; of a few of them the next stage takes care."""
    images = [
        (entry, moment) for view, entry in zip(views, entries, strict=True) for moment in missing_features(work, view)
    ]
    count = min(_MOST_PROCESSES, os.cpu_count() or 1, len(images) // _FEWEST_IMAGES)
    if count < 2:
        return
    folders = []
    for number in range(count):  # neighbours together: a process reads the views that it needs
        part = images[len(images) * number // count : len(images) * (number + 1) // count]
        asked = [entry | {"moments": [of for each, of in part if each is entry]} for entry in entries]
        request = {"work": str(work.path), "views": [entry for entry in asked if entry["moments"]]}
        folders.append(work.path / f"features-{number}")
        write_atomically(folders[-1] / REQUEST, json.dumps(request).encode())
    run_several("features", folders, len(images), progress, cancelled)


def _calibration(result: JsonObject) -> Calibration:
    """The calibration that the child's result describes; KeyError, TypeError or ValueError where it is damaged."""
    return Calibration(
        tuple(_camera(entry) for entry in result["cameras"]),
        np.asarray(result["points"], np.float64).reshape(-1, 3),
        tuple(PairEvidence(*(int(entry[each.name]) for each in fields(PairEvidence))) for entry in result["pairs"]),
        float(result["start"]),
        bool(result["own_focals"]),
        tuple(float(each) for each in result["costs"]),
        float(result["halves_apart"]),
        tuple(str(each) for each in result["warnings"]),
    )


def _camera(entry: JsonObject) -> CalibratedCamera:
    lens = entry["lens"]
    size = Lens(int(lens["width"]), int(lens["height"]), float(lens["focal"]))
    camera = size.camera(str(entry["name"]), np.asarray(entry["pose"], np.float64).reshape(3, 4))
    evidence = entry["evidence"]
    supported = CameraEvidence(
        observations=int(evidence["observations"]),
        share=float(evidence["share"]),
        shared_by_three=int(evidence["shared_by_three"]),
        residual=float(evidence["residual"]),
        coverage=float(evidence["coverage"]),
        focal_uncertainty=float(evidence["focal_uncertainty"]),
        closing=float(evidence["closing"]),
    )
    return CalibratedCamera(
        camera,
        (float(lens["k1"]), float(lens["k2"])),
        supported,
        np.asarray(entry["observations"], np.float64).reshape(-1, 3),
    )
