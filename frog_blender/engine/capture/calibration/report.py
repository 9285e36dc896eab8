"""What a calibration found: for programs (``calibration_report.json``), and for people as a page and as lines."""

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
from .model import Calibration, MovingCamera

REPORT, PAGE = "calibration_report.json", "calibration_report.html"
"""Names of the two files; a later run replaces them."""
_SHOWN = 16  # cameras, a line each
_SAME = 1e-3  # of a focal length: two calibrations seldom agree so well in every camera
_MOST_LINES, _LONGEST_LINE, _MOST_CAMERAS = 1100, 10_000, 10_000
_SIDE, _MARGIN, _AHEAD = 560, 0.08, 22  # pixels of a drawing, a part of it, pixels that show where a camera looks
_DOTS = 1500  # points in a drawing
_FARTHEST = 8.0  # in halves of the rig's extent, from its middle: farther points do not widen a drawing
_WIDE = 480  # pixels of a camera's image
_GREEN, _RED = (60, 170, 40), (40, 40, 220)  # blue, green, red
_STYLE = (
    "body{font:15px sans-serif;max-width:64rem;margin:2rem auto;color:#222}table{border-collapse:collapse}"
    "td,th{padding:.2rem .6rem;text-align:right;border-bottom:1px solid #ddd}figure{display:inline-block;margin:.4rem}"
    "figcaption{font-size:13px;color:#555}figure img{width:19rem}img{max-width:100%}"
)


def write_report(
    folder: Path, calibration: Calibration, films: Sequence[Film], clocks: Synchronization
) -> tuple[Path, Path]:
    """Writes both files into a folder and returns their paths.

    Args:
        films: of the cameras, in their order.
        clocks: what synchronization found.

    Raises:
        FrogError: if one cannot be written, or a film's first image not be decoded.
    """
    cameras = [calibrated.camera for calibrated in calibration.cameras]
    facts = plain(
        {
            "kind": "standing cameras",
            "source": calibration.source,
            "cameras": [
                {
                    "name": calibrated.camera.name,
                    "focal": float(calibrated.camera.intrinsics[0, 0]),
                    "distortion": calibrated.distortion,
                    "offset": film.offset,
                    "rate": film.rate,
                    **asdict(calibrated.support),
                }
                for calibrated, film in zip(calibration.cameras, films, strict=True)
            ],
            "pairs": [
                asdict(pair) | {"one": cameras[pair.one].name, "other": cameras[pair.other].name}
                for pair in calibration.pairs
            ],
            "points": len(calibration.points),
            "halves_apart": calibration.halves_apart,
            "warnings": calibration.warnings,
            "synchronization": clocks if clocks.cameras else None,
        }
    )
    figures = [
        f"<figure>{_camera_image(film, calibrated.observations)}"
        f"<figcaption>{escape(film.name)}: observations that agree (green), or not (red)</figcaption></figure>"
        for film, calibrated in zip(films, calibration.cameras, strict=True)
    ]
    parts = [_rig_from_above(cameras, calibration.points), f"<h2>Cameras</h2>{_table(facts['cameras'])}"]
    if facts["pairs"]:
        parts.append(f"<h2>Points that pairs of cameras share</h2>{_table(facts['pairs'])}")
    parts.append(f"<h2>Coverage</h2>{''.join(figures)}")
    if clocks.cameras:
        parts.append(f"<h2>Synchronization</h2>{_element('png', draw_curves(clocks)[..., ::-1])}")
    return _write(folder, facts, parts)


