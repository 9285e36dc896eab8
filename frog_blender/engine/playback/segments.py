"""A scene of segments at playback: the Gaussians of the segment that plays are deformed, those of others are unseen.

Each segment has been trained on some frames of its neighbours, so that two of them know a seam. Around it both are
seen (``seen_at``).
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ..arrays import Array, SceneArrays
from ..capture.time import time_to_frame
from ..errors import FrogError, brief
from ..gaussians import GaussianArrays, NumpyGaussians
from ..io.plain_values import JsonMapping
from ..scene.segment_parts import own_arrays
from ..scene.segments import SEGMENTS, SegmentRows, frames_of, rows_of, seen_at, segments_of, share_of
from .buffer_pool import BufferPool
from .canonical import canonical_gaussians
from .deformation import DeformationPlayer
from .frame_delta import FrameDelta, extract_columns

_NOBODY = -1
_AT_ONCE = 3  # segments that are seen at a time, at most


class SegmentedPlayer:
    """Plays a scene of segments; see ``Deformation``.

    Args:
        arrays: the scene file's arrays.
        model: the scene header's model settings.

    Attributes:
        num_dynamic: Gaussians that are not there in all segments, which come first.
        changing: the columns (see frame_delta) that change in time.

    Raises:
        FrogError: the arrays are not what the settings say.
    """

    def __init__(self, arrays: SceneArrays, model: JsonMapping) -> None:
        try:
            self._segments = segments_of(model)
            self._rows = rows_of(self._segments)
            self._check(arrays)
            self._players = [
                DeformationPlayer(own_arrays(arrays, self._segments, number), segment.model)
                if segment.deformed
                else None
                for number, segment in enumerate(self._segments)
            ]
        except (KeyError, ValueError, TypeError, OverflowError) as error:
            raise FrogError(f"The scene's segments cannot be used ({brief(error)}); train it again.") from error
        self.num_dynamic = self._rows[-1].still.stop
        self._frame_count = frames_of(self._segments)
        self.changing = frozenset({"base"} if self.num_dynamic else ())
        self.changing = self.changing.union(*(player.changing for player in self._players if player is not None))
        self._still = canonical_gaussians(arrays).checked()
        unseen = self._still.opacities.copy()
        unseen[: self.num_dynamic] = 0
        recolors = any(name == "base" or name.startswith("sh_") for name in self.changing)
        kept = {name: value for name, value in vars(self._still).items() if name != "sh" or recolors}
        # Beside a frame's arrays, which segments wrote them last: their Gaussians become as they were.
        nobody = np.full(_AT_ONCE, _NOBODY, np.float32)
        self._memory = BufferPool({**kept, "opacities": unseen, "writers": nobody})

    def _check(self, arrays: SceneArrays) -> None:
        """ValueError for numbers of rows that are not the segments'."""
        last = self._rows[-1]
        count, deformed = len(arrays["means"]), len(arrays.get("embeddings", ()))
        table = len(arrays.get("temporal_table", ()))
        if last.still.stop > count:
            raise ValueError(f"{last.still.stop} of its {count} Gaussians are the segments'")
        if last.deformed.stop != deformed or last.table.stop > table:
            found = f"{deformed} embeddings and {table} rows of the temporal table"
            raise ValueError(f"{found}, expected {last.deformed.stop} and {last.table.stop}")

    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated, with unit quaternions; the arrays are not to be changed."""
        place = time_to_frame(time, self._frame_count)
        seen, frame = seen_at(self._segments, place), self._memory.take()
        writers = frame.pop("writers")
        for writer in writers.astype(int).tolist():
            if writer != _NOBODY and writer not in seen:
                self._clear(frame, self._rows[writer])
        writers[:] = [*seen, *[_NOBODY] * (_AT_ONCE - len(seen))]
        for number, share in seen.items():
            self._show(frame, number, place, share)
        return GaussianArrays(**({"sh": self._still.sh} | frame))

    def delta_at(self, time: float, names: Collection[str]) -> FrameDelta:
        """Columns of the Gaussians that are not there in all segments, at a time in [0, 1]: the same bits as in
        ``at``."""
        return extract_columns(self.at(time), names, self.num_dynamic)

    def _show(self, frame: dict[str, Array], number: int, place: float, share: float) -> None:
        """Writes a segment's Gaussians, with such a share in the image."""
        rows, player = self._rows[number], self._players[number]
        opacities = frame["opacities"]
        opacities[rows.still] = share_of(self._still.opacities[rows.still], share)
        if player is not None:
            part = {name: array[rows.deformed] for name, array in frame.items()}
            player.fill(self._segments[number].time_of(place), part)
            opacities[rows.deformed] = share_of(opacities[rows.deformed], share)

    def _clear(self, frame: dict[str, Array], rows: SegmentRows) -> None:
        """Makes a segment's Gaussians canonical and unseen."""
        for name, array in frame.items():
            array[rows.deformed] = 0 if name == "opacities" else getattr(self._still, name)[rows.deformed]
        frame["opacities"][rows.still] = 0


def field_player(arrays: SceneArrays, model: JsonMapping) -> DeformationPlayer | SegmentedPlayer:
    """What plays a scene with deformation networks; FrogError where it cannot be used."""
    return SegmentedPlayer(arrays, model) if SEGMENTS in model else DeformationPlayer(arrays, model)
