"""Which files and settings decide the pixels of a capture's frames, and in which order these are decoded; what a scene
is made of, by which it knows its capture."""

import hashlib
import json
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from ..errors import in_words
from ..io.plain_values import plain
from .capture import Capture
from .masking import MaskSource

_VERSION = 5  # raise it when the same capture would decode to other pixels

_SAMPLED, _SAMPLE = 256, 1 << 16  # files at most, and bytes of each, that are read to know files by their content
_DECIMALS = 8  # of calibrations: other processors round the last digits otherwise
_PARTS = {
    "images": "other images",
    "times": "other times of images",
    "calibration": "another calibration or image size",
    "masks": "other masks",
}
"""What decides a scene, and how it is called where it differs."""

Sources = dict[str, list[int]]
"""Size and modification time of each file of a capture, by its path."""


def _facts(path: Path) -> list[int]:
    """Size and modification time, which tell whether a file has changed. OSError if it cannot be read."""
    facts = path.stat()
    return [facts.st_size, facts.st_mtime_ns]


def sources_of(capture: Capture) -> Sources:
    """The capture's files and their facts; FrogError if one is missing."""
    sources = {}
    masks = {mask.path for shot in capture.shots for mask in (shot.mask, shot.ignore) if mask}
    for path in sorted({shot.path for shot in capture.shots} | masks):
        with in_words(f"{path}: found a file that cannot be read", ", expected a part of the capture."):
            sources[str(path.resolve())] = _facts(path)
    return sources


def decoding_key(capture: Capture, sources: Sources) -> str:
    """A hash of all that decides the decoded bytes: the files, cameras, lenses, which frames of what."""
    shots = [[s.camera, s.frame, str(s.path.resolve()), s.index] for s in capture.shots]
    decides = [_VERSION, sources, _lenses(capture), shots, capture.background]
    if capture.has_masks:
        decides += [str(capture.key), [[_mask_key(shot.mask), _mask_key(shot.ignore)] for shot in capture.shots]]
    if capture.alteration is not None:
        decides += [repr(capture.alteration), sorted(capture.test_cameras), sorted(capture.test_frames)]
    return _digest(decides)


def _lenses(capture: Capture) -> list[list[object]]:
    lenses = zip(capture.cameras, capture.distortions, strict=True)
    return [[camera.width, camera.height, camera.intrinsics.tolist(), plain(lens)] for camera, lens in lenses]


def _digest(values: object) -> str:
    return hashlib.sha256(json.dumps(values).encode()).hexdigest()[:32]


def _mask_key(mask: MaskSource | None) -> list[object]:
    return [] if mask is None else [str(mask.path.resolve()), mask.index, mask.is_alpha, mask.inverted]


def has_changed(sources: Sources) -> bool:
    """Whether a source file of a store has changed."""
    try:
        return any(_facts(Path(path)) != facts for path, facts in sources.items())
    except OSError:
        return True


def made_of(capture: Capture) -> dict[str, str]:
    """What a scene of a capture is made of: a hash of each of ``_PARTS``, the same for a copy that lies elsewhere.

    Files are known by size and content: samples of some hundred files, spread evenly. Call it before poses are refined.
    """
    shots, names = [capture.shots[index] for index in capture.decoding_order], [c.name for c in capture.cameras]
    masks = [mask for shot in shots for mask in (shot.mask, shot.ignore)]
    times = [[names[shot.camera], shot.frame, shot.index, shot.offset] for shot in shots]
    parts = {
        "images": _contents(shot.path for shot in shots),
        "times": [capture.frame_count, _rounded(times)],
        "calibration": _rounded([names, [c.world_to_camera.tolist() for c in capture.cameras], _lenses(capture)]),
        "masks": [str(capture.key), [_mask_key(m)[1:] for m in masks], _contents(m.path for m in masks if m)],
    }
    return {name: _digest(values)[:16] for name, values in parts.items()}


def found_otherwise(made: Mapping[str, object], capture: Capture) -> dict[str, str]:
    """The parts in which a capture is not what a scene was made of, and what they are called; {} where all are known to
    be the same, or nothing is known."""
    now = made_of(capture) if made else {}
    return {name: words for name, words in _PARTS.items() if name in made and made[name] != now[name]}


def _rounded(value: object) -> object:
    """Plain values, without the digits in which computers differ."""
    if isinstance(value, dict):
        return {name: _rounded(part) for name, part in value.items()}
    if isinstance(value, list | tuple):
        return [_rounded(part) for part in value]
    return round(value, _DECIMALS) + 0.0 if isinstance(value, float) else value  # + 0.0: no negative zeros


def _contents(paths: Iterable[Path]) -> list[list[object]]:
    """Size of each file, and a hash of the beginning, the middle and the end of some; [] for one that is not there."""
    files, contents = list(dict.fromkeys(paths)), list[list[object]]()
    for index, path in enumerate(files):
        contents.append([])
        with suppress(OSError):
            contents[-1] = [path.stat().st_size]
            if index % -(-len(files) // _SAMPLED) == 0:
                contents[-1].append(_sample(path))
    return contents


def _sample(path: Path) -> str:
    digest = hashlib.sha256()
    with path.open("rb") as file:
        size = file.seek(0, os.SEEK_END)
        for start in (0, size // 2, max(0, size - _SAMPLE)):
            file.seek(start)
            digest.update(file.read(_SAMPLE))
    return digest.hexdigest()[:32]
