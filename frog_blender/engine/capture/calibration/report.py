"""What a calibration found: for programs (``calibration_report.json``), and for people as a page and as lines."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import asdict
from html import escape
from pathlib import Path

from ...errors import FrogError
from ...io.atomic_files import write_atomically
from ...io.plain_values import JsonObject, UnfitValue, entries, items, number, text
from ..capture import Capture
from ..readers.checks import read_json
from .calibration import Calibration
from .clocks import FoundClocks
from .drawings import camera_image, matches_table, rig_from_above, wide_image
from .films import Film, View

REPORT, PAGE = "calibration_report.json", "calibration_report.html"
"""Names of the two files; a later run replaces them."""
_SHOWN = 16  # cameras, a line each
_SAME = 1e-3  # of a focal length: two calibrations seldom agree so well in every camera
_MOST_LINES, _LONGEST_LINE, _MOST_CAMERAS = 1100, 10_000, 10_000
_STYLE = (
    "body{font:15px sans-serif;max-width:64rem;margin:2rem auto;color:#222}table{border-collapse:collapse}"
    "td,th{padding:.2rem .6rem;text-align:right;border-bottom:1px solid #ddd}figure{display:inline-block;margin:.4rem}"
    "figcaption{font-size:13px;color:#555}.warning{color:#a40}figure img{width:19rem}img{max-width:100%}"
)


def write_report(
    folder: Path, calibration: Calibration, films: Sequence[Film], views: Sequence[View], clocks: FoundClocks
) -> tuple[Path, Path]:
    """Writes both files into a folder and returns their paths.

    Args:
        films, views: of the cameras, in their order.
        clocks: what synchronisation found.

    Raises:
        FrogError: if one cannot be written.
    """
    facts = _facts(calibration, films) | {"synchronization": clocks.facts}
    write_atomically(folder / REPORT, json.dumps(facts | {"lines": _lines(facts)}, indent=1).encode())
    write_atomically(folder / PAGE, _page(calibration, facts, views, clocks).encode())
    return folder / REPORT, folder / PAGE


def write_moving_report(folder: Path, result: JsonObject, warnings: Sequence[str]) -> tuple[Path, Path]:
    """The same for moving cameras, by the child's result."""
    lenses, poses = result["lenses"], result["poses"]
    facts: JsonObject = {
        "kind": "one moving camera" if len(lenses) == 1 else f"{len(lenses)} moving cameras",
        "images": len(poses),
        "focal": lenses[0]["focal"],
        "distortion": [lenses[0]["k1"], lenses[0]["k2"]],
        "lenses": lenses,
        "focal_uncertainty": result["focal_uncertainty"],
        "residual": result["residual"],
        "halves_apart": result["halves_apart"],
        "costs": result["costs"],
        "warnings": list(warnings),
    }
    write_atomically(folder / REPORT, json.dumps(facts | {"lines": _lines(facts)}, indent=1).encode())
    places = [_center(pose) for pose in poses]
    ahead = [(pose[2][0], pose[2][1]) for pose in poses]
    drawn = rig_from_above([""] * len(poses), [(x, y) for x, y, _ in places], ahead, result["points"])
    focals = ", ".join(dict.fromkeys(f"{lens['focal']:.1f}" for lens in lenses))
    sentence = (
        f"{len(poses)} images; focal length {focals} pixels, known within "
        f"{100 * result['focal_uncertainty']:.2f} %; median residual {result['residual']:.2f} pixels."
    )
    parts = [f"<p>{escape(sentence)}</p>", *_warnings(warnings), f"<h2>The path from above</h2>{drawn}"]
    write_atomically(folder / PAGE, _html(parts).encode())
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
    if "frame" in clocks:
        frames = clocks["residual"] / clocks["frame"]
        lines.append(f"synchronisation: residual {clocks['residual']:.4f} s ({frames:.2f} frames)")
    return [*lines, *([clocks["refusal"]] if clocks.get("refusal") else []), *facts["warnings"]]


