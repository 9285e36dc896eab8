"""One of the processes of a shared training of the filmed scene, started by test_processes.py as torchrun would.

    python shared_training.py CAPTURE OUT.frog STEPS

Rank 0 prints the events' names.
"""

import os
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support import synthetic_capture as film

from frog_blender.engine.errors import FrogError
from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.processes import joined
from frog_blender.engine.training.session.run import run_training

SETTINGS = {"steps_per_moment": 0, "max_gaussians": 500, "capacity": "auto"}


def job(capture: Path, output: Path, steps: int, *, views: int = 1, resume: bool = False) -> TrainingJob:
    """The same training for any number of processes."""
    settings = recipe("draft", steps=steps, views_per_step=views, **SETTINGS)
    limit = steps if resume else None
    given = {"recipe": settings, "seeds": film.seeds(), "lossless": True, "resume": resume, "device": "cpu"}
    return TrainingJob(capture, output, steps=limit, event_seconds=0.0, **given)


def main() -> int:
    capture, output, steps = Path(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3])
    try:
        with joined("cpu") as processes:
            for event in run_training(job(capture, output, steps), peers=processes):
                if processes.rank == 0:
                    print(type(event).__name__, flush=True)
    except FrogError as error:
        print(error, file=sys.stderr, flush=True)
        os._exit(1)  # as the command does: torch's threads wait on for a process that hangs
    return 0


if __name__ == "__main__":
    sys.exit(main())
