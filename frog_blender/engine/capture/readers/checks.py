"""Checks that every reader makes on numbers from files, and the sentences they end in."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ...errors import found_instead
from ...regular_file import regular_file
from ..capture import Shot
from ..video import VideoFacts


def read_json(path: Path) -> dict[str, Any]:
    """A JSON object from a file.

    Raises:
        FrogError: if the file is missing, no JSON, or no object.
    """
    try:
        data = json.loads(regular_file(path, "a JSON file").read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise found_instead(path, f"a file that cannot be read ({error.strerror})", "a JSON file") from error
    except (ValueError, RecursionError) as error:
        reason = f"line {error.lineno}" if isinstance(error, json.JSONDecodeError) else type(error).__name__
        raise found_instead(path, f"text that is not JSON ({reason})", "a complete JSON file") from error
    if not isinstance(data, dict):
        raise found_instead(path, f"a JSON {type(data).__name__}", "a JSON object")
    return data


def numbers(value: Any, shape: tuple[int, ...], path: Path, what: str) -> np.ndarray:
    """``value`` as finite float64 numbers of the given shape.

    Raises:
        FrogError: if it is missing, has another shape or holds a value that is not finite.
    """
    try:
        array = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise found_instead(path, f"{what} that is not made of numbers", f"shape {shape}") from error
    if value is None or array.shape != shape:
        found = "nothing" if value is None else f"shape {array.shape}"
        raise found_instead(path, f"{found} as {what}", f"{' x '.join(map(str, shape)) or 'one'} number(s)")
    if not np.all(np.isfinite(array)):
        raise found_instead(path, f"{what} with a value that is not finite", "finite numbers")
    return array


def number(value: Any, path: Path, what: str, *, positive: bool = False) -> float:
    """``value`` as one finite number.

    Raises:
        FrogError: if it is none, or not positive where it must be.
    """
    result = float(numbers(value, (), path, what))
    if positive and result <= 0:
        raise found_instead(path, f"{what} = {result:g}", "a positive number")
    return result


def size(value: Any, path: Path, what: str) -> int:
    """``value`` as a picture's width or height in pixels.

    Raises:
        FrogError: if it is no number between 1 and 65536.
    """
    result = number(value, path, what)
    if not 1 <= result <= 65536:
        raise found_instead(path, f"{what} = {result:g}", "between 1 and 65536 pixels")
    return round(result)


def rotation(matrix: np.ndarray, path: Path, what: str) -> np.ndarray:
    """The rotation nearest to a (3, 3) matrix that is one up to rounding.

    Raises:
        FrogError: if the matrix mirrors, scales or shears.
    """
    left, _, right = np.linalg.svd(matrix)
    nearest = left @ right
    if np.abs(nearest - matrix).max() > 0.02 or np.linalg.det(nearest) < 0:
        raise found_instead(path, f"{what} that mirrors, scales or shears", "a rotation")
    return nearest


def pose(world_to_camera_rotation: np.ndarray, center: np.ndarray) -> np.ndarray:
    """(4, 4) world-to-camera matrix of a rotation (3, 3) and a camera centre (3,)."""
    matrix = np.eye(4)
    matrix[:3, :3] = world_to_camera_rotation
    matrix[:3, 3] = -world_to_camera_rotation @ center
    return matrix


def shared_moments(path: Path, videos: Sequence[Path], facts: Sequence[VideoFacts]) -> tuple[int, list[str]]:
    """How many moments synchronised videos share, and warnings where their lengths or rates differ.

    Raises:
        FrogError: if they share none.
    """
    counts = [fact.frame_count for fact in facts]
    shared = min(counts)
    if shared < 1:
        raise found_instead(videos[counts.index(shared)], "no frame", "videos that share at least one moment")
    warnings = []
    if shared != max(counts):
        shortest, longest = videos[counts.index(shared)].name, videos[counts.index(max(counts))].name
        warnings.append(
            f"{path}: the videos have different lengths ({shortest} {shared} frames, {longest} {max(counts)}); "
            f"the first {shared} moments are used."
        )
    rates = [fact.frames_per_second for fact in facts]
    if max(rates) > 1.02 * min(rates):
        warnings.append(f"{path}: the videos' frame rates differ ({min(rates):g} to {max(rates):g} a second).")
    return shared, warnings


def video_shots(videos: Sequence[Path], frame_count: int) -> tuple[Shot, ...]:
    """Every camera at every moment, camera i filmed by video i."""
    return tuple(Shot(c, f, video, f) for f in range(frame_count) for c, video in enumerate(videos))
