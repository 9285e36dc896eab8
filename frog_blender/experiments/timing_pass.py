"""The dedicated pass of a comparison: every method one after the other on a quiet machine, each for a short while."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

from ..engine.capture.frames import FrameStore
from ..engine.capture.seed_store import stored_seeds
from ..engine.errors import FrogError
from ..engine.playback.player import ScenePlayer
from ..engine.training.build import build_trainer
from ..engine.training.optimize.device import choose_device
from ..engine.training.optimize.trainer import Limits, Trainer
from ..engine.training.session.checkpoint import checkpoint_path, load_checkpoint
from ..engine.training.session.export import save_scene
from ..engine.training.session.job import TrainingJob, prepare_capture
from .grid import Run
from .results import Record, append
from .runs import Conditions, identity, made_on
from .timing import time_playback, time_steps, time_training_path

STEPS = 300


def timed_runs(runs: Sequence[Run]) -> list[Run]:
    """Those whose times stand in the tables: one of each method, and of each fusion."""
    return [run for run in runs if run.seed == 0 and run.group in ("methods", "fusion")]


def time_grid(
    runs: Sequence[Run],
    conditions: Conditions,
    steps: int = STEPS,
    told: Callable[[int, int], None] = lambda done, total: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> list[Record]:
    """Times ``timed_runs(runs)`` and writes a line of kind "timing" for each. Where a run is finished its scene is
    played, otherwise the short training's."""
    chosen = timed_runs(runs)
    prepared: dict[str, tuple[Any, ...]] = {}
    records = []
    for done, run in enumerate(chosen):
        told(done, len(chosen))
        if cancelled():
            break
        try:
            if run.scene not in prepared:
                prepared = {run.scene: _prepare(run, conditions)}  # one at a time: frames are large
            record = _time(run, conditions, steps, *prepared[run.scene])
        except FrogError as error:
            record = {"kind": "failed", **identity(run), "error": str(error).replace(run.capture, run.scene)}
        append(conditions.results, record)
        records.append(record)
    told(len(chosen), len(chosen))
    return records


def _prepare(run: Run, conditions: Conditions) -> tuple[Any, ...]:
    capture, scale = prepare_capture(Path(run.capture), run.scale, run.holdout_frames, None, run.opened())
    store = FrameStore.open(capture)
    seeds = stored_seeds(capture, store, count_limit=run.settings().seed_gaussians, seed=run.seed)
    return capture, scale, store, seeds, choose_device(conditions.device)[0]


def _time(
    run: Run, conditions: Conditions, steps: int, capture: Any, scale: float, store: Any, seeds: Any, device: Any
) -> Record:
    recipe = run.plain_recipe()

    def trainer(limit: int) -> Trainer:
        return build_trainer(capture, store, seeds, recipe, run.method, Limits(limit), seed=run.seed, device=device)

    short = trainer(steps)
    step_times = time_steps(short)
    camera = next((c for c in capture.cameras if c.name in capture.test_cameras), capture.cameras[0])
    planned = run.steps or recipe.steps_for(capture.frame_count)
    with TemporaryDirectory() as folder:
        path = Path(folder) / "short.frog"
        save_scene(TrainingJob(Path(run.capture), path, method=run.method, recipe=recipe), short, scale, {})
        finished, model_of = conditions.scene(run), short
        if finished.is_file() and checkpoint_path(finished).is_file():
            model_of = trainer(planned)
            load_checkpoint(checkpoint_path(finished), model_of)
            path = finished
        scene = ScenePlayer.load(path)
        on_path = time_training_path(model_of.model, camera, capture.background)
        playback = time_playback(scene, camera)
    return {
        "kind": "timing",
        **identity(run),
        "training": {**step_times.summary(), "seconds": step_times.training_seconds(planned)},
        "training_path": on_path,
        "playback": playback,
        "scene_played": "finished" if path == finished else "short training",
        "device": device.type,
        "threads": conditions.threads,
        **made_on(),
    }
