"""One run of an experiment: a training, its metrics on the held-out images, and the record of both.

A killed run resumes from its checkpoint, unless its settings have changed since.
"""

import json
import statistics
import time
from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from .. import engine as frog
from ..cli.arguments import limited_threads
from ..engine.registry import METHODS
from .conditions import CONDITIONS, brightened_values
from .grid import Run
from .results import Record, finished, made_on


@dataclass(frozen=True)
class RunEnvironment:
    """Where and how runs are made. It decides their times, not their results.

    Attributes:
        folder: of the results; scenes lie in its ``scenes``.
        device: see ``TrainingJob``.
        threads: of each run; 0 for one a core.
        dedicated: whether no other run of the grid works at the same time.
    """

    folder: Path
    device: str = "auto"
    threads: int = 0
    dedicated: bool = True

    @property
    def results(self) -> Path:
        """The file of JSON lines."""
        return self.folder / "runs.jsonl"

    def scene(self, run: Run) -> Path:
        """Where a run's ``.frog`` lies."""
        return self.folder / "scenes" / f"{run.key}.frog"

    def job(self, run: Run) -> frog.TrainingJob:
        """The training of a run, without its limits."""
        return frog.TrainingJob(
            Path(run.capture),
            self.scene(run),
            method=run.method,
            recipe=run.plain_recipe(),
            seed=run.seed,
            scale=run.scale,
            holdout_frames=run.holdout_frames,
            device=self.device,
            save_every=180.0,
            overwrite=True,
            opened=run.opened(),
        )


class Stopped(Exception):
    """The run was cancelled; its checkpoint is kept."""


def not_done(runs: Iterable[Run], records: Iterable[Record], environment: RunEnvironment) -> list[Run]:
    """The runs that ``records`` do not have of the capture that lies there today, and with today's settings.

    What only one of the two knows is not compared.
    """
    done, captures = finished(records), dict[tuple[object, ...], dict[str, str]]()

    def is_done(run: Run) -> bool:
        record = done.get(run.key)
        settings = {} if record is None else frog.settings_json(run.settings())
        if record is None or any(settings.get(name, value) != value for name, value in record["recipe"].items()):
            return False
        made = record.get("made_of")
        capture = (run.capture, run.scene, run.condition, run.scale, run.holdout_frames)
        if made and capture not in captures:
            captures[capture] = {}
            with suppress(frog.FrogError):  # of one that is gone nothing says that it is another
                captures[capture] = frog.made_of(frog.prepare_capture(environment.job(run))[0])
        return not made or captures[capture] in ({}, made)

    return [run for run in runs if not is_done(run)]


def frog_seconds(run: Run, records: Iterable[Record], environment: RunEnvironment) -> float:
    """How long FRoG trained on the scene of an equal-time run: the median over its seeds, in the same environment.

    Raises:
        FrogError: if there is no such run of FRoG.
    """
    same = ("scene", "recipe_name", "overrides", "scale", "holdout_frames", "planned_steps")
    own = identity(run)
    seconds = [
        record["train_seconds"]
        for record in finished(records).values()
        if record["method"] == "frog"
        and record["group"] == "methods"
        and all(record[name] == own[name] for name in same)
        and (record["threads"], record["dedicated"]) == (environment.threads, environment.dedicated)
    ]
    if not seconds:
        raise frog.FrogError(
            f"{run.scene}: there is no finished run of FRoG under the same conditions, expected one for its seconds."
        )
    return float(statistics.median(seconds))


def identity(run: Run) -> Record:
    """The part of a record that identifies its run."""
    names = ("key", "scene", "condition", "protocol", "method", "label", "group", "seed", "equal_time", "scale")
    overrides = json.loads(json.dumps(dict(run.overrides)))
    return {
        **{name: getattr(run, name) for name in (*names, "holdout_frames")},
        "title": METHODS[run.method].title,
        "recipe_name": run.recipe,
        "overrides": overrides,
        "planned_steps": run.steps,
    }


def failure(run: Run, sentence: str) -> Record:
    """The record of a run that failed. The path of the capture's folder is replaced by the scene's name."""
    return {"kind": "failed", **identity(run), "error": sentence.replace(run.capture, run.scene), **made_on()}


