"""Gives the solver of `frog calibrate` what rigs of known cameras would see, and compares: one JSON line a rig.

    python benchmarks/calibration.py OUT [--only WORDS]

The rigs of rig_cases.py see random points, as in the tests, which takes seconds a rig; rendered_rigs.py films rooms.
``results.jsonl`` lies in OUT; compressed it is docs/experiments/calibration/results.jsonl.gz, of which
tools/experiment_tables.py makes the table. Figures are those of real_rigs.py, and the worst k1.
"""

from __future__ import annotations

import argparse
import json
import re
import resource
import sys
import time
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from real_rigs import Rig, errors
from rig_cases import Case, Eye, cases

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "tests"))

from capture.calibration import sightings

from frog_blender.engine.capture.calibration.model import Lens


def compared(found: Rig, bends: Mapping[str, float], eyes: Sequence[Eye]) -> dict[str, float]:
    """The errors of cameras and of their k1, by name."""
    true: Rig = {eye.name: {"R": eye.pose[:, :3], "t": eye.pose[:, 3], "focal": eye.focal} for eye in eyes}
    figures = errors(found, true)
    return {
        **{name: figures[name] for name in ("centers", "rotations", "focals")},
        "k1": max((bends[eye.name] - eye.k1 for eye in eyes), key=abs),
    }


POINTS = {"attic": 1500, "hall": 1500, "studio": 500, "dark": 300, "wall": 2000}
"""How many points stand for a room."""


def measure(case: Case) -> dict[str, Any]:
    """What becomes of the points that the rig would see."""
    surfaces = (sightings.wall if case.room == "wall" else sightings.room)(POINTS[case.room], len(case.name))
    cameras = [Lens(eye.width, eye.height, eye.focal).camera(eye.name, eye.pose) for eye in case.eyes]
    sizes = sorted({(eye.width, eye.height) for eye in case.eyes})
    groups = [sizes.index((eye.width, eye.height)) for eye in case.eyes]
    record: dict[str, Any] = {"rig": case.name, "room": case.room, "cameras": len(cameras), "points": POINTS[case.room]}
    before, started = cpu_seconds(), time.perf_counter()
    solved = sightings.solved(cameras, surfaces, 7, k1=case.eyes[0].k1, groups=groups)
    record["seconds"], record["cpu_seconds"] = time.perf_counter() - started, cpu_seconds() - before
    if solved.refusal:
        return record | {"refusal": solved.refusal}
    found = list(zip(case.eyes, solved.model.poses, solved.model.lenses, strict=True))
    rig: Rig = {eye.name: {"R": pose[:, :3], "t": pose[:, 3], "focal": lens.focal} for eye, pose, lens in found}
    errors = compared(rig, {eye.name: lens.k1 for eye, _, lens in found}, case.eyes)
    return record | errors | {"warnings": solved.warnings}


def cpu_seconds() -> float:
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
    """The command line of whatever measures rigs."""
    parser = argparse.ArgumentParser(description=summary)
    parser.add_argument("out", type=Path, help="folder of results")
    parser.add_argument("--only", default="", help="a pattern that names of rigs must have")
    return parser


def run(options: argparse.Namespace, rigs: Sequence[Case], measure: Callable[[Case], dict[str, Any]]) -> None:
    """Writes and prints the record of each rig that is asked for, unless it is empty."""
    for case in rigs:
        if re.search(options.only, case.name) and (record := measure(case)):
            options.out.mkdir(parents=True, exist_ok=True)
            with (options.out / "results.jsonl").open("a") as file:
                file.write(json.dumps(record) + "\n")
            print(told(record), flush=True)


if __name__ == "__main__":
    run(arguments(__doc__.splitlines()[0]).parse_args(), cases(), measure)
