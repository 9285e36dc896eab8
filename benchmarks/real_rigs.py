"""Calibrates prepared rigs of real films by the command line, and compares with their true cameras: a JSON line a rig.

    python benchmarks/real_rigs.py RIG... [--frog .venv/bin/frog] [--out RESULTS.jsonl]
    python benchmarks/real_rigs.py --table BEFORE.jsonl AFTER.jsonl

RIG is a folder of raw footage, as a user would have it, which is copied before anything is written there. Beside it
lies ``RIG.truth.json``: ``cameras`` (by name, or by image of a moving camera, ``R`` and ``t`` from world to camera and
``focal`` in pixels), ``offsets`` (seconds by which films start late), ``arguments`` of ``frog calibrate``; all may be
empty. No module of the package is imported, so that one script measures any version. ``--table`` prints Markdown.

Figures are the worst camera's: its centre after the best similarity, in % of the rig's diameter, its rotation after one
common rotation, its focal length, and its offset after one common shift. Processor seconds include child processes.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

LONGEST = 3600.0
"""Seconds that a calibration may take."""
_RESULTS = ("cameras_opencv.json", "transforms.json")
_OPENGL = np.diag([1.0, -1.0, -1.0])

Rig = dict[str, dict[str, Any]]
"""By camera or image: ``R``, ``t`` and ``focal``."""


def read_found(folder: Path) -> tuple[str, Rig, dict[str, float]]:
    """The kind of rig that a calibration wrote, its cameras, and its offsets."""
    path = next(folder / name for name in _RESULTS if (folder / name).is_file())
    content = json.loads(path.read_text())
    if "cameras" in content:
        cameras = {
            c["name"]: {"R": c["R"], "t": c["t"], "focal": (c["K"][0][0] + c["K"][1][1]) / 2}
            for c in content["cameras"]
        }
        return "standing", cameras, {camera["name"]: camera.get("offset", 0.0) for camera in content["cameras"]}
    images = {}
    for frame in content["frames"]:
        pose = np.array(frame["transform_matrix"])
        rotation = (pose[:3, :3] @ _OPENGL).T
        focal = frame.get("fl_x", content.get("fl_x", 0.0))
        images[Path(frame["file_path"]).stem] = {"R": rotation, "t": -rotation @ pose[:3, 3], "focal": focal}
    return "moving", images, {}


def errors(found: Rig, true: Rig) -> dict[str, float]:
    """Worst and root mean square centre, rotation and focal length of the cameras that both have."""
    names = [name for name in true if name in found]
    ours, theirs = (np.array([np.array(rig[name]["R"]) for name in names]) for rig in (found, true))
    centers = [
        -np.einsum("nji,nj->ni", turns, [rig[n]["t"] for n in names]) for turns, rig in ((ours, found), (theirs, true))
    ]
    apart = _apart(*centers)
    left, _, right = np.linalg.svd(np.einsum("nji,njk->ik", ours, theirs))
    common = left @ np.diag([1, 1, np.linalg.det(left @ right)]) @ right
    cosines = (np.einsum("nij,jk,nik->n", ours, common, theirs) - 1) / 2
    focals = [found[n]["focal"] / true[n]["focal"] - 1 for n in names if found[n]["focal"] and true[n]["focal"]]
    return {
        "compared": len(names),
        "centers": 100 * float(apart.max()),
        "centers_rms": 100 * float(np.sqrt(np.square(apart).mean())),
        "rotations": float(np.degrees(np.arccos(np.clip(cosines, -1, 1))).max()),
        "focals": 100 * max(focals, key=abs, default=float("nan")),
    }


def _apart(source: np.ndarray, target: np.ndarray) -> np.ndarray:
    """(N,) distances after the best similarity (Umeyama 1991), over the largest between two of ``target``."""
    a, b = source - source.mean(axis=0), target - target.mean(axis=0)
    left, values, right = np.linalg.svd(b.T @ a)
    signs = np.array([1, 1, np.linalg.det(left @ right)])
    scale = (values * signs).sum() / max(np.square(a).sum(), 1e-300)
    diameter = np.linalg.norm(target[:, None] - target, axis=2).max()
    return np.linalg.norm(scale * a @ ((left * signs) @ right).T - b, axis=1) / diameter


def worst_offset(found: Mapping[str, float], true: Mapping[str, float]) -> float:
    """Seconds by which the worst film is off, after the shift of all that makes it least."""
    differences = [found[name] - true[name] for name in true if name in found]
    return (max(differences) - min(differences)) / 2


def run(command: Sequence[str], said: Path) -> tuple[int, float, float]:
    """Exit status, processor seconds with child processes, and seconds of a command; stopped after ``LONGEST``."""
    began = time.monotonic()
    with said.open("wb") as file:
        process = subprocess.Popen(command, stdout=file, stderr=subprocess.STDOUT, start_new_session=True)
        while True:
            pid, status, used = os.wait4(process.pid, os.WNOHANG)
            if pid:
                break
            if time.monotonic() - began > LONGEST:
                os.killpg(process.pid, signal.SIGKILL)
            time.sleep(0.2)
        process.returncode = os.waitstatus_to_exitcode(status)
    return process.returncode, used.ru_utime + used.ru_stime, time.monotonic() - began


def measure(rig: Path, frog: str) -> dict[str, Any]:
    """A calibration of a copy of the rig."""
    truth = json.loads(rig.with_name(f"{rig.name}.truth.json").read_text())
    record: dict[str, Any] = {"rig": rig.name, "source": truth["source"]}
    with tempfile.TemporaryDirectory(prefix="rig_") as parent:
        folder, said = Path(parent) / rig.name, Path(parent) / "said.txt"
        shutil.copytree(rig, folder)
        command = [frog, "calibrate", str(folder), *truth["arguments"]]
        status, record["cpu_seconds"], record["seconds"] = run(command, said)
        lines = said.read_text(errors="replace").replace(str(folder), rig.name).splitlines()
        record["warnings"] = [line.removeprefix("warning: ") for line in lines if line.startswith("warning: ")]
        if status:
            why = [line.removeprefix("frog: ") for line in lines if line.startswith("frog: ")]
            return record | {"result": "refused" if why else "failed", "why": " ".join(why or lines[-5:])}
        kind, cameras, offsets = read_found(folder)
        report = json.loads((folder / "calibration_report.json").read_text())
    record |= {"result": "found", "kind": kind, "cameras": len(cameras), "way": report.get("source")}
    residuals = [camera["residual"] for camera in report.get("cameras", [report]) if camera.get("residual") is not None]
    record["residual"] = max(residuals, default=None)
    if len(truth["cameras"].keys() & cameras.keys()) > 1:
        record |= errors(cameras, truth["cameras"])
    if len(truth["offsets"].keys() & offsets.keys()) > 1:
        record["offset_ms"] = 1e3 * worst_offset(offsets, truth["offsets"])
    return record


_FIGURES = {"centers": ".2f", "rotations": ".2f", "focals": "+.2f", "offset_ms": ".1f"}


def told(record: Mapping[str, Any]) -> str:
    """Centre, rotation, focal length and offset of a record, or that there are none, and processor seconds."""
    figures = [f"{record[key]:{form}}" if key in record else "-" for key, form in _FIGURES.items()]
    known = record["result"] == "found" and "centers" in record
    return f"{', '.join(figures) if known else record['result']} | {record['cpu_seconds']:.0f}"


def print_table(before: Path, after: Path) -> None:
    """Both records of every rig, as Markdown."""
    old, new = ({r["rig"]: r for r in map(json.loads, path.read_text().splitlines())} for path in (before, after))
    print("| rig | before | processor s | after | processor s |\n|---|---|---:|---|---:|")
    for name in dict.fromkeys([*old, *new]):
        print(f"| {name} | {' | '.join(told(records[name]) if name in records else ' | ' for records in (old, new))} |")


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("rigs", type=Path, nargs="*", metavar="RIG")
    parser.add_argument("--frog", default="frog", help="the command to measure; default: the one on the path")
    parser.add_argument("--out", type=Path, help="a file that JSON lines are added to")
    parser.add_argument("--table", type=Path, nargs=2, metavar=("BEFORE", "AFTER"), help="print two records")
    options = parser.parse_args()
    if options.table:
        print_table(*options.table)
    for rig in options.rigs:
        record = measure(rig, options.frog)
        print(
            f"| {record['rig']} | {told(record)} | {record.get('way') or ''} {record.get('why', '')[:300]}", flush=True
        )
        if options.out:
            with options.out.open("a") as file:
                file.write(json.dumps(record) + "\n")


if __name__ == "__main__":
    main()
