"""Times of a method on a quiet machine: a training step, and playback of a finished scene on the CPU.

Playback is a median over many frame times after a warm-up. No frame time occurs twice, because players cache recent
ones.
"""

import statistics
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

from .. import engine as frog
from .grid import Run
from .results import Record, append, made_on
from .runs import RunEnvironment, failure, identity

NUM_TIMES, WARM_UP = 40, 5
"""Frame times that are measured, and those (or training steps) before them that are not."""
STEPS = 300
"""Of the short training whose steps are timed."""
_GOLDEN = 0.6180339887498949


def spread_times(count: int, start: float = 0.5) -> list[float]:
    """``count`` different times in [0, 1), evenly spread and unordered (multiples of the golden ratio)."""
    return [(start + i * _GOLDEN) % 1.0 for i in range(count)]


def time_playback(scene: frog.ScenePlayer, camera: frog.Camera) -> Record:
    """ "deformation_ms" is of ``scene.at``, "rasterization_ms" of ``draw``; "frame_ms" and "fps"
    are of both."""
    deformation, rasterization = [], []
    for time in spread_times(NUM_TIMES + WARM_UP):
        started = perf_counter()
        gaussians = scene.at(time)
        deformed = perf_counter()
        frog.draw(gaussians, camera, scene.header.background)
        deformation.append(1e3 * (deformed - started))
        rasterization.append(1e3 * (perf_counter() - deformed))
    deformation, rasterization = deformation[WARM_UP:], rasterization[WARM_UP:]
    frame = statistics.median(map(sum, zip(deformation, rasterization, strict=True)))
    return {
        "gaussians": scene.count,
        "deformation_ms": statistics.median(deformation),
        "rasterization_ms": statistics.median(rasterization),
        "frame_ms": frame,
        "fps": 1e3 / frame,
    }


def time_steps(session: frog.Session, planned: int) -> Record:
    """Trains a session to its end, and tells how long a training of ``planned`` steps would take.

    Even a short training passes through every schedule, so that its mean step is that of a long one; but the number of
    steps that add, remove or reorder Gaussians does not depend on its length. "step_ms" is of the others.
    """
    trainer = session.trainer
    plain: list[float] = []
    reindexing: list[float] = []
    with frog.gc_frozen():  # as in a training
        while not trainer.finished:
            count, graph, before = trainer.count, trainer.smoothness.graph, trainer.seconds
            trainer.step()
            if trainer.step_count > WARM_UP:
                changed = trainer.count != count or trainer.smoothness.graph is not graph
                (reindexing if changed else plain).append(trainer.seconds - before)
    trainer.check()
    step = statistics.mean(plain) if plain else float("nan")
    seconds = step * planned + sum(reindexing) - step * len(reindexing)
    return {"steps": len(plain) + len(reindexing), "step_ms": 1e3 * step, "seconds": seconds}


def timed_runs(runs: Sequence[Run]) -> list[Run]:
    """The runs whose times the tables show: the first seed of each method and of each fusion."""
    return [run for run in runs if run.seed == 0 and run.group in ("methods", "fusion")]


def time_grid(
    runs: Sequence[Run],
    environment: RunEnvironment,
    progress: Callable[[int, int], None] = lambda done, total: None,
    cancelled: Callable[[], bool] = lambda: False,
) -> list[Record]:
    """Times ``timed_runs(runs)``, one at a time, and writes a record of kind "timing" for each.

    The played scene is that of the finished run, or else that of a short training.

    Args:
        progress: called with the number of timings done and of all.
        cancelled: asked whether to stop.
    """
    chosen = timed_runs(runs)
    records: list[Record] = []
    for done, run in enumerate(chosen):
        progress(done, len(chosen))
        if cancelled():
            break
        try:
            record = _time(run, environment)
        except (frog.FrogError, frog.TrainingDiverged) as error:
            record = failure(run, str(error))
        append(environment.results, record)
        records.append(record)
    progress(len(chosen), len(chosen))
    return records


def _time(run: Run, environment: RunEnvironment) -> Record:
    job = replace(environment.job(run), steps=STEPS)
    capture, scale = frog.prepare_capture(job)
    store, device = frog.FrameStore.open(capture), frog.choose_device(job.device)[0]
    camera = next((camera for camera in capture.cameras if camera.name in capture.test_cameras), capture.cameras[0])
    with TemporaryDirectory() as folder:
        path = Path(folder) / "short.frog"
        trainer = frog.Trainer(capture, store, frog.seeds_of(job, capture, store), job.recipe, job, device)
        frog.add_hooks(trainer)
        session = frog.Session(job, trainer, scale)
        training = time_steps(session, run.steps or job.recipe.steps_for(capture.frame_count))
        finished = environment.scene(run)
        if finished.is_file():
            path = finished
        else:
            frog.export_scene(session, path)
        playback = time_playback(frog.ScenePlayer.load(path), camera)
    return {
        "kind": "timing",
        **identity(run),
        "training": training,
        "playback": playback,
        "scene_played": "finished" if path == finished else "short training",
        "device": device.type,
        "threads": environment.threads,
        **made_on(),
    }
