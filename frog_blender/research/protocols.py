"""Captures of a paper's dataset as the paper evaluates on them, and averages as the paper takes them.

``PROTOCOLS`` has the protocols as data: FRoG's (arXiv 2603.20857, datasets and tables), which follow E-D3DGS
(JeongminB/E-D3DGS, README and script).
"""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ..engine import Capture, CaptureRefused, FrogError, UsageError, layout_of, named, open_capture, told_as

_DEPTH = 3  # folders below the given one in which a scene is looked for
_LOST_AT_THE_END = 2  # frames that decoders lose
COSTS = frozenset({"bytes", "gaussians", "train_seconds", "fps"})
"""Figures that are averaged over ``Protocol.cost_scenes`` alone."""


@dataclass(frozen=True)
class Part:
    """Consecutive frames of a scene of a dataset, which are a capture.

    Attributes:
        name: in tables.
        folders: names that the scene's folder may have; letter case, punctuation and a leading "vrig" do not count.
        first: the first frame: of the video from 0; for Technicolor the number in the images' names.
        count: frames; None for all.
        without: a camera that is left out of training and evaluation; a name that ends with / stands for all of a
            folder.
    """

    name: str
    folders: tuple[str, ...]
    first: int = 0
    count: int | None = None
    without: str = ""


@dataclass(frozen=True)
class Protocol:
    """A paper's evaluation.

    Attributes:
        name, title: for commands and for people.
        format: of its captures, see ``readers.detect``.
        recipe: the recipe that follows the paper's settings.
        parts: its captures, in the order of tables; an average weighs each of them alike.
        image_width: pixels that images are reduced to.
        held_out: what is held out, in words.
        cost_scenes: captures on which storage, time and FPS are measured; all where empty.
    """

    name: str
    title: str
    format: str
    recipe: str
    parts: tuple[Part, ...]
    image_width: int
    held_out: str
    cost_scenes: tuple[str, ...] = ()

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(part.name for part in self.parts)

    def of(self, names: Collection[str]) -> Protocol:
        """With some of its captures alone."""
        costs = tuple(name for name in self.cost_scenes if name in names)
        return replace(self, parts=tuple(part for part in self.parts if part.name in names), cost_scenes=costs)


def _n3dv(name: str, without: str = "") -> Part:
    return Part(name, (name,), 0, 300, without)


_SALMON = ("flame_salmon_1", "flame_salmon")
N3DV = Protocol(
    "n3dv",
    "N3DV (Neural 3D Video)",
    format="n3dv",
    recipe="paper-exact",
    parts=(
        # Its camera 13 (the thirteenth by name) runs out of step with the others: Neural_3D_Video issue 5.
        _n3dv("coffee_martini", "cam13"),
        _n3dv("cook_spinach"),
        _n3dv("cut_roasted_beef"),
        *(Part(f"flame_salmon_frag{i + 1}", _SALMON, 300 * i, 300) for i in range(4)),
        _n3dv("flame_steak"),
        _n3dv("sear_steak"),
    ),
    image_width=1352,
    held_out="the first camera (cam00)",
    cost_scenes=("flame_salmon_frag1",),
)
HYPERNERF = Protocol(
    "hypernerf",
    "HyperNeRF (vrig)",
    format="hypernerf",
    recipe="hypernerf-exact",
    parts=(
        Part("3dprinter", ("vrig-3dprinter",)),
        Part("peel-banana", ("vrig-peel-banana", "banana")),
        Part("broom", ("broom2", "vrig-broom")),
        Part("chicken", ("vrig-chicken",)),
    ),
    image_width=536,  # rgb/2x
    held_out="the rig's other camera at every frame (val_ids)",
)
TECHNICOLOR = Protocol(
    "technicolor",
    "Technicolor light field",
    format="technicolor",
    recipe="technicolor-exact",
    parts=(
        Part("Birthday", ("Birthday",), 151, 50),
        Part("Fabien", ("Fabien",), 51, 50),
        Part("Painter", ("Painter",), 100, 50),
        Part("Theater", ("Theater", "Theatre"), 51, 50),
        Part("Train", ("Train", "Trains"), 151, 50),
    ),
    image_width=2048,
    # FRoG writes "second row, second column"; it counts from 0, as every implementation does.
    held_out="row 2, column 2 of the grid, counted from 0 (cam10)",
)
DNERF = Protocol(
    "dnerf",
    "D-NeRF",
    format="transforms",
    recipe="standard",
    # Lego's test images show another shovel than its training images (Deformable-3DGS, README).
    parts=tuple(
        Part(name, (name, f"dnerf_{name}"), without="test/" if name == "lego" else "val/")
        for name in ("hellwarrior", "mutant", "hook", "bouncingballs", "lego", "trex", "standup", "jumpingjacks")
    ),
    image_width=800,
    held_out="the test split, of lego the validation split",
)
PROTOCOLS: dict[str, Protocol] = {protocol.name: protocol for protocol in (N3DV, HYPERNERF, TECHNICOLOR, DNERF)}


