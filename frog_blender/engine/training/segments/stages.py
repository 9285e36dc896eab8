"""The trainings that a take in segments is made of: one of the whole, at fewer moments, and one of each segment.

What does not move is learned by the first from moments of the whole take. The segments' trainings draw with it as it
is, so that it is the same on both sides of a seam. They do not depend on each other.
"""

from __future__ import annotations

from .. import passive_threads  # noqa: F401

# isort: split
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from ...arrays import SceneArrays
from ...capture.capture import Capture
from ...errors import FrogError
from ...field.names import CANONICAL
from ...frames.store import FrameStore
from ...scene.header import SceneHeader
from ...scene.joined import TrainedSegment, join
from ...scene.scene_file import SceneFile, read_scene, write_scene
from ..recipe import Recipe
from ..session.events import Event
from ..session.job import TrainingJob
from ..session.output_paths import checkpoint_path, training_progress
from ..session.run import prepare_capture, run_training
from .plan import Cut, SegmentPlan, cuts_of
from .steady import read_rows, steady_rows, write_rows

MOST_MOMENTS = 300
"""Of the whole take, that its static Gaussians are learned from."""
BASE = -1
"""The number of the training of the whole take; segments count from 0."""


@dataclass(frozen=True)
class Stages:
    """The trainings of a plan, and the scene that is joined of them. Whatever is done already is not done again.

    Attributes:
        plan: what is to be trained.
    """

    plan: SegmentPlan

    @cached_property
    def _prepared(self) -> tuple[Capture, float]:
        """The take as it is trained on, and the scale that was used."""
        job = self.plan.job
        read = job.scale, job.holdout_frames, job.pixel_offsets, job.opened
        capture, scale = prepare_capture(job.capture, *read, job.mask_settings)
        if capture.has_moving_cameras:
            raise FrogError(f"{job.capture}: found moving cameras, expected standing ones for --segments.")
        return capture, scale

    @cached_property
    def cuts(self) -> list[Cut]:
        """Of each segment."""
        return cuts_of(self._prepared[0].frame_count, self.plan.length)

    def scene_path(self, number: int) -> Path:
        """Where the scene of a segment lies, or of BASE."""
        name = "base" if number == BASE else f"segment_{number:03d}"
        return self.plan.folder / f"{name}.frog"

    def is_done(self, number: int) -> bool:
        """Whether a segment, or BASE, has been trained to its end."""
        path = self.scene_path(number)
        trained = training_progress(path)
        return path.is_file() and trained is not None and trained[0] >= 1

    def label(self, number: int) -> str:
        """For people."""
        return "Whole take" if number == BASE else f"Segment {number + 1} of {len(self.cuts)}"

    def train(self, number: int, cancelled: Callable[[], bool] = lambda: False) -> Iterator[Event]:
        """Trains BASE, or a segment, for which what is shared must be chosen; goes on from its checkpoint."""
        yield from run_training(self.job_of(number), cancelled)

    def job_of(self, number: int) -> TrainingJob:
        """What ``train`` trains."""
        capture, _ = self._prepared
        output = self.scene_path(number)
        resume = checkpoint_path(output).is_file()
        job = replace(self.plan.job, output=output, lossless=True, overwrite=True, resume=resume, chosen={})
        job = replace(job, scale=1.0, holdout_frames=None)
        if number == BASE:
            return replace(job, opened=capture.thinned(MOST_MOMENTS))
        cut = self.cuts[number]
        found = {camera.name: camera for camera in self._base.header.cameras}
        segment = capture.segment(cut.trained_first, cut.trained_frames)
        segment = segment.with_cameras(found.get(camera.name, camera) for camera in segment.cameras)
        shared = self._shared
        recipe = _beside(self.plan.job.recipe, shared, self._base.arrays["sh"].shape[1])
        return replace(job, recipe=recipe, opened=segment, shared=shared if len(shared["means"]) else None)

    @cached_property
    def _base(self) -> SceneFile:
        return read_scene(self.scene_path(BASE))

    @cached_property
    def _shared(self) -> SceneArrays:
        """The Gaussians that all segments have."""
        rows = read_rows(self._rows_path, len(self._base.arrays["means"]))
        return {name: self._base.arrays[name][rows] for name in CANONICAL}

    @property
    def _rows_path(self) -> Path:
        return self.plan.folder / "shared.rows"

    def choose_shared(self) -> int:
        """Chooses the Gaussians that all segments are to have, once BASE is done and before a segment is trained;
        returns how many. What was chosen before stays."""
        if not self._rows_path.is_file():
            capture = self._prepared[0].thinned(MOST_MOMENTS).with_cameras(self._base.header.cameras)
            write_rows(self._rows_path, steady_rows(self._base, capture, FrameStore.open(capture)))
        return len(self._shared["means"])

    def join(self) -> SceneHeader:
        """Writes the scene of all segments, which must be done; returns its header."""
        shared, parts = self._shared, []
        for number, cut in enumerate(self.cuts):
            scene = read_scene(self.scene_path(number))
            parts.append(TrainedSegment(cut.first, cut.frames, cut.trained_first, scene))
        scene = join(self._header(parts), shared if len(shared["means"]) else {}, parts)
        write_scene(self.plan.job.output, scene, compact=not self.plan.job.lossless)
        return scene.header

    def _header(self, parts: list[TrainedSegment]) -> SceneHeader:
        job, (capture, scale) = self.plan.job, self._prepared
        found = {camera.name: camera for camera in self._base.header.cameras}
        shots: list[list[int]] = [[] for _ in capture.cameras]
        for shot in capture.shots:
            shots[shot.camera].append(shot.frame)
        headers = [self._base.header, *(part.scene.header for part in parts)]
        return replace(
            parts[0].scene.header,
            cameras=tuple(found.get(camera.name, camera) for camera in capture.cameras),
            camera_shots=tuple(tuple(frames) for frames in shots),
            test_cameras=tuple(sorted(capture.test_cameras)),
            test_frames=tuple(sorted(capture.test_frames)),
            frame_count=capture.frame_count,
            frames_per_second=capture.frames_per_second,
            scale=scale,
            pixel_offsets=dict(job.pixel_offsets or {}),
            metrics=_metrics(parts),
            steps=sum(header.steps for header in headers),
            train_seconds=sum(header.train_seconds for header in headers),
            capacity={},
        )


def _beside(recipe: Recipe, shared: SceneArrays, sh_count: int) -> Recipe:
    """The recipe of a segment: cameras and the shared Gaussians' colours are known, and there is room beside them."""
    count = len(shared["means"])
    return replace(
        recipe,
        pose_reach=0.0,
        exposure_from=1.0,
        sh_degree=math.isqrt(sh_count) - 1,
        sh_growth=(0.0,) * len(recipe.sh_growth),
        max_gaussians=max(recipe.max_gaussians, count + recipe.max_gaussians // 2),
    )


def _metrics(parts: list[TrainedSegment]) -> dict[str, float | str]:
    """The segments' together: the mean of their PSNR by frames, where all have one of the same images."""
    found = [part.scene.header.metrics for part in parts]
    splits = {str(metrics.get("split")) for metrics in found}
    if len(splits) > 1 or not all(isinstance(metrics.get("psnr"), float) for metrics in found):
        return {}
    psnr = np.average([metrics["psnr"] for metrics in found], weights=[part.frames for part in parts])
    return {"psnr": float(psnr), "split": splits.pop()}
