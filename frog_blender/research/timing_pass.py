"""The timing pass of an experiment: every method for a short while, one at a time on a quiet machine."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from ..engine import (
    FrameStore,
    FrogError,
    Limits,
    ScenePlayer,
    Session,
    Trainer,
    TrainingDiverged,
    TrainingJob,
    checkpoint_path,
    choose_device,
    export_scene,
    hooks_of,
    load_checkpoint,
    prepare_capture,
    seeds_of,
)
from .grid import Run
from .results import Record, append
from .runs import RunEnvironment, identity, made_on
from .timing import time_playback, time_steps, time_training_path

if TYPE_CHECKING:
    import torch

    from ..engine import Capture

STEPS = 300


def timed_runs(runs: Sequence[Run]) -> list[Run]:
    """The runs whose times the tables show: the first seed of each method and of each fusion."""
    return [run for run in runs if run.seed == 0 and run.group in ("methods", "fusion")]


def time_grid(
    runs: Sequence[Run],
    environment: RunEnvironment,
    steps: int = STEPS,
    progress: Callable[[int, int], None] = lambda done, total: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> list[Record]:
    """Times ``timed_runs(runs)`` and writes a record of kind "timing" for each.

    The played scene is that of the finished run, or else that of a short training.

    Args:
        steps: of the short training.
        progress: called with the number of timings done and of all.
        cancelled: asked whether to stop.
    """
    chosen = timed_runs(runs)
    prepared: dict[str, _Prepared] = {}
    records: list[Record] = []
    for done, run in enumerate(chosen):
        progress(done, len(chosen))
        if cancelled():
            break
        try:
            if run.scene not in prepared:
                prepared = {run.scene: _prepare(run, environment)}  # one at a time: frames take much memory
            record = _time(run, environment, steps, prepared[run.scene])
        except (FrogError, TrainingDiverged) as error:
            record = {"kind": "failed", **identity(run), "error": str(error).replace(run.capture, run.scene)}
        append(environment.results, record)
        records.append(record)
    progress(len(chosen), len(chosen))
    return records


@dataclass(frozen=True)
class _Prepared:
    """What all timings on one scene share."""

    capture: Capture
    scale: float
    store: FrameStore
    device: torch.device

    def session(self, run: Run, output: Path, steps: int) -> Session:
        """A training of ``run`` that has not begun."""
        recipe = run.plain_recipe()
        job = TrainingJob(Path(run.capture), output, method=run.method, recipe=recipe, seed=run.seed)
        sources = (self.capture, self.store, seeds_of(job, self.capture, self.store))
        hooks = hooks_of(job, self.capture, self.store)
        trainer = Trainer(*sources, recipe, run.method, Limits(steps), seed=run.seed, device=self.device, hooks=hooks)
        return Session(job, trainer, self.scale)


def _prepare(run: Run, environment: RunEnvironment) -> _Prepared:
    capture, scale = prepare_capture(Path(run.capture), run.scale, run.holdout_frames, None, run.opened())
    store = FrameStore.open(capture)
    return _Prepared(capture, scale, store, choose_device(environment.device)[0])


def _time(run: Run, environment: RunEnvironment, steps: int, prepared: _Prepared) -> Record:
    recipe, capture = run.plain_recipe(), prepared.capture
    camera = next((c for c in capture.cameras if c.name in capture.test_cameras), capture.cameras[0])
    planned = run.steps or recipe.steps_for(capture.frame_count)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "short.frog"
        timed = prepared.session(run, path, steps)
        step_times = time_steps(timed)
        export_scene(timed, path)
        finished = environment.scene(run)
        if finished.is_file() and checkpoint_path(finished).is_file():
            timed = prepared.session(run, finished, planned)
            load_checkpoint(checkpoint_path(finished), timed.trainer)
            path = finished
        scene = ScenePlayer.load(path)
        on_path = time_training_path(timed.trainer.model, camera, capture.background)
        playback = time_playback(scene, camera)
    return {
        "kind": "timing",
        **identity(run),
        "training": {**step_times.summary(), "seconds": step_times.training_seconds(planned)},
        "training_path": on_path,
        "playback": playback,
        "scene_played": "finished" if path == finished else "short training",
        "device": prepared.device.type,
        "threads": environment.threads,
        **made_on(),
    }
