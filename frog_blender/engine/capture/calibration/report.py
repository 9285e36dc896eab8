"""What a calibration found: for programs (``calibration_report.json``), and for people as a page and as lines."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path

import numpy as np

from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.plain_values import JsonObject, UnfitValue, entries, items, number, plain, text
from ..capture import Capture
from ..readers.checks import read_json
from ..synchronization.films import Film
from ..synchronization.report import draw_curves
from ..synchronization.synchronization import Synchronization
from .calibration import Calibration, MovingCamera
from .drawings import camera_image, rig_from_above, wide_image
from .views import View

REPORT, PAGE = "calibration_report.json", "calibration_report.html"
"""Names of the two files; a later run replaces them."""
_SHOWN = 16  # cameras, a line each
_SAME = 1e-3  # of a focal length: two calibrations seldom agree so well in every camera
_MOST_LINES, _LONGEST_LINE, _MOST_CAMERAS = 1100, 10_000, 10_000
_STYLE = (
    "body{font:15px sans-serif;max-width:64rem;margin:2rem auto;color:#222}table{border-collapse:collapse}"
    "td,th{padding:.2rem .6rem;text-align:right;border-bottom:1px solid #ddd}figure{display:inline-block;margin:.4rem}"
    "figcaption{font-size:13px;color:#555}figure img{width:19rem}img{max-width:100%}"
)


def write_report(
    folder: Path, calibration: Calibration, films: Sequence[Film], views: Sequence[View], clocks: Synchronization
) -> tuple[Path, Path]:
    """Writes both files into a folder and returns their paths.

    Args:
        films, views: of the cameras, in their order.
        clocks: what synchronisation found.

    Raises:
        FrogError: if one cannot be written.
    """
    names = [found.camera.name for found in calibration.cameras]
    facts = plain(
        {
            "kind": "standing cameras",
            "source": calibration.source,
            "cameras": [
                {
                    "name": found.camera.name,
                    "focal": float(found.camera.intrinsics[0, 0]),
                    "distortion": found.distortion,
                    "offset": film.offset,
                    "rate": film.rate,
                    **asdict(found.support),
                }
                for found, film in zip(calibration.cameras, films, strict=True)
            ],
            "pairs": [
                asdict(pair) | {"one": names[pair.one], "other": names[pair.other]} for pair in calibration.pairs
            ],
            "points": len(calibration.points),
            "halves_apart": calibration.halves_apart,
            "warnings": calibration.warnings,
            "synchronization": clocks if clocks.cameras else None,
        }
    )
    cameras = [found.camera for found in calibration.cameras]
    drawn = rig_from_above(
        names,
        np.array([camera.center[:2] for camera in cameras]),
        np.array([camera.forward[:2] for camera in cameras]),
        calibration.points,
    )
    figures = [
        f"<figure>{camera_image(view.background, found.camera.width, found.observations)}"
        f"<figcaption>{escape(found.camera.name)}: observations that agree (green), or not (red)</figcaption></figure>"
        for view, found in zip(views, calibration.cameras, strict=True)
    ]
    parts = [drawn, f"<h2>Cameras</h2>{_table(facts['cameras'])}"]
    if facts["pairs"]:
        parts.append(f"<h2>Points that pairs of cameras share</h2>{_table(facts['pairs'])}")
    parts.append(f"<h2>Coverage</h2>{''.join(figures)}")
    if clocks.cameras:
        parts.append(f"<h2>Synchronisation</h2>{wide_image(draw_curves(clocks))}")
    return _write(folder, facts, parts)


def write_moving_report(folder: Path, found: MovingCamera) -> tuple[Path, Path]:
    """The same for a moving camera."""
    facts = plain(
        {
            "kind": "one moving camera",
            "images": len(found.poses),
            "lens": found.lens,
            "focal_uncertainty": found.focal_uncertainty,
            "residual": found.residual,
            "halves_apart": found.halves_apart,
            "warnings": found.warnings,
        }
    )
    centers = -np.einsum("nji,nj->ni", found.poses[:, :, :3], found.poses[:, :, 3])
    drawn = rig_from_above([""] * len(centers), centers[:, :2], found.poses[:, 2, :2], found.points)
    return _write(folder, facts, [drawn, f"<h2>Lens</h2>{_table([facts['lens']])}"])


def _write(folder: Path, facts: JsonObject, parts: Sequence[str]) -> tuple[Path, Path]:
    """Both files of the facts; the page has the lines that a terminal gets, then the parts."""
    lines = _lines(facts)
    write_atomically(folder / REPORT, json.dumps(facts | {"lines": lines}, indent=1).encode())
    head = f"<meta charset='utf-8'><title>Calibration</title><style>{_STYLE}</style>"
    told = [*lines, "A low residual alone proves nothing."]
    body = "".join([*(f"<p>{escape(line)}</p>" for line in told), "<h2>From above</h2>", *parts])
    page = f"<!doctype html><html><head>{head}</head><body><h1>Calibration</h1>{body}</body></html>"
    write_atomically(folder / PAGE, page.encode())
    return folder / REPORT, folder / PAGE


def report_lines(capture: Capture) -> list[str]:
    """What the report beside a capture's cameras says; empty without one, one sentence for one that cannot be read."""
    path = capture.path / REPORT
    if not path.is_file():
        return []
    try:
        facts = read_json(path)
        lines = [text(line, "a line", _LONGEST_LINE) for line in items(facts.get("lines"), "lines", _MOST_LINES)]
        found = {}
        for camera in items(facts.get("cameras", []), "cameras", _MOST_CAMERAS):
            entry = entries(camera, "a camera")
            found[text(entry.get("name"), "a name", 1000)] = number(entry.get("focal"), "a focal length", 0, 1e12)
    except FrogError as error:
        return [str(error)]
    except UnfitValue as error:
        return [f"{path}: found {error.found}, expected {error.expected}."]
    used = {camera.name: float(camera.intrinsics[0, 0]) for camera in capture.cameras}
    if not found or (
        found.keys() == used.keys() and all(abs(found[name] - used[name]) <= _SAME * used[name] for name in used)
    ):
        return lines
    return ["This report is of another calibration than the one in use.", *lines]


