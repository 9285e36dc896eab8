"""Films rooms with rigs of known cameras, calibrates the films, and compares: one JSON line a rig.

    python benchmarks/calibration.py OUT [--only WORDS] [--films | --points]

OUT keeps the films (a folder a rig), so that a second run only calibrates; a minute a rig, most of it drawing. With
``--points`` no film is drawn: the solver is given what the cameras would see of random points, as in the tests, which
takes seconds a rig. ``results.jsonl`` lies in OUT; compressed it is docs/experiments/calibration/results.jsonl.gz, of
which tools/experiment_tables.py makes the table. Rigs stand in rig_cases.py, rooms in rig_rooms.py.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import shutil
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from rig_cases import Case, cases
from rig_drawing import Array, Drawing, Eye
from rig_rooms import ROOMS

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from capture.calibration import sightings

from frog_blender.engine.capture.calibration.model import Lens
from frog_blender.engine.capture.calibration.pipeline import Options, calibrate
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.capture.synchronization.films import CalibrationRefused

FRAMES, RATE = 12, 12.0
"""Of each film that is in step; the others are twice as long, for they share only a part."""


def film(case: Case, folder: Path) -> None:
    """A video of each camera."""
    folder.mkdir(parents=True, exist_ok=True)
    room = ROOMS[case.room]()
    frames = 2 * FRAMES if case.shifts else FRAMES
    for number, eye in enumerate(case.eyes):
        path = folder / f"{eye.name}.mp4"
        if path.exists():
            continue
        random = np.random.default_rng(number)
        late = case.shifts[number] if case.shifts else 0.0
        drawing = Drawing(eye, room.standing)
        unfinished = folder / f"{eye.name}.unfinished.mp4"
        writer = imageio_ffmpeg.write_frames(
            str(unfinished),
            (eye.width, eye.height),
            fps=RATE,
            codec="libx264",
            macro_block_size=1,
            output_params=["-crf", "18", "-preset", "veryfast"],
        )
        writer.send(None)
        for frame in range(frames):
            image = drawing.frame(room.moving(late + frame / RATE + 1.0), room.noise, random)
            writer.send(np.ascontiguousarray(image))
        writer.close()
        unfinished.rename(path)


def errors_of_files(folder: Path, rig: Sequence[Eye]) -> dict[str, float]:
    """The errors of a calibration on disk."""
    found = {camera.name: camera for camera in open_capture(folder).cameras}
    told = {each["name"]: each for each in json.loads((folder / "cameras_opencv.json").read_text())["cameras"]}
    lenses = [(told[eye.name]["K"][0][0], (told[eye.name]["dist"] or [0.0])[0]) for eye in rig]
    return errors(np.stack([found[eye.name].world_to_camera[:3] for eye in rig]), lenses, rig)


def errors(poses: Array, lenses: Sequence[tuple[float, float]], rig: Sequence[Eye]) -> dict[str, float]:
    """Worst centre (% of the rig's diameter) after similarity alignment, worst rotation (degrees) after removing one
    common rotation, worst focal length (%) and worst k1.

    Args:
        poses: (cameras, 3, 4) world to camera.
        lenses: focal length and k1.
    """
    rotations = poses[:, :, :3]
    ours = -np.einsum("nji,nj->ni", rotations, poses[:, :, 3])
    theirs = np.array([eye.center for eye in rig])
    scale, turn, shift = _similarity(ours, theirs)
    diameter = np.linalg.norm(theirs[:, None] - theirs, axis=2).max()
    apart = np.linalg.norm(scale * ours @ turn.T + shift - theirs, axis=1) / diameter
    left, _, right = np.linalg.svd(sum(each.T @ eye.pose[:, :3] for each, eye in zip(rotations, rig, strict=True)))
    common = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    cosines = [(np.trace(each @ common @ eye.pose[:, :3].T) - 1) / 2 for each, eye in zip(rotations, rig, strict=True)]
    return {
        "centers": 100 * float(apart.max()),
        "rotations": float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).max()),
        "focals": 100 * max((focal / eye.focal - 1 for (focal, _), eye in zip(lenses, rig, strict=True)), key=abs),
        "k1": max((k1 - eye.k1 for (_, k1), eye in zip(lenses, rig, strict=True)), key=abs),
    }


def _similarity(source: Array, target: Array) -> tuple[float, Array, Array]:
    """Scale, rotation and shift that take points (N, 3) to others best (Umeyama 1991)."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    left, values, right = np.linalg.svd(b.T @ a)
    signs = np.array([1, 1, np.linalg.det(left @ right)])
    turn, scale = (left * signs) @ right, float((values * signs).sum() / (a**2).sum())
    return scale, turn, target.mean(axis=0) - scale * turn @ source.mean(axis=0)


def measure(case: Case, films: Path, folder: Path) -> dict[str, Any]:
    """A calibration of the films and its errors."""
    folder.mkdir(parents=True, exist_ok=True)
    for path in films.glob("*.mp4"):
        shutil.copyfile(path, folder / path.name)
    record: dict[str, Any] = {
        "rig": case.name,
        "room": case.room,
        "cameras": len(case.eyes),
        "in_step": not case.shifts,
    }
    before, started = _cpu(), time.perf_counter()
    try:
        outcome = calibrate(folder, Options(in_step=not case.shifts), lambda *_: None, lambda: False)
        record["warnings"] = list(outcome.warnings)
        record |= errors_of_files(folder, case.eyes)
    except CalibrationRefused as refusal:
        record["refusal"] = str(refusal)
    record["seconds"], record["cpu_seconds"] = time.perf_counter() - started, _cpu() - before
    return record


POINTS = {"attic": 1500, "hall": 1500, "studio": 500, "dark": 300, "empty wall": 2000}
"""How many points stand for a room; mirrors and tiles have none that would do."""


def measure_points(case: Case) -> dict[str, Any]:
    """What becomes of the points that the rig would see."""
    surfaces = (sightings.wall if "wall" in case.room else sightings.room)(POINTS[case.room], len(case.name))
    cameras = [Lens(eye.width, eye.height, eye.focal).camera(eye.name, eye.pose) for eye in case.eyes]
    sizes = sorted({(eye.width, eye.height) for eye in case.eyes})
    groups = [sizes.index((eye.width, eye.height)) for eye in case.eyes]
    record: dict[str, Any] = {"rig": case.name, "room": case.room, "cameras": len(cameras), "points": POINTS[case.room]}
    before, started = _cpu(), time.perf_counter()
    solved = sightings.solved(cameras, surfaces, 7, k1=case.eyes[0].k1, groups=groups)
    record["seconds"], record["cpu_seconds"] = time.perf_counter() - started, _cpu() - before
    if solved.refusal:
        return record | {"refusal": solved.refusal}
    lenses = [(lens.focal, lens.k1) for lens in solved.model.lenses]
    return record | errors(solved.model.poses, lenses, case.eyes) | {"warnings": solved.warnings}


def _cpu() -> float:
    """Processor seconds of this process and its children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def told(record: dict[str, Any]) -> str:
    """A record in one line."""
    head = f"{record['rig']} [{record['seconds']:.0f} s, {record['cpu_seconds']:.0f} cpu]"
    if "refusal" in record:
        return f"{head}: {record['refusal'][:150]}"
    figures = f"centres {record['centers']:.2f} %, rotations {record['rotations']:.2f}, focal {record['focals']:+.2f} %"
    return f"{head}: {figures}, k1 {record['k1']:+.3f} {record['warnings'] or ''}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder of films and results")
    parser.add_argument("--only", default="", help="a pattern that names of rigs must have")
    kind = parser.add_mutually_exclusive_group()
    kind.add_argument("--films", action="store_true", help="only draw the films")
    kind.add_argument("--points", action="store_true", help="draw none: points that the cameras would see")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    results = options.out / "results.jsonl"
    for case in cases():
        if not re.search(options.only, case.name):
            continue
        name = re.sub(r"\W+", "-", case.name)
        if options.points:
            if case.shifts or case.room not in POINTS or any((eye.gains != 1).any() for eye in case.eyes):
                continue
            record = measure_points(case)
        else:
            film(case, options.out / "films" / name)
            if options.films:
                print(case.name, flush=True)
                continue
            folder = options.out / "calibrated" / name
            shutil.rmtree(folder, ignore_errors=True)
            record = measure(case, options.out / "films" / name, folder)
        with results.open("a") as file:
            file.write(json.dumps(record) + "\n")
        print(told(record), flush=True)


if __name__ == "__main__":
    main()
