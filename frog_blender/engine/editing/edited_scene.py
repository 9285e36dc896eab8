"""A scene with its edits applied: whoever plays, draws or exports it treats it as any other scene.

What is hidden for good is not played at all. What edits do to Gaussians that do not change in time is done once; to the
others, once a frame, in the columns that change.
"""

from __future__ import annotations

import threading
import uuid
from collections import OrderedDict
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..arrays import Array
from ..gaussians import GaussianArrays, NumpyGaussians
from ..playback.frame_delta import FrameDelta, column_of, put_columns
from ..playback.player import ScenePlayer
from .crops import Crop, kept_of_all
from .edits import Edits, Timing
from .grades import NOTHING, Grade, of_coefficients
from .marks import Marks


class RetimedScene:
    """A scene as a retiming shows it; its frames are those of the retiming, counted from 0."""

    def __init__(self, scene: ScenePlayer, timing: Timing) -> None:
        self.header, self.keeps_identity = scene.header, scene.keeps_identity
        self._scene, self._timing = scene, timing
        self._nothing = EditedScene(scene, Edits(grades=(NOTHING,)))

    def at_frame(self, frame: int) -> NumpyGaussians:
        """As many Gaussians in each frame, all of them transparent where nothing is shown."""
        shown = self._timing.frames[frame]
        return self._nothing.at_frame(0) if shown is None else self._scene.at_frame(shown)


@dataclass(frozen=True)
class _Graded:
    """A grade of some rows.

    Attributes:
        rows: (K,) ascending; None for all.
        matrix: (3, 3) see ``of_coefficients``; None where colours stay.
        base: (4, 4) the same of a column ``base``, opacities included; None where both stay.
        shift: (rows, 4) what is added to it.
        size: factor.
    """

    rows: Array | None
    matrix: Array | None
    base: Array | None
    shift: Array | None
    size: float

    def changed(self, name: str, column: Array) -> Array:
        """A column of the same rows as the grade leaves it; the column itself stays as it is."""
        matrix = self.base if name == "base" else self.matrix if name.startswith("sh_") else None
        if matrix is None and (name != "scales" or self.size == 1):
            return column
        part = column if self.rows is None else column[self.rows]
        new = part * np.float32(self.size) if matrix is None else part @ matrix
        if name == "base" and self.shift is not None:
            new += self.shift
            np.minimum(new[:, 3], 1, out=new[:, 3])
        if self.rows is None:
            return new
        whole = column.copy()
        whole[self.rows] = new
        return whole

    def first(self, count: int) -> _Graded:
        """Of the first ``count`` rows alone."""
        rows = None if self.rows is None else self.rows[self.rows < count]
        shift = None if self.shift is None else self.shift[: count if rows is None else len(rows)]
        return _Graded(rows, self.matrix, self.base, shift, self.size)


def _graded(grades: Iterable[Grade], scene: ScenePlayer) -> list[_Graded]:
    """The grades of a scene's rows, without those that change nothing."""
    graded = []
    for grade in grades:
        if grade.is_neutral:
            continue
        rows = None
        if grade.only is not None:
            rows = np.flatnonzero(_marked_rows(scene, grade.only))
        colors, offsets = grade.colors()
        matrix, shift = of_coefficients(colors, offsets)
        recolors = offsets.any() or not np.array_equal(colors, np.eye(3))
        base = shifts = None
        if recolors or grade.opacity != 1:
            base = np.eye(4, dtype=np.float32)
            base[:3, :3], base[3, 3] = matrix, grade.opacity
            length = scene.count if rows is None else len(rows)  # numpy adds one row to many slowly
            shifts = np.tile(np.append(shift, np.float32(0)), (length, 1))
        graded.append(_Graded(rows, matrix if recolors else None, base, shifts, grade.size))
    return graded


