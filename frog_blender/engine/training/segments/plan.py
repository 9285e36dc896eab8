"""How a long take is cut, and with which settings: a file beside its scene, from which any process can go on."""

from __future__ import annotations

import json
import shutil
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path

from ...errors import FrogError, found_instead
from ...io.atomic_files import write_atomically
from ...io.plain_values import JsonObject, UnfitValue, entries, plain_json, whole
from ..methods import method_named
from ..session.job import TrainingJob
from ..session.output_paths import beside

OVERLAP = 8
"""Frames on each side of a segment that it is trained on and its neighbour plays."""
_SHORTEST = 8  # frames of a segment
_FILE, _VERSION, _MOST_CHARACTERS = "plan.json", 1, 1_000_000


@dataclass(frozen=True)
class Cut:
    """The frames of a segment: those that it plays, and those that it is trained on."""

    first: int
    frames: int
    trained_first: int
    trained_frames: int


def cuts_of(frame_count: int, length: int) -> list[Cut]:
    """Segments of about ``length`` frames each, all about equal; FrogError where there would be one alone, or a segment
    would be too short."""
    if length < _SHORTEST:
        raise FrogError(f"--segments {length}: expected at least {_SHORTEST} frames.")
    count = round(frame_count / length)
    if count < 2:
        raise FrogError(
            f"--segments {length}: the capture has {frame_count} frames, which are one segment: leave it out."
        )
    edges = [round(k * frame_count / count) for k in range(count + 1)]
    cuts = []
    for first, end in pairwise(edges):
        before, after = max(first - OVERLAP, 0), min(end + OVERLAP, frame_count)
        cuts.append(Cut(first, end - first, before, after - before))
    return cuts


@dataclass(frozen=True)
class SegmentPlan:
    """What is to be trained in segments.

    Attributes:
        folder: where the segments' scenes and checkpoints lie.
        length: about the frames of a segment.
        job: the training of the whole take, were it one.
    """

    folder: Path
    length: int
    job: TrainingJob

    @classmethod
    def begin(cls, job: TrainingJob, length: int) -> SegmentPlan:
        """The plan beside the scene of ``job``: a new one, or the same that was begun before.

        Raises:
            FrogError: another one was begun, and may not be replaced; or the job cannot be cut.
        """
        _check_job(job)
        plan = cls(beside(job.output, ".segments"), length, job)
        if (plan.folder / _FILE).is_file():
            same = _read(plan.folder)[0] == json.loads(json.dumps(plan._content))
            if same and not (job.overwrite and job.output.is_file()):
                return plan
            if not job.overwrite:
                raise FrogError(
                    f"{plan.folder}: found a training in segments with other settings; --overwrite begins anew, the"
                    " same settings go on with it."
                )
            shutil.rmtree(plan.folder)
        write_atomically(plan.folder / _FILE, json.dumps(plan._content, indent=1).encode())
        return plan

    @classmethod
    def open(cls, folder: Path, **changes: object) -> SegmentPlan:
        """The plan in a folder, with fields of its job that it does not say; FrogError where there is none."""
        content, path = _read(folder)
        try:
            settings = entries(content["settings"], "settings")
            job = TrainingJob.of_settings(settings, folder.with_name(str(content["output"])))
            length = whole(content["length"], "length", _SHORTEST, 2**31)
        except (KeyError, UnfitValue, FrogError) as error:
            raise found_instead(path, f"settings that do not fit ({error})", "the plan of a training") from error
        known = {field.name for field in fields(TrainingJob)}
        assert changes.keys() <= known
        return cls(folder, length, replace(job, **changes))  # type: ignore[arg-type]

    @property
    def _content(self) -> JsonObject:
        settings = self.job.stored_settings()
        return {"version": _VERSION, "length": self.length, "output": self.job.output.name, "settings": settings}


def _read(folder: Path) -> tuple[JsonObject, Path]:
    path = folder / _FILE
    try:
        with path.open(encoding="utf-8") as file:
            text = file.read(_MOST_CHARACTERS)
        content = entries(plain_json(text, "a plan"), "a plan")
    except OSError as error:
        raise FrogError(f"{path}: could not be read ({error.strerror or error}).") from error
    except (UnfitValue, UnicodeDecodeError) as error:
        raise found_instead(path, f"contents that do not fit ({error})", "the plan of a training") from error
    if content.get("version") != _VERSION:
        raise found_instead(path, "a plan of another version", f"version {_VERSION}")
    return content, path


def _check_job(job: TrainingJob) -> None:
    """FrogError for what cannot be trained in segments."""
    adapted = method_named(job.method).adapt(job.recipe)
    if job.method != "frog" or adapted.capacity != "auto" or adapted.fusion in ("attention", "dual"):
        raise FrogError(
            "--segments shares what --capacity auto finds static: found another method or capacity, expected"
            " --method frog --capacity auto."
        )
    if job.seconds or job.max_bytes:
        raise FrogError("--segments: found --seconds or --max-bytes, expected --steps, which holds for each segment.")
