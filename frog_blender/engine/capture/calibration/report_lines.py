"""What ``calibration_report.json`` says, in lines for a terminal."""

from __future__ import annotations

import numpy as np

from ...errors import FrogError
from ...io.plain_values import JsonObject, UnfitValue, entries, items, number, text
from ..capture import Capture
from ..readers.checks import read_json
from .report import REPORT

_SHOWN = 16  # cameras, a line each
_SAME = 1e-3  # of a focal length: two calibrations seldom agree so well in every camera
_MOST = 1e12
_MOST_CAMERAS, _MOST_WARNINGS = 10_000, 1000
_SENTENCE = 10_000


def report_lines(capture: Capture) -> list[str]:
    """What the report beside a capture's cameras says; empty without one, one sentence for one that cannot be read."""
    path = capture.path / REPORT
    if not path.is_file():
        return []
    try:
        facts = read_json(path)
        cameras = [entries(each, "a camera") for each in items(facts.get("cameras", []), "cameras", _MOST_CAMERAS)]
        return [
            *_differing(cameras, capture),
            _overview(facts, cameras),
            *_of_cameras(cameras),
            *_synchronization(facts),
            *(
                text(warning, "a warning", _SENTENCE)
                for warning in items(facts.get("warnings"), "warnings", _MOST_WARNINGS)
            ),
        ]
    except FrogError as error:
        return [str(error)]
    except UnfitValue as error:
        return [f"{path}: found {error.found}, expected {error.expected}."]


def _differing(cameras: list[JsonObject], capture: Capture) -> list[str]:
    """A sentence where the report is of other cameras: a calibration that was given stays beside what was found."""
    if not cameras:
        return []
    used = {camera.name: float(camera.intrinsics[0, 0]) for camera in capture.cameras}
    found = {_name(each): _positive(each.get("focal"), "a focal length") for each in cameras}
    if found.keys() == used.keys() and all(abs(found[name] - used[name]) <= _SAME * used[name] for name in used):
        return []
    return ["This report is of another calibration than the one in use."]


def _overview(facts: JsonObject, cameras: list[JsonObject]) -> str:
    kind = text(facts.get("kind"), "a kind of calibration", 100)
    counted = f"{len(cameras)} {kind}" if cameras else kind
    if "source" in facts:
        counted += f" from {text(facts['source'], 'a source', 100)}"
    parts = [counted]
    if "images" in facts:
        parts.append(f"{number(facts['images'], 'images', 0, _MOST):.0f} images")
    if "points" in facts:
        parts.append(f"{number(facts['points'], 'points', 0, _MOST):.0f} points")
    if facts.get("residual") is not None:
        parts.append(f"median residual {_positive(facts['residual'], 'a residual'):.2f} px")
    if facts.get("halves_apart") is not None:
        share = 100 * _positive(facts["halves_apart"], "how far halves lie apart")
        parts.append(f"two halves of what was seen put the cameras {share:.2g} % of their extent apart")
    return ", ".join(parts)


def _of_cameras(cameras: list[JsonObject]) -> list[str]:
    """A line for each camera, or one for many."""
    residuals = {_name(each): _residual(each) for each in cameras}
    if len(cameras) > _SHOWN:
        known = {name: value for name, value in residuals.items() if value is not None}
        if not known:
            return []
        worst = max(known, key=known.__getitem__)
        usual = float(np.median(list(known.values())))
        return [f"median residual {usual:.2f} px, at most {known[worst]:.2f} ({worst})"]
    lines = []
    for each in cameras:
        focal = f"focal length {_positive(each.get('focal'), 'a focal length'):.1f} px"
        if each.get("focal_uncertainty") is not None:
            within = 100 * _positive(each["focal_uncertainty"], "the uncertainty of a focal length")
            focal += f" within {within:.2g} %"
        residual = residuals[_name(each)]
        told = "no residual" if residual is None else f"median residual {residual:.2f} px"
        lines.append(f"{_name(each)}: {told}, {focal}")
    return lines


def _synchronization(facts: JsonObject) -> list[str]:
    if facts.get("synchronization") is None:
        return []
    found = entries(facts["synchronization"], "a synchronisation")
    frame = number(found.get("frame"), "the frame interval", 1e-6, 1e4)
    residual = _positive(found.get("residual"), "the residual")
    lines = [f"synchronisation: residual {residual:.4f} s ({residual / frame:.2f} frames)"]
    if found.get("refusal") is not None:
        lines.append(text(found["refusal"], "the refusal", _SENTENCE))
    return lines


def _name(camera: JsonObject) -> str:
    return text(camera.get("name"), "a camera's name", 1000)


def _residual(camera: JsonObject) -> float | None:
    value = camera.get("residual")
    return None if value is None else _positive(value, "a residual")


def _positive(value: object, what: str) -> float:
    return number(value, what, 0, _MOST)