class EditedScene(ScenePlayer):
    """A scene as its edits leave it.

    Args:
        scene: a file's, or some of its Gaussians.
        edits: whose marks fit the scene, see ``Edits.fitted``.
        before: of any scene and edits: if it hides the same Gaussians of the same scene for good, they are not looked
            for again.
    """

    def __init__(self, scene: ScenePlayer, edits: Edits, before: EditedScene | None = None) -> None:
        self.edits = edits
        # Crops that move hide nothing for good, but one that keeps its inside may keep what others do not.
        moving_keeps = any(crop.keep_inside and not crop.is_still for crop in edits.crops)
        self._hiding = scene.token, edits.hidden, tuple(crop for crop in edits.crops if crop.is_still), moving_keeps
        is_as_before = before is not None and before._hiding == self._hiding
        source = before.source if before is not None and is_as_before else _without_hidden(scene, edits)
        self.source = source
        self.header, self.count, self.num_dynamic = source.header, source.count, source.num_dynamic
        self.sh_degree, self.columns = source.sh_degree, source.columns
        self.rows, self.file_count, self.identity = source.rows, source.file_count, source.identity
        self._arrays, self._deformation = source._arrays, source._deformation
        self.token = uuid.uuid4().hex
        self._recent: OrderedDict[float, NumpyGaussians] = OrderedDict()
        self._lock = threading.Lock()
        self._grades = _graded(edits.grades, source)
        self._moving_grades = [grade.first(source.num_dynamic) for grade in self._grades]
        # Crops by the place at the shown time, of Gaussians that go somewhere.
        self._follows = "means" in source.changing and any(crop.time is None for crop in edits.crops)
        changing = {*source.changing, "base"} if self._follows else set(source.changing)
        self.changing = tuple(name for name in self.columns if name in changing)

    def subset(self, kept: Array) -> EditedScene:
        """Some of the Gaussians that are left, with the same edits."""
        return EditedScene(self.source.subset(kept), self.edits)

    def delta_at(self, time: float) -> FrameDelta:
        return self.edited(self.source.delta_at(time))

    def edited(self, part: FrameDelta) -> FrameDelta:
        if not self.changing:
            return part
        count = self.num_dynamic
        columns = {}
        for name in self.changing:
            column = part.get(name)
            if column is None:  # opacities that crops alone change
                column = column_of(self.source._still, name, count)
            for grade in self._moving_grades:
                column = grade.changed(name, column)
            if name == "base" and self._fades:
                column = column.copy() if column is part.get(name) else column
                column[:, 3] *= self._kept_moving(part)
            columns[name] = column
        return columns

    def compute(self, time: float) -> NumpyGaussians:
        """As ``at``, but computed in any case; the arrays are not to be written."""
        return self._joined(self.delta_at(time))

    @cached_property
    def _still(self) -> NumpyGaussians:
        plain, changed = self.source._still, {}
        for name in self.columns if self._grades else ():
            column = graded = column_of(plain, name)
            for grade in self._grades:
                graded = grade.changed(name, graded)
            if graded is not column:
                changed[name] = graded
        arrays = plain.arrays | {"opacities": plain.opacities.copy()}
        if changed.keys() - {"scales"}:
            arrays["sh"] = plain.sh.copy()
        put_columns(arrays, changed, self.count)
        arrays["opacities"] *= self._kept
        return GaussianArrays.of(arrays).checked()

    @cached_property
    def _kept_by_crop(self) -> list[Array]:
        """(N,) of each crop: what it keeps at its chosen time; for those without, of Gaussians that stay, at any."""
        return [crop.kept(_places(self.source, crop)) for crop in self.edits.crops]

    @cached_property
    def _fades(self) -> bool:
        """Whether crops take something of the Gaussians that change."""
        return self._follows or bool((self._kept[: self.num_dynamic] != 1).any())

    @cached_property
    def _kept(self) -> Array:
        """(N,) what all crops keep; of Gaussians that move, at the beginning."""
        return self._without_marked(kept_of_all(self.edits.crops, self._kept_by_crop, self.count))

    @cached_property
    def _marked(self) -> Array | None:
        """(N,) bool, what marks hide though it is played: one Gaussian, if nothing else is left; None for nothing."""
        if self.edits.hidden is None:
            return None
        hidden = _marked_rows(self.source, self.edits.hidden)
        return hidden if hidden.any() else None

    def _without_marked(self, kept: Array) -> Array:
        """What is kept of the first Gaussians, and nothing of those that marks hide."""
        return kept if self._marked is None else np.where(self._marked[: len(kept)], np.float32(0), kept)

    def _kept_moving(self, part: FrameDelta) -> Array:
        """(M,) what crops keep of the Gaussians that move."""
        count = self.num_dynamic
        if not self._follows:
            return self._kept[:count]
        means = part["means"]
        kept = [
            crop.kept(means) if crop.time is None else known[:count]
            for crop, known in zip(self.edits.crops, self._kept_by_crop, strict=True)
        ]
        return self._without_marked(kept_of_all(self.edits.crops, kept, count))


def _places(scene: ScenePlayer, crop: Crop) -> Array:
    return scene.at(0.0 if crop.time is None else crop.time).means


def _marked_rows(scene: ScenePlayer, marks: Marks) -> Array:
    """(N,) bool, the rows of a scene that are marked."""
    marked = marks.chosen()
    return marked if scene.rows is None else marked[scene.rows]


def _without_hidden(scene: ScenePlayer, edits: Edits) -> ScenePlayer:
    """The scene without what nothing shows at any time; with one Gaussian, if nothing is left."""
    kept = np.ones(scene.count, bool)
    if edits.hidden is not None:
        kept &= ~_marked_rows(scene, edits.hidden)
    moves = scene.num_dynamic if "means" in scene.changing else 0
    for rows, crops in (
        (slice(moves, None), [crop for crop in edits.crops if crop.is_still]),
        (slice(0, moves), [crop for crop in edits.crops if crop.is_still and crop.time is not None]),
    ):
        inner = [crop for crop in crops if crop.keep_inside]
        if len(inner) < sum(crop.keep_inside for crop in edits.crops):  # another one may keep what these do not
            crops = [crop for crop in crops if not crop.keep_inside]
        if crops and kept[rows].size:
            shares = [crop.kept(_places(scene, crop)[rows]) for crop in crops]
            kept[rows] &= kept_of_all(tuple(crops), shares, kept[rows].size) > 0
    if kept.all():
        return scene
    return scene.subset(np.flatnonzero(kept) if kept.any() else np.zeros(1, np.int64))


def edited(scene: ScenePlayer, edits: Edits, before: EditedScene | None = None) -> tuple[ScenePlayer, list[str]]:
    """A scene with edits, and sentences about what of them does not fit it; the scene itself if they change nothing."""
    fitting, dropped = edits.fitted(scene)
    return (scene if fitting.are_none else EditedScene(scene, fitting, before)), dropped
