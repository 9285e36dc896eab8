"""Captures of a paper's dataset as the paper evaluates on them, and averages as the paper takes them.

``protocol_scenes`` has the protocols as data.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

from ..engine import Capture, FrogError, checked, layout_of, open_capture
from ..engine.registry import READERS
from .protocol_scenes import PROTOCOLS, Part, Protocol, Scene
from .published import markdown

__all__ = [
    "COSTS",
    "PROTOCOLS",
    "Part",
    "Protocol",
    "Scene",
    "averages",
    "captures",
    "find_scenes",
    "protocol_named",
    "published_table",
]

_DEPTH = 3  # folders below the given one in which a scene is looked for
_LOST_AT_THE_END = 2  # frames that decoders lose
COSTS = frozenset({"bytes", "gaussians", "train_seconds", "fps", "deform_ms", "raster_ms"})
"""Figures that are averaged over ``Protocol.cost_scenes`` alone."""


def protocol_named(name: str) -> Protocol:
    """The protocol of that name; FrogError if there is none."""
    if name not in PROTOCOLS:
        raise FrogError(f"There is no protocol {name!r}; there are {', '.join(PROTOCOLS)}.")
    return PROTOCOLS[name]


def captures(
    protocol: Protocol | str, directory: Path, names: Collection[str] | None = None
) -> list[tuple[str, Capture]]:
    """The protocol's captures by name, with its image size and held-out images, in the order of its tables.

    They have the size at which the paper evaluates. Train on them with an image scale of 1.

    Args:
        directory: the folder that holds the scenes, up to three levels deep.
        names: which of ``Protocol.parts``; by default all.

    Raises:
        FrogError: if a scene is missing or lacks frames, or cannot be used.
    """
    protocol = protocol_named(protocol) if isinstance(protocol, str) else protocol
    names = protocol.parts if names is None else names
    if unknown := set(names) - set(protocol.parts):
        raise FrogError(
            f"The protocol {protocol.name} has no {', '.join(sorted(unknown))}; it has {', '.join(protocol.parts)}."
        )
    wanted = [scene for scene in protocol.scenes if any(part.name in names for part in scene.parts)]
    folders = find_scenes(protocol, Path(directory), wanted)
    opened = []
    for scene, folder in zip(wanted, folders, strict=True):
        parts = [part for part in scene.parts if part.name in names]
        opened += [(part.name, _at_size(capture, protocol)) for part, capture in _open(scene, parts, folder)]
    return opened


def find_scenes(protocol: Protocol, directory: Path, scenes: Collection[Scene]) -> list[Path]:
    """The folders of some scenes, the topmost of those that match; FrogError that names the missing ones."""
    if not directory.is_dir():
        raise FrogError(f"{directory}: there is no such folder, expected the scenes of {protocol.title}.")
    known: dict[str, list[Path]] = {}
    for folder in _folders(directory):
        known.setdefault(_plain(folder.name), []).append(folder)
    found: list[Path] = []
    missing: list[str] = []
    for scene in scenes:
        candidates = [folder for name in scene.folders for folder in known.get(_plain(name), [])]
        fitting = [folder for folder in candidates if _is_format(folder, protocol.format)]
        found += fitting[:1]
        if not fitting:
            missing.append(" or ".join(scene.folders) + (f" (not in {candidates[0]})" if candidates else ""))
    if missing:
        raise FrogError(
            f"{directory}: found no folder in the {protocol.format} layout for {', '.join(missing)}, "
            f"expected each scene of the protocol {protocol.name} in a folder of its name."
        )
    return found


def averages(protocol: Protocol, figures: Mapping[str, Mapping[str, float | None]]) -> dict[str, float]:
    """Means as the paper takes them: quality over all captures alike, costs over ``cost_scenes``.

    (N3DV's four segments of flame_salmon count as four, which is why its averages lie near 31 dB and those of papers
    that take its first 300 frames near 32.)

    Args:
        figures: by capture, by figure; see ``COSTS`` for those that count as costs.

    Returns:
        Only the figures that every capture which counts for them has: an average over some is not the paper's.
    """
    names = sorted({name for values in figures.values() for name in values})
    result = {}
    for name in names:
        over = (protocol.cost_scenes or protocol.parts) if name in COSTS else protocol.parts
        values = [figures.get(part, {}).get(name) for part in over]
        known = [value for value in values if value is not None]
        if len(known) == len(values):
            result[name] = sum(known) / len(known)
    return result


def published_table(protocol: Protocol) -> str:
    """The paper's tables as Markdown, to be shown beside ours."""
    over = ", ".join(protocol.parts)
    held_out = f"{protocol.title}, the mean of {over}; held out: {protocol.held_out}."
    parts = [f"FRoG's paper on {held_out}" if protocol.table else held_out]
    if protocol.cost_scenes:
        parts.append(f"Storage, training time and FPS are of {', '.join(protocol.cost_scenes)} in the first table.")
    if protocol.table:
        parts.append(markdown(protocol.table))
    for name, rows in protocol.ablations.items():
        parts += [f"Its ablation ({name}):", markdown(rows)]
    if protocol.elsewhere:
        parts += ["What other papers report, under protocols of their own:", markdown(protocol.elsewhere)]
    return "\n\n".join(parts)


