"""Films rooms with rigs of known cameras, calibrates the films, and compares: one JSON line a rig.

    python benchmarks/calibration.py OUT [--only WORDS] [--films | --points]

OUT keeps the films (a folder a rig), so that a second run only calibrates; a minute a rig, most of it drawing. With
``--points`` no film is drawn: the solver is given what the cameras would see of random points, as in the tests, which
takes seconds a rig. ``results.jsonl`` lies in OUT; compressed it is docs/experiments/calibration/results.jsonl.gz, of
which tools/experiment_tables.py makes the table. Rigs stand in rig_cases.py, rooms in rig_rooms.py. Figures are those
of real_rigs.py, and the worst k1.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import shutil
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
from real_rigs import Rig, errors, read_found
from rig_cases import Case, cases
from rig_drawing import Array, Drawing, Eye
from rig_rooms import ROOMS

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from capture.calibration import sightings

from frog_blender.engine.capture.calibration.model import Lens
from frog_blender.engine.capture.calibration.pipeline import Options, calibrate
from frog_blender.engine.capture.synchronization.films import CalibrationRefused

FRAMES, RATE = 12, 12.0
"""Of each film that is in step; the others are twice as long, for they share only a part."""


def film(case: Case, folder: Path) -> None:
    """A video of each camera that is not there yet."""
    room = ROOMS[case.room]()
    for number, eye in enumerate(case.eyes):
        if (folder / f"{eye.name}.mp4").exists():
            continue
        random, drawing = np.random.default_rng(number), Drawing(eye, room.standing)
        late = case.shifts[number] if case.shifts else 0.0
        times = (late + frame / RATE + 1.0 for frame in range(2 * FRAMES if case.shifts else FRAMES))
        encode(folder, eye, (drawing.frame(room.moving(time), room.noise, random) for time in times))


def encode(folder: Path, eye: Eye, images: Iterable[Array]) -> None:
    """The video of a camera, of images (H, W, 3) uint8; a killed run leaves none."""
    unfinished = folder / f"{eye.name}.unfinished.mp4"
    size, quality = (eye.width, eye.height), ["-crf", "18", "-preset", "veryfast"]
    writer = imageio_ffmpeg.write_frames(
        str(unfinished), size, fps=RATE, codec="libx264", macro_block_size=1, output_params=quality
    )
    writer.send(None)
    for image in images:
        writer.send(np.ascontiguousarray(image))
    writer.close()
    unfinished.rename(folder / f"{eye.name}.mp4")


def compared(found: Rig, bends: Mapping[str, float], eyes: Sequence[Eye]) -> dict[str, float]:
    """The errors of cameras and of their k1, by name."""
    true: Rig = {eye.name: {"R": eye.pose[:, :3], "t": eye.pose[:, 3], "focal": eye.focal} for eye in eyes}
    figures = errors(found, true)
    return {
        **{name: figures[name] for name in ("centers", "rotations", "focals")},
        "k1": max((bends[eye.name] - eye.k1 for eye in eyes), key=abs),
    }


def measure(case: Case, out: Path) -> dict[str, Any]:
    """A calibration of the films and its errors; of films out of step also of how many frames the worst film's start
    is wrong, whatever capture time starts with."""
    folder = out / "calibrated" / case.folder
    shutil.rmtree(folder, ignore_errors=True)
    shutil.copytree(out / "films" / case.folder, folder)
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
        _, found, offsets = read_found(folder)
        written = json.loads((folder / "cameras_opencv.json").read_text())["cameras"]
        record |= compared(found, {each["name"]: (each["dist"] or [0.0])[0] for each in written}, case.eyes)
        if case.shifts:
            wrong = np.array([offsets[eye.name] - late for eye, late in zip(case.eyes, case.shifts, strict=True)])
            record["clocks"] = float(RATE * np.abs(wrong - np.median(wrong)).max())
    except CalibrationRefused as refusal:
        record["refusal"] = str(refusal)
    record["seconds"], record["cpu_seconds"] = time.perf_counter() - started, _cpu() - before
    return record


POINTS = {"attic": 1500, "hall": 1500, "studio": 500, "dark": 300, "empty wall": 2000}
"""How many points stand for a room; mirrors and tiles have none that would do."""


def measure_points(case: Case) -> dict[str, Any]:
    """What becomes of the points that the rig would see; empty where there are none."""
    if case.shifts or case.room not in POINTS or any((eye.gains != 1).any() for eye in case.eyes):
        return {}
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
    found = list(zip(case.eyes, solved.model.poses, solved.model.lenses, strict=True))
    rig: Rig = {eye.name: {"R": pose[:, :3], "t": pose[:, 3], "focal": lens.focal} for eye, pose, lens in found}
    errors = compared(rig, {eye.name: lens.k1 for eye, _, lens in found}, case.eyes)
    return record | errors | {"warnings": solved.warnings}


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
    figures += f", clocks {record['clocks']:.3f} frames" if "clocks" in record else ""
    return f"{head}: {figures}, k1 {record['k1']:+.3f} {record['warnings'] or ''}"


def arguments(summary: str) -> argparse.ArgumentParser:
    """The command line of whatever films rigs."""
    parser = argparse.ArgumentParser(description=summary)
    parser.add_argument("out", type=Path, help="folder of films and results")
    parser.add_argument("--only", default="", help="a pattern that names of rigs must have")
    parser.add_argument("--films", action="store_true", help="only make the films")
    return parser


def run(options: argparse.Namespace, rigs: Sequence[Case], film: Callable[[Case, Path], None] | None) -> None:
    """Measures rigs whose films ``film`` makes in a folder; of points instead if None."""
    for case in rigs:
        record: dict[str, Any] = {}
        if not re.search(options.only, case.name):
            continue
        if film is None:
            record = measure_points(case)
        else:
            films = options.out / "films" / case.folder
            films.mkdir(parents=True, exist_ok=True)
            film(case, films)
            record = {} if options.films else measure(case, options.out)
        if record:
            options.out.mkdir(parents=True, exist_ok=True)
            with (options.out / "results.jsonl").open("a") as file:
                file.write(json.dumps(record) + "\n")
            print(told(record), flush=True)


def main() -> None:
    parser = arguments(__doc__.splitlines()[0])
    parser.add_argument("--points", action="store_true", help="draw none: points that the cameras would see")
    options = parser.parse_args()
    run(options, cases(), None if options.points else film)


if __name__ == "__main__":
    main()
