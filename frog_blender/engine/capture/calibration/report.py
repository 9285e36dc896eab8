"""What a calibration found: for programs (``calibration_report.json``), and for people as a page and as lines."""

from __future__ import annotations

import base64
import json
from collections.abc import Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path

import numpy as np

from ...arrays import Float64s, ImageArray
from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.plain_values import JsonObject, UnfitValue, entries, items, number, plain, text
from ..camera import Camera
from ..capture import Capture
from ..readers.checks import read_json
from ..synchronization.films import Film
from ..synchronization.synchronization import Synchronization, draw_curves
from ..video import load_opencv
from .calibration import Calibration, MovingCamera

REPORT, PAGE = "calibration_report.json", "calibration_report.html"
"""Names of the two files; a later run replaces them."""
_SAME = 1e-3  # of a focal length: two calibrations seldom agree so well in every camera
_MOST_LINES, _LONGEST_LINE, _MOST_CAMERAS = 1100, 10_000, 10_000
_STYLE = (
    "body{font:15px sans-serif;max-width:64rem;margin:2rem auto;color:#222}table{border-collapse:collapse}"
    "td,th{padding:.2rem .6rem;text-align:right;border-bottom:1px solid #ddd}img{max-width:100%}"
)


def write_report(folder: Path, calibration: Calibration, films: Sequence[Film], clocks: Synchronization) -> Path:
    """Writes both files into a folder and returns the page's path.

    Args:
        films: of the cameras, in their order.
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
    drawn = rig_from_above([found.camera for found in calibration.cameras], calibration.points)
    parts = [drawn, f"<h2>Cameras</h2>{_table(facts['cameras'])}"]
    if facts["pairs"]:
        parts.append(f"<h2>Points that pairs of cameras share</h2>{_table(facts['pairs'])}")
    if clocks.cameras:
        parts.append(f"<h2>Synchronisation</h2>{embedded(draw_curves(clocks))}")
    return _write(folder, facts, parts)


def write_moving_report(folder: Path, found: MovingCamera) -> Path:
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
    drawn = rig_from_above([found.lens.camera("", pose) for pose in found.poses], found.points)
    return _write(folder, facts, [drawn, f"<h2>Lens</h2>{_table([facts['lens']])}"])


def _write(folder: Path, facts: JsonObject, parts: Sequence[str]) -> Path:
    """Both files of the facts; the page has the lines that a terminal gets, then the parts."""
    lines = _lines(facts)
    write_atomically(folder / REPORT, json.dumps(facts | {"lines": lines}, indent=1).encode())
    head = f"<meta charset='utf-8'><title>Calibration</title><style>{_STYLE}</style>"
    told = [*lines, "A low residual alone proves nothing."]
    body = "".join([*(f"<p>{escape(line)}</p>" for line in told), "<h2>From above</h2>", *parts])
    page = f"<!doctype html><html><head>{head}</head><body><h1>Calibration</h1>{body}</body></html>"
    write_atomically(folder / PAGE, page.encode())
    return folder / PAGE


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
    for camera in cameras:
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


# --- drawings


_SIDE, _MARGIN = 560, 40
_DOTS = 1500  # points in the drawing of a rig
_FARTHEST = 8.0  # in halves of the rig's extent, from its middle: farther points do not widen a drawing


def rig_from_above(cameras: Sequence[Camera], points: Float64s) -> str:
    """The cameras and points (P, 3) as an SVG, y up."""
    dots = points[:: max(1, len(points) // _DOTS), :2]
    middle, reach = frame_from_above(np.array([camera.center[:2] for camera in cameras]), dots)
    near = dots[np.abs(dots - middle).max(axis=1, initial=0.0) <= reach]
    scale = (_SIDE / 2 - _MARGIN) / reach

    def at(place: Float64s) -> tuple[float, float]:
        x, y = (place - middle) * scale
        return round(float(x) + _SIDE / 2, 1), round(_SIDE / 2 - float(y), 1)

    parts = [f"<circle cx='{x}' cy='{y}' r='1' fill='#999'/>" for x, y in map(at, near)]
    for camera in cameras:
        (x, y), (ex, ey) = at(camera.center[:2]), at(camera.center[:2] + camera.forward[:2] * 22 / scale)
        parts.append(f"<line x1='{x}' y1='{y}' x2='{ex}' y2='{ey}' stroke='#27c' stroke-width='2'/>")
        parts.append(f"<circle cx='{x}' cy='{y}' r='4' fill='#27c'/>")
        parts.append(f"<text x='{x + 6}' y='{y - 6}' font-size='12'>{escape(camera.name)}</text>")
    return f"<svg viewBox='0 0 {_SIDE} {_SIDE}' width='{_SIDE}' height='{_SIDE}'>{''.join(parts)}</svg>"


def frame_from_above(cameras: Float64s, points: Float64s) -> tuple[Float64s, float]:
    """The square that shows a rig and what it films: its middle, (2,), and half its side.

    Cameras beside each other span far less than the scene in front of them. A background far behind it is left out,
    or the cameras would be one dot.

    Args:
        cameras: (C, 2), x and y of at least one camera.
        points: (P, 2), may be empty.
    """
    low, high = cameras.min(axis=0), cameras.max(axis=0)
    middle, reach = (low + high) / 2, max(float((high - low).max()) / 2, 1e-9)
    near = points[np.abs(points - middle).max(axis=1, initial=0.0) <= _FARTHEST * reach]
    if len(near):
        low, high = np.minimum(low, np.quantile(near, 0.02, axis=0)), np.maximum(high, np.quantile(near, 0.98, axis=0))
    return (low + high) / 2, max(float((high - low).max()) / 2, 1e-9)


def embedded(image: ImageArray) -> str:
    """An image (H, W, 3) RGB as an ``img`` element, without loss."""
    _, content = load_opencv().imencode(".png", np.ascontiguousarray(image[..., ::-1]))
    return f"<img alt='' src='data:image/png;base64,{base64.b64encode(content.tobytes()).decode()}'>"
