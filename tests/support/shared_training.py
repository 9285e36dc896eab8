"""One process of a training of the filmed scene; run by test_process_group.py, with torchrun's variables set.

    python shared_training.py CAPTURE OUTPUT STEPS

Prints a line for each step that is told of, and one sentence on standard error where the training ends early.
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support import synthetic_capture as film

from frog_blender.engine.distributed.process_group import joined
from frog_blender.engine.errors import FrogError
from frog_blender.engine.training.recipe import Recipe, recipe
from frog_blender.engine.training.session.events import Finished, Progress
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training

VIEWS = 2


def two_views(steps: int) -> Recipe:
    """Densifies, samples anchors, prunes, and learns from two views a step."""
    rates = {"network_rate": 1e-3, "embedding_rate": 3e-2, "mean_rate": 2e-4, "max_gaussians": 500}
    return recipe("draft", steps=steps, steps_per_moment=0, capacity="auto", views_per_step=VIEWS, **rates)


def job_of(capture: Path, output: Path, steps: int) -> TrainingJob:
    """The same in every process."""
    exact = {"lossless": True, "device": "cpu", "event_seconds": 0.0, "preview_seconds": 1e6}
    return TrainingJob(capture, output, recipe=two_views(steps), seed=2, seeds=film.seeds(), **exact)


def main() -> int:
    capture, output, steps = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    finished = False
    try:
        with joined() as peers:
            for event in run_training(job_of(capture, output, steps), peers=peers):
                if isinstance(event, Progress):
                    print(f"step {event.step}", flush=True)
                finished |= isinstance(event, Finished)
    except FrogError as error:
        print(error, file=sys.stderr)
    return 0 if finished else 1


if __name__ == "__main__":
    sys.exit(main())
