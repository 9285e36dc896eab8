"""Which files and settings decide the pixels of a capture's frames, and in which order these are decoded."""

from __future__ import annotations

import hashlib
import json
from pathlib import Path

from ..errors import FrogError
from ..io.plain_values import plain
from .capture import Capture
from .masking import MaskSource

_VERSION = 4  # raise it when the same capture would decode to other pixels

Sources = dict[str, list[int]]
"""Size and modification time of each file of a capture, by its path."""


def shapes_of(capture: Capture) -> list[tuple[int, int]]:
    """(H, W) of each shot."""
    sizes = [(camera.height, camera.width) for camera in capture.cameras]
    return [sizes[shot.camera] for shot in capture.shots]


def bytes_of(shape: tuple[int, int]) -> int:
    return shape[0] * shape[1] * 3


def decoding_order(capture: Capture) -> list[int]:
    """Indices of the shots, one file after the other, in ascending frames."""
    shots = capture.shots
    return sorted(
        range(len(shots)), key=lambda index: (shots[index].camera, str(shots[index].path), shots[index].index)
    )


def _facts(path: Path) -> list[int]:
    """Size and modification time, which tell whether a file has changed. OSError if it cannot be read."""
    facts = path.stat()
    return [facts.st_size, facts.st_mtime_ns]


def sources_of(capture: Capture) -> Sources:
    """The capture's files and their facts."""
    sources = {}
    masks = {mask.path for shot in capture.shots for mask in (shot.mask, shot.ignore) if mask}
    for path in sorted({shot.path for shot in capture.shots} | masks):
        try:
            sources[str(path.resolve())] = _facts(path)
        except OSError as error:
            raise FrogError(
                f"{path}: the file cannot be read ({error.strerror}), expected a part of the capture."
            ) from error
    return sources


def decoding_key(capture: Capture) -> str:
    """A hash of all that decides the decoded bytes: the files as they are now, cameras, lenses, which frames of what.

    Raises:
        FrogError: if a file of the capture is missing.
    """
    return key_of(capture, sources_of(capture))


def key_of(capture: Capture, sources: Sources) -> str:
    cameras = [
        [c.width, c.height, c.intrinsics.tolist(), plain(d), crop]
        for c, d, crop in zip(capture.cameras, capture.distortions, capture.crops, strict=True)
    ]
    shots = [[s.camera, s.frame, str(s.path.resolve()), s.index] for s in capture.shots]
    decides = [_VERSION, sources, cameras, shots, capture.background]
    if capture.has_masks:
        decides += [str(capture.key), [[_mask_key(shot.mask), _mask_key(shot.ignore)] for shot in capture.shots]]
    if capture.alteration is not None:
        decides += [capture.alteration.key, sorted(capture.test_cameras), sorted(capture.test_frames)]
    return hashlib.sha256(json.dumps(decides).encode()).hexdigest()[:32]


def _mask_key(mask: MaskSource | None) -> list[object]:
    return [] if mask is None else [str(mask.path.resolve()), mask.index, mask.is_alpha, mask.inverted]


def has_changed(sources: Sources) -> bool:
    """Whether a source file of a store has changed."""
    try:
        return any(_facts(Path(path)) != facts for path, facts in sources.items())
    except OSError:
        return True