def write_moving_report(folder: Path, camera: MovingCamera) -> tuple[Path, Path]:
    """The same for a moving camera."""
    facts = plain(
        {
            "kind": "one moving camera",
            "images": len(camera.poses),
            "lens": camera.lens,
            "focal_uncertainty": camera.focal_uncertainty,
            "residual": camera.residual,
            "halves_apart": camera.halves_apart,
            "warnings": camera.warnings,
        }
    )
    drawn = _rig_from_above([camera.lens.camera("", pose) for pose in camera.poses], camera.points)
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
        focals = {}
        for camera in items(facts.get("cameras", []), "cameras", _MOST_CAMERAS):
            entry = entries(camera, "a camera")
            focals[text(entry.get("name"), "a name", 1000)] = number(entry.get("focal"), "a focal length", 0, 1e12)
    except FrogError as error:
        return [str(error)]
    except UnfitValue as error:
        return [f"{path}: found {error.found}, expected {error.expected}."]
    used = {camera.name: float(camera.intrinsics[0, 0]) for camera in capture.cameras}
    is_same = focals.keys() == used.keys() and all(abs(focals[name] / used[name] - 1) <= _SAME for name in used)
    return lines if is_same or not focals else ["This report is of another calibration than the one in use.", *lines]


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
        lines.append(f"synchronization: residual {clocks['residual']:.4f} s ({frames:.2f} frames)")
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


def from_above(cameras: Sequence[Camera], points: Float64s, side: int) -> tuple[Float64s, Float64s]:
    """A rig and what it films in a square of so many pixels, y up: points (P, 2); where cameras are and look (C, 2, 2).

    Cameras beside each other span far less than the scene in front of them. A background far behind it is left out,
    or the cameras would be one dot.

    Args:
        cameras: at least one.
        points: (N, 3), may be empty; of many, some are drawn.
    """
    centers, ahead = np.array([(camera.center[:2], camera.forward[:2]) for camera in cameras]).transpose(1, 0, 2)
    dots = points[:: max(1, len(points) // _DOTS), :2]
    low, high = centers.min(axis=0), centers.max(axis=0)
    reach = max(float((high - low).max()) / 2, 1e-9)
    near = dots[np.abs(dots - (low + high) / 2).max(axis=1, initial=0.0) <= _FARTHEST * reach]
    if len(near):
        low, high = np.minimum(low, np.quantile(near, 0.02, axis=0)), np.maximum(high, np.quantile(near, 0.98, axis=0))
    middle, reach = (low + high) / 2, max(float((high - low).max()) / 2, 1e-9)
    dots = dots[np.abs(dots - middle).max(axis=1, initial=0.0) <= reach]
    scale = (1 - 2 * _MARGIN) * side / (2 * reach)
    eyes = np.stack([centers, centers + ahead * _AHEAD / scale], axis=1)
    drawn, seen = (side / 2 + (positions - middle) * (scale, -scale) for positions in (dots, eyes))
    return drawn, seen


def _rig_from_above(cameras: Sequence[Camera], points: Float64s) -> str:
    """The cameras and points (P, 3) as an SVG."""
    dots, eyes = from_above(cameras, points, _SIDE)
    parts = [f"<circle cx='{x}' cy='{y}' r='1' fill='#999'/>" for x, y in dots.round(1).tolist()]
    for camera, ((x, y), (ex, ey)) in zip(cameras, eyes.round(1).tolist(), strict=True):
        parts.append(f"<line x1='{x}' y1='{y}' x2='{ex}' y2='{ey}' stroke='#27c' stroke-width='2'/>")
        parts.append(f"<circle cx='{x}' cy='{y}' r='4' fill='#27c'/>")
        parts.append(f"<text x='{x + 6}' y='{y - 6}' font-size='12'>{escape(camera.name)}</text>")
    return f"<svg viewBox='0 0 {_SIDE} {_SIDE}' width='{_SIDE}' height='{_SIDE}'>{''.join(parts)}</svg>"


def _camera_image(film: Film, observations: Float64s) -> str:
    """A film's first image with observations (N, 3) in it: x, y, and 1 for those that agree."""
    cv2 = load_opencv()
    image = cv2.cvtColor(next(film.gray([0], _WIDE)), cv2.COLOR_GRAY2BGR)
    scale = image.shape[1] / film.size[0]
    for x, y, agrees in observations.tolist():
        cv2.circle(image, (int(x * scale), int(y * scale)), 2, _GREEN if agrees else _RED, -1, cv2.LINE_AA)
    return _element("jpeg", image)


def _element(kind: str, image: ImageArray) -> str:
    """An image (H, W, 3) BGR as an ``img`` element."""
    _, content = load_opencv().imencode(f".{kind}", np.ascontiguousarray(image))
    return f"<img alt='' src='data:image/{kind};base64,{base64.b64encode(content.tobytes()).decode()}'>"