def perform(
    run: Run,
    environment: RunEnvironment,
    seconds: float | None = None,
    advanced: Callable[[float], None] = lambda share: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> Record:
    """Trains a run, or resumes its training, and evaluates it; returns its record.

    Args:
        seconds: the limit of an equal-time run.
        advanced: called with the share of the training that is done.
        cancelled: asked whether to stop.

    Raises:
        Stopped: if it was cancelled.
        FrogError: if the capture or the settings cannot be used.
    """
    with limited_threads(environment.threads):
        started = time.monotonic()
        limit = {"seconds": seconds} if run.equal_time else {"steps": run.steps}
        job = replace(environment.job(run), **limit)
        trained = _train(job, advanced, cancelled)
        measured = _measure(job, CONDITIONS[run.condition].light if run.condition else 1.0)
        return {
            "kind": "run",
            **identity(run),
            "recipe": frog.settings_json(run.settings()),
            "seconds_limit": job.seconds,
            **trained,
            **measured,
            "threads": environment.threads,
            "dedicated": environment.dedicated,
            "wall_seconds": time.monotonic() - started,
            **made_on(),
        }


def _train(job: frog.TrainingJob, advanced: Callable[[float], None], cancelled: Callable[[], bool]) -> Record:
    """The training's part of the record; goes on from a checkpoint of the same settings."""
    checkpoint = frog.checkpoint_path(job.output)
    if checkpoint.is_file():
        try:
            if frog.checkpoint_settings(checkpoint) == json.loads(json.dumps(job.stored_settings())):
                return _follow(replace(job, resume=True), advanced, cancelled)
        except frog.FrogError as error:
            if not str(error).startswith(str(checkpoint)):
                raise  # else the checkpoint is damaged: start again
        checkpoint.unlink()
    return _follow(job, advanced, cancelled)


def _follow(job: frog.TrainingJob, advanced: Callable[[float], None], cancelled: Callable[[], bool]) -> Record:
    warnings, device = [], "cpu"
    for event in frog.run_training(job, cancelled):
        match event:
            case frog.WarningEvent(message):
                warnings.append(message.replace(str(job.capture), job.capture.name))
            case frog.Started(device=device):
                pass
            case frog.Progress(seconds=seconds, seconds_left=left):
                advanced(seconds / (seconds + left) if seconds + left > 0 else 0.0)
            case frog.Finished(steps=steps, seconds=seconds, gaussians=gaussians, capacity=capacity):
                advanced(1.0)
                return {
                    "steps": steps,
                    "train_seconds": seconds,
                    "gaussians": gaussians,
                    "dynamic": capacity.get("dynamic", gaussians),
                    "device": device,
                    "warnings": warnings,
                }
    raise Stopped


_PERCEPTUAL = ("flip", "lpips", "lpips_vgg")
_FIGURES = ("psnr", "psnr_moving", "psnr_bright", "ssim", *_PERCEPTUAL, "sharpness_moving", "frames", "split")


def _measure(job: frog.TrainingJob, light: float) -> Record:
    """Metrics of the written scene on the held-out images.

    A metric that cannot be computed is None, and "missing" says why.

    Args:
        light: of the scene relative to the clean capture's. If it is not 1, "psnr_bright" is the PSNR after brightening
            both images by its inverse.
    """
    capture, _ = frog.prepare_capture(job)
    scene = frog.ScenePlayer.load(job.output)
    capture = capture.with_cameras(scene.header.cameras)  # as training left their poses
    metrics, missing = frog.perceptual_metrics()
    if light != 1:
        metrics = {**metrics, "psnr_bright": partial(_bright_psnr, 1 / light)}
    size = job.output.stat().st_size
    metrics_of_all = frog.evaluate_images(
        scene, frog.TrueImages(capture, frog.FrameStore.open(capture)), more_metrics=metrics
    )
    camera = capture.cameras[0]
    figures = {name: metrics_of_all.get(name) for name in _FIGURES}
    packed = len(frog.scene_bytes(frog.read_scene(job.output), compact=True))
    sizes = {"bytes": size, "packed_bytes": packed, "size": [camera.width, camera.height]}
    off_rig = _off_rig(job, capture, scene) if light == 1 else {}
    return {**figures, **off_rig, **sizes, "made_of": dict(scene.header.made_of), "missing": missing}


OFF_RIG = ("fly", "near", "zoom", "beside")
"""PSNR in images from off the rig, of a capture's folder ``fly``: all, and groups of that name with any number."""


def _off_rig(job: frog.TrainingJob, capture: frog.Capture, scene: frog.ScenePlayer) -> Record:
    """``OFF_RIG``; nothing where there are no such images, or a condition's frames are not the capture's."""
    file = job.capture / "fly" / "transforms.json"
    if not file.is_file() or frog.open_capture(job.capture).frame_count != capture.frame_count:
        return {}
    figures = frog.fly_figures(scene, capture.world, frog.read_fly(file, capture.frame_count)[0])
    values: dict[str, list[float]] = {"fly": [figures["fly"]]}
    for group, own in figures["groups"].items():
        values.setdefault(group.rstrip("0123456789"), []).append(own["psnr"])
    return {name: statistics.mean(values[name]) for name in OFF_RIG if None not in values.get(name, [None])}


def _bright_psnr(gain: float, image: frog.Floats, truth: frog.Floats) -> float:
    error = brightened_values(image.astype(np.float64), gain) - brightened_values(truth.astype(np.float64), gain)
    return frog.psnr_of(float((error**2).mean()))