def _lines(facts: JsonObject) -> list[str]:
    """All of it in lines for a terminal."""
    cameras = facts.get("cameras", [])
    parts = [f"{len(cameras)} {facts['kind']} from {facts['source']}" if cameras else str(facts["kind"])]
    parts += [f"{facts[name]} {name}" for name in ("images", "points") if name in facts]
    if facts.get("residual") is not None:
        parts.append(f"median residual {facts['residual']:.2f} px")
    if facts["halves_apart"] is not None:
        apart = 100 * facts["halves_apart"]
        parts.append(f"two halves of what was seen put the cameras {apart:.2g} % of their extent apart")
    lines = [", ".join(parts)]
    known = sorted((camera["residual"], camera["name"]) for camera in cameras if camera["residual"] is not None)
    if len(cameras) > _SHOWN and known:
        usual = (known[(len(known) - 1) // 2][0] + known[len(known) // 2][0]) / 2
        lines.append(f"median residual {usual:.2f} px, at most {known[-1][0]:.2f} ({known[-1][1]})")
    for camera in cameras if len(cameras) <= _SHOWN else []:
        told = "no residual" if camera["residual"] is None else f"median residual {camera['residual']:.2f} px"
        within = "" if camera["focal_uncertainty"] is None else f" within {100 * camera['focal_uncertainty']:.2g} %"
        lines.append(f"{camera['name']}: {told}, focal length {camera['focal']:.1f} px{within}")
    clocks = facts.get("synchronization") or {}
    if clocks:
        frames = clocks["residual"] / clocks["frame"]
        lines.append(f"synchronisation: residual {clocks['residual']:.4f} s ({frames:.2f} frames)")
    return [*lines, *([clocks["refusal"]] if clocks.get("refusal") else []), *facts["warnings"]]


def _table(rows: Sequence[JsonObject]) -> str:
    """A table of plain values."""
    head = "".join(f"<th>{escape(name.replace('_', ' '))}</th>" for name in rows[0])
    body = ("".join(f"<td>{escape(_shown(value))}</td>" for value in row.values()) for row in rows)
    return f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in body)}</table>"


def _shown(value: object) -> str:
    if isinstance(value, list):
        return ", ".join(map(_shown, value))
    return f"{value:.5g}" if isinstance(value, float) else "" if value is None else str(value)