def _facts(calibration: Calibration, films: Sequence[Film]) -> JsonObject:
    """All figures as plain values; what is not finite is null."""
    cameras = []
    for found, film in zip(calibration.cameras, films, strict=True):
        support = {key: _finite(value) for key, value in asdict(found.support).items()}
        lens = {"focal": float(found.camera.intrinsics[0, 0]), "distortion": list(found.distortion)}
        clock = {"offset": film.offset, "rate": film.rate}
        cameras.append({"name": found.camera.name, **lens, **clock, **support})
    names = [found.camera.name for found in calibration.cameras]
    return {
        "kind": "standing cameras",
        "source": calibration.source,
        "cameras": cameras,
        "pairs": [
            {
                "cameras": [names[p.one], names[p.other]],
                "matches": p.matches,
                "verified": p.verified,
                "agreeing": p.agreeing,
            }
            for p in calibration.pairs
        ],
        "points": len(calibration.points),
        "own_focals": calibration.own_focals,
        "start": calibration.start,
        "costs": list(calibration.costs),
        "halves_apart": _finite(calibration.halves_apart),
        "warnings": list(calibration.warnings),
    }


def _page(calibration: Calibration, facts: JsonObject, views: Sequence[View], clocks: FoundClocks) -> str:
    names = [found.camera.name for found in calibration.cameras]
    places = [(float(found.camera.center[0]), float(found.camera.center[1])) for found in calibration.cameras]
    ahead = [(float(found.camera.forward[0]), float(found.camera.forward[1])) for found in calibration.cameras]
    sentence = f"{len(names)} standing cameras from {calibration.source}, {len(calibration.points)} points. "
    if math.isfinite(calibration.halves_apart):
        apart = f"{100 * calibration.halves_apart:.2f} % of the rig's size apart"
        sentence += f"Two halves of the points put the cameras {apart}. "
    sentence += "A low residual alone proves nothing."
    figures = [
        f"<figure>{camera_image(view.background, view.size, found.observations)}"
        f"<figcaption>{escape(view.name)}: observations that agree (green) and do not (red)</figcaption></figure>"
        for view, found in zip(views, calibration.cameras, strict=True)
    ]
    parts = [
        f"<p>{escape(sentence)}</p>",
        *_warnings(calibration.warnings),
        f"<h2>The rig from above</h2>{rig_from_above(names, places, ahead, calibration.points.tolist())}",
        f"<h2>Cameras</h2>{_table(facts['cameras'])}",
    ]
    if calibration.pairs:
        parts.append(f"<h2>Points that pairs of cameras share</h2>{matches_table(names, calibration.pairs)}")
    parts.append(f"<h2>Coverage</h2>{''.join(figures)}")
    if clocks.curves is not None:
        parts.append(f"<h2>Synchronisation</h2>{wide_image(clocks.curves)}")
    return _html(parts)


def _table(cameras: Sequence[JsonObject]) -> str:
    """A row for each camera."""
    columns: dict[str, Callable[[JsonObject], str]] = {
        "camera": lambda c: escape(c["name"]),
        "focal length (px)": lambda c: f"{c['focal']:.1f}",
        "known within": lambda c: _percent(c["focal_uncertainty"]),
        "k1, k2": lambda c: ", ".join(f"{k:.4f}" for k in c["distortion"]),
        "median residual (px)": lambda c: "" if c["residual"] is None else f"{c['residual']:.2f}",
        "points": lambda c: str(c["observations"]),
        "seen by two others": lambda c: str(c["shared_by_three"]),
        "agreeing": lambda c: _percent(c["share"]),
        "image covered": lambda c: _percent(c["coverage"]),
        "triangles that close": lambda c: _percent(c["closing"]),
        "offset (s)": lambda c: f"{c['offset']:.4f}",
    }
    head = "".join(f"<th>{escape(name)}</th>" for name in columns)
    rows = ("".join(f"<td>{column(camera)}</td>" for column in columns.values()) for camera in cameras)
    return f"<table><tr>{head}</tr>{''.join(f'<tr>{row}</tr>' for row in rows)}</table>"


def _warnings(warnings: Sequence[str]) -> list[str]:
    return [f"<p class='warning'>{escape(warning)}</p>" for warning in warnings]


def _html(parts: Sequence[str]) -> str:
    head = f"<meta charset='utf-8'><title>Calibration</title><style>{_STYLE}</style>"
    return f"<!doctype html><html><head>{head}</head><body><h1>Calibration</h1>{''.join(parts)}</body></html>"


def _center(pose: Sequence[Sequence[float]]) -> tuple[float, float, float]:
    """A camera's centre of its pose (3, 4), world to camera."""
    x, y, z = (-sum(pose[row][column] * pose[row][3] for row in range(3)) for column in range(3))
    return x, y, z


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _percent(share: float | None) -> str:
    return "" if share is None else f"{100 * share:.3g} %"