def _open(scene: Scene, parts: list[Part], folder: Path) -> Iterator[tuple[Part, Capture]]:
    """The parts of a scene, without the cameras that the protocol leaves out."""
    if layout_of(folder) == "technicolor":
        for part in parts:
            frames = range(part.first, part.first + part.count) if part.count else None
            yield part, checked(READERS["technicolor"].read(folder, frames))
        return
    capture = open_capture(folder)
    capture = capture.without_cameras({camera.name for camera in capture.cameras if _is_without(scene, camera.name)})
    for part in parts:
        yield part, _segment(capture, part) if part.count else capture


def _is_without(scene: Scene, name: str) -> bool:
    return name in scene.without or f"{name.partition('/')[0]}/" in scene.without


def _segment(capture: Capture, part: Part) -> Capture:
    """A part's frames; a warning if the last one or two are missing, FrogError if more are."""
    assert part.count is not None
    there = min(part.count, capture.frame_count - part.first)
    if there < part.count - _LOST_AT_THE_END or there < 1:
        raise FrogError(
            f"{capture.path}: found {capture.frame_count} frames, expected {part.first + part.count} of which "
            f"{part.name} is frames {part.first} to {part.first + part.count - 1}."
        )
    segment = capture.segment(part.first, there)
    if there == part.count:
        return segment
    sentence = f"{capture.path}: {part.name} has {there} of its {part.count} frames."
    return replace(segment, warnings=(*segment.warnings, sentence))


def _at_size(capture: Capture, protocol: Protocol) -> Capture:
    """The capture at the protocol's image size; smaller images stay as they are, with a warning."""
    width = max(camera.width for camera in capture.cameras)
    if width < protocol.image_width:
        sentence = (
            f"{capture.path}: images are {width} pixels wide, expected {protocol.image_width}: "
            f"figures cannot be compared with those of {protocol.title}."
        )
        return replace(capture, warnings=(*capture.warnings, sentence))
    return capture.scaled(protocol.image_width / width)


def _folders(directory: Path, depth: int = _DEPTH) -> Iterator[Path]:
    """The folders below one, level by level, in the order of their names."""
    level = [directory]
    for _ in range(depth):
        level = sorted(entry for folder in level for entry in folder.iterdir() if entry.is_dir())
        yield from level


def _plain(name: str) -> str:
    """A folder's name without case, punctuation and "vrig", which differ between downloads."""
    return re.sub(r"[\W_]+", "", name.lower()).removeprefix("vrig")


def _is_format(folder: Path, layout: str) -> bool:
    try:
        return layout_of(folder) == layout
    except FrogError:
        return False
