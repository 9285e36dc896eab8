"""Films rooms with rigs of known cameras, calibrates the films, and compares: one JSON line a rig.

    python benchmarks/calibration.py OUT [--only WORDS] [--again]

OUT keeps the films (a folder a rig), so that a second run only calibrates. ``results.jsonl`` lies beside them;
``tools/experiment_tables.py --keep OUT/results.jsonl calibration`` makes them the table of docs/experiments. Rigs stand
in rig_cases.py, rooms in rig_rooms.py, and rig_drawing.py draws them.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import shutil
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from rig_cases import Case, cases
from rig_drawing import Array, Drawing, Eye
from rig_rooms import ROOMS

from frog_blender.engine.capture.calibration.calibration import CalibrationRefused
from frog_blender.engine.capture.calibration.pipeline import Options, calibrate
from frog_blender.engine.capture.readers import open_capture

FRAMES, RATE = 24, 12.0
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
        unfinished = folder / "unfinished.mp4"
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


def errors(folder: Path, rig: Sequence[Eye]) -> dict[str, float]:
    """Worst centre (% of the rig's diameter) after similarity alignment, worst rotation (degrees) after removing one
    common rotation, worst focal length (%) and worst k1."""
    found = {camera.name: camera for camera in open_capture(folder).cameras}
    told = {each["name"]: each for each in json.loads((folder / "cameras_opencv.json").read_text())["cameras"]}
    ours = np.array([found[eye.name].center for eye in rig])
    theirs = np.array([eye.center for eye in rig])
    scale, turn, shift = _similarity(ours, theirs)
    diameter = np.linalg.norm(theirs[:, None] - theirs, axis=2).max()
    apart = np.linalg.norm(scale * ours @ turn.T + shift - theirs, axis=1) / diameter
    rotations = [found[eye.name].rotation for eye in rig]
    left, _, right = np.linalg.svd(sum(each.T @ eye.pose[:, :3] for each, eye in zip(rotations, rig, strict=True)))
    common = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    cosines = [(np.trace(each @ common @ eye.pose[:, :3].T) - 1) / 2 for each, eye in zip(rotations, rig, strict=True)]
    focals = [told[eye.name]["K"][0][0] / eye.focal - 1 for eye in rig]
    bends = [(told[eye.name]["dist"] or [0.0])[0] - eye.k1 for eye in rig]
    return {
        "centers": 100 * float(apart.max()),
        "rotations": float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).max()),
        "focals": 100 * max(focals, key=abs),
        "k1": max(bends, key=abs),
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
    record: dict[str, Any] = {"rig": case.name, "room": case.room, "cameras": len(case.eyes), "in_step": not case.shifts}
    before, started = _cpu(), time.perf_counter()
    try:
        outcome = calibrate(folder, Options(in_step=not case.shifts), lambda *_: None, lambda: False)
        record["warnings"] = list(outcome.warnings)
        record |= errors(folder, case.eyes)
    except CalibrationRefused as refusal:
        record["refusal"] = str(refusal)
    record["seconds"], record["cpu_seconds"] = time.perf_counter() - started, _cpu() - before
    return record


def _cpu() -> float:
    """Processor seconds of this process and its children."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(each.ru_utime + each.ru_stime for each in used)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path, help="folder of films and results")
    parser.add_argument("--only", default="", help="a pattern that names of rigs must have")
    parser.add_argument("--films", action="store_true", help="only draw the films")
    options = parser.parse_args()
    results = options.out / "results.jsonl"
    for case in cases():
        if not re.search(options.only, case.name):
            continue
        name = re.sub(r"\W+", "-", case.name)
        film(case, options.out / "films" / name)
        if options.films:
            print(case.name, flush=True)
            continue
        folder = options.out / "calibrated" / name
        shutil.rmtree(folder, ignore_errors=True)
        record = measure(case, options.out / "films" / name, folder)
        with results.open("a") as file:
            file.write(json.dumps(record) + "\n")
        told = f"{record['refusal'][:150]}" if "refusal" in record else (
            f"centres {record['centers']:.2f} %, rotations {record['rotations']:.2f}, focal {record['focals']:+.2f} %, "
            f"k1 {record['k1']:+.3f}, {record['warnings'] or ''}"
        )
        print(f"{case.name} [{record['seconds']:.0f} s, {record['cpu_seconds']:.0f} cpu]: {told}", flush=True)


if __name__ == "__main__":
    main()