@told_as(CaptureRefused)
def captures(
    protocol: Protocol | str, directory: Path, names: Collection[str] | None = None
) -> list[tuple[str, Capture]]:
    """The protocol's captures by name, with its image size and held-out images, in the order of its tables.

    They have the size at which the paper evaluates. Train on them with an image scale of 1.

    Args:
        directory: the folder that holds the scenes, up to three levels deep.
        names: which of ``Protocol.parts``; by default those that are there.

    Raises:
        FrogError: if no scene is there, or one that is named is not; if one lacks frames, or cannot be used.
    """
    protocol = named("protocol", protocol, PROTOCOLS) if isinstance(protocol, str) else protocol
    if unknown := set(names or ()) - set(protocol.names):
        raise UsageError(
            f"The protocol {protocol.name} has no {', '.join(sorted(unknown))}; it has {', '.join(protocol.names)}."
        )
    parts = protocol.parts if names is None else protocol.of(names).parts
    folders, missing = _find(protocol, Path(directory), parts)
    if missing and (names is not None or not folders):
        raise FrogError(
            f"{directory}: found no folder in the {protocol.format} layout for {', '.join(missing)}, "
            f"expected each scene of the protocol {protocol.name} in a folder of its name."
        )
    there = [(part, folders[part.folders]) for part in parts if part.folders in folders]
    return [(part.name, _at_size(_open(part, folder), protocol)) for part, folder in there]


def left_out(name: str, used: Protocol) -> str:
    """What is to be said of a protocol of which some captures are not used; "" where all are."""
    missing = [scene for scene in PROTOCOLS[name].names if scene not in used.names]
    if not missing:
        return ""
    return (
        f"{len(used.parts)} of the {len(PROTOCOLS[name].parts)} captures of {name}, without {', '.join(missing)}: "
        "means are of these alone, and not the paper's."
    )


def _find(
    protocol: Protocol, directory: Path, parts: Collection[Part]
) -> tuple[dict[tuple[str, ...], Path], list[str]]:
    """The folders of some captures, the topmost of those that match; and what the missing ones would be called."""
    if not directory.is_dir():
        raise FrogError(f"{directory}: there is no such folder, expected the scenes of {protocol.title}.")
    known: dict[str, list[Path]] = {}
    level = [directory]
    for _ in range(_DEPTH):
        level = sorted(entry for folder in level for entry in folder.iterdir() if entry.is_dir())
        for folder in level:
            known.setdefault(_plain(folder.name), []).append(folder)
    folders: dict[tuple[str, ...], Path] = {}
    missing: list[str] = []
    for names in dict.fromkeys(part.folders for part in parts):
        candidates = [folder for name in names for folder in known.get(_plain(name), [])]
        fitting = next((folder for folder in candidates if layout_of(folder) == protocol.format), None)
        if fitting is not None:
            folders[names] = fitting
        else:
            missing.append(" or ".join(names) + (f" (not in {candidates[0]})" if candidates else ""))
    return folders, missing


def averages(protocol: Protocol | None, figures: Mapping[str, Mapping[str, float | None]]) -> dict[str, float]:
    """Means as the paper takes them: quality over all captures alike, costs over ``cost_scenes``.

    (N3DV's four segments of flame_salmon count as four, which is why its averages lie near 31 dB and those of papers
    that take its first 300 frames near 32.)

    Args:
        protocol: None for a mean over all that are given.
        figures: by capture, by figure; see ``COSTS`` for those that count as costs.

    Returns:
        Only the figures that every capture which counts for them has: an average over some is not the paper's.
    """
    result = {}
    for name in {name for values in figures.values() for name in values}:
        captures: Collection[str] = protocol.names if protocol else figures
        if protocol and protocol.cost_scenes and name in COSTS:
            captures = protocol.cost_scenes
        values = [figures.get(capture, {}).get(name) for capture in captures]
        known = [value for value in values if value is not None]
        if len(known) == len(values):
            result[name] = sum(known) / len(known)
    return result


def published_table(protocol: Protocol) -> str:
    """The papers' own tables as Markdown, to be shown beside ours. They were measured on the papers' machines; sizes
    are in 10^6 bytes where a paper does not say."""
    tables = (Path(__file__).with_name("published") / f"{protocol.name}.md").read_text(encoding="utf-8")
    head = f"{protocol.title}, the mean of {', '.join(protocol.names)}; held out: {protocol.held_out}."
    return f"{head}\n\n{tables.rstrip()}"


def _open(part: Part, folder: Path) -> Capture:
    """A part of a scene, without what the protocol leaves out; a warning if its last one or two frames are missing,
    FrogError if more are."""
    capture, first = open_capture(folder), part.first
    if capture.format == "technicolor":  # whose parts are named by the numbers in the images' names
        first -= min(int(shot.path.stem.split("_")[-2]) for shot in capture.shots)
    if part.without:
        is_folder = part.without.endswith("/")
        names = [camera.name for camera in capture.cameras]
        out = [name for name in names if name == part.without or (is_folder and name.startswith(part.without))]
        capture = capture.without_cameras(out)
    if not part.count:
        return capture
    there = min(part.count, capture.frame_count - first)
    if first < 0 or there < part.count - _LOST_AT_THE_END or there < 1:
        raise FrogError(
            f"{capture.path}: found {capture.frame_count} frames, expected {part.first + part.count} of which "
            f"{part.name} is frames {part.first} to {part.first + part.count - 1}."
        )
    segment = capture.segment(first, there)
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


def _plain(name: str) -> str:
    """A folder's name without case, punctuation and "vrig", which differ between downloads."""
    return re.sub(r"[\W_]+", "", name.lower()).removeprefix("vrig")
