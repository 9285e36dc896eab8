"""Segments of a scene: parts of its frames, each with Gaussians and a network of its own beside those that all share.

The Gaussians of such a scene are, in this order, those that the segments' networks deform, segment by segment, those
that are there in one segment alone but do not change in it, segment by segment, and those of all segments.
"""

from __future__ import annotations

from bisect import bisect_right
from dataclasses import dataclass, replace
from itertools import accumulate

from ..arrays import Array
from ..gaussians import ArrayT
from ..io.plain_values import JsonMapping, JsonObject, UnfitValue, entries, items, whole

SEGMENTS = "segments"
"""The model setting that lists them; a scene without is one piece."""
FADE = 4.0
"""Frames on each side of a seam over which one segment becomes the other, if both were trained on so many."""
MOST_SEGMENTS = 10_000
_MOST = 2**31
_NUMBERS = ("first", "frames", "trained_first", "trained_frames", "deformed", "still")


@dataclass(frozen=True)
class Segment:
    """A part of a scene's frames.

    Attributes:
        first, frames: the frames that it plays.
        trained_first, trained_frames: the frames that it was trained on, which are these and some around them.
        deformed: Gaussians that its network moves.
        still: Gaussians that are there in this segment alone, and do not change in it.
        model: its network's settings; empty where nothing is deformed.
    """

    first: int
    frames: int
    trained_first: int
    trained_frames: int
    deformed: int
    still: int
    model: JsonMapping

    def time_of(self, frame: float) -> float:
        """The network's time in [0, 1] at a frame of the scene."""
        return min(max((frame - self.trained_first) / max(self.trained_frames - 1, 1), 0.0), 1.0)

    @property
    def table_rows(self) -> int:
        """Rows of the temporal table that are its own."""
        return int(self.model["temporal_rows"]) if self.model else 0

    def to_json(self) -> JsonObject:
        """Plain values for a header."""
        return {name: getattr(self, name) for name in _NUMBERS} | {"model": dict(self.model)}

    @classmethod
    def from_json(cls, value: object) -> Segment:
        """What ``to_json`` gave; UnfitValue for anything else."""
        found = entries(value, "a segment")
        numbers = {name: whole(found.get(name), f"{name} of a segment", 0, _MOST) for name in _NUMBERS}
        model = entries(found.get("model"), "model of a segment")
        if model:
            whole(model.get("temporal_rows"), "temporal_rows of a segment", 1, _MOST)
        elif numbers["deformed"]:
            raise UnfitValue(f"a segment of {numbers['deformed']} deformed Gaussians without a model", "a model")
        segment = cls(**numbers, model=model)
        before, played = segment.first - segment.trained_first, segment.frames
        if not (played and 0 <= before <= segment.trained_frames - played):
            trained = f"{segment.trained_first} to {segment.trained_first + segment.trained_frames - 1}"
            raise UnfitValue(
                f"a segment of frames {segment.first} to {segment.first + played - 1}, trained on {trained}",
                "frames that it was trained on",
            )
        return segment


def segments_of(model: JsonMapping) -> tuple[Segment, ...]:
    """The segments that a header's model lists, one after the other in time; none where it lists none.

    Raises:
        UnfitValue: a value is none, or frames are missing or come twice.
    """
    if SEGMENTS not in model:
        return ()
    segments = tuple(Segment.from_json(value) for value in items(model[SEGMENTS], SEGMENTS, MOST_SEGMENTS))
    end = 0
    for segment in segments:
        if segment.first != end:
            raise UnfitValue(f"a segment that begins at frame {segment.first}", f"one at frame {end}")
        end += segment.frames
    if not segments:
        raise UnfitValue("no segments", "at least one")
    return segments


def frames_of(segments: tuple[Segment, ...]) -> int:
    """Frames of all of them."""
    return segments[-1].first + segments[-1].frames


def seen_at(segments: tuple[Segment, ...], frame: float) -> dict[int, float]:
    """Numbers of the segments that are seen at a frame, and the share that each has in the image; together 1."""
    number = max(bisect_right(segments, frame, key=lambda segment: segment.first - 0.5) - 1, 0)
    seen = {number: 1.0}
    for earlier in (number - 1, number):
        if 0 <= earlier < len(segments) - 1:
            one, other = segments[earlier], segments[earlier + 1]
            seam, other_one = other.first - 0.5, earlier + 1 if earlier == number else earlier
            known = min(one.trained_first + one.trained_frames - 1 - seam, seam - other.trained_first)
            if abs(frame - seam) < min(FADE, known):
                seen[other_one] = 0.5 - 0.5 * abs(frame - seam) / min(FADE, known)
                seen[number] -= seen[other_one]
    return seen


def share_of(opacities: ArrayT, share: float) -> ArrayT:
    """The opacities of Gaussians with such a share in the image: what has one half in front of itself, with the other
    half, is as opaque as it is alone."""
    return opacities if share == 1 else 1 - (1 - opacities) ** share


@dataclass(frozen=True)
class SegmentRows:
    """Where a segment's own numbers lie in a scene's arrays: its Gaussians, and its part of the temporal table."""

    deformed: slice
    still: slice
    table: slice


def rows_of(segments: tuple[Segment, ...]) -> list[SegmentRows]:
    """Of each segment."""
    deformed = list(accumulate((segment.deformed for segment in segments), initial=0))
    still = list(accumulate((segment.still for segment in segments), initial=deformed[-1]))
    table = list(accumulate((segment.table_rows for segment in segments), initial=0))
    return [
        SegmentRows(*(slice(ends[k], ends[k + 1]) for ends in (deformed, still, table))) for k in range(len(segments))
    ]


def selected(segments: tuple[Segment, ...], kept: Array) -> list[Segment]:
    """The segments of a scene of some of the Gaussians, (M,) indices."""

    def number(rows: slice) -> int:
        return int(((kept >= rows.start) & (kept < rows.stop)).sum())

    of_each = zip(segments, rows_of(segments), strict=True)
    return [replace(each, deformed=number(rows.deformed), still=number(rows.still)) for each, rows in of_each]


def network_prefix(number: int) -> str:
    """What the names of a segment's network begin with."""
    return f"network.{number}."
