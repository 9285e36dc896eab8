"""Trains in processes that are killed at random times; run by test_fallback_save.py in an interpreter of its own.

    python killed_trainings.py FOLDER KILLS SEED STEPS

Processes are forked before any thread is started, so that each is at work at once. Prints a JSON object.
"""

import json
import os
import random
import signal
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support import synthetic_capture as film

from frog_blender.engine.io.tensor_files import read_tensors
from frog_blender.engine.recipes import recipe
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.session.events import Progress
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.output_paths import checkpoint_path
from frog_blender.engine.training.session.run import run_training

RATES = {"steps_per_moment": 0, "max_gaussians": 400, "capacity": "auto"}


def forked(work: Callable[[], object]) -> int:
    """The number of a process that does ``work`` and ends."""
    process = os.fork()
    if process:
        return process
    status = 1
    try:
        work()
        status = 0
    finally:
        os._exit(status)


def killed_after(process: int, seconds: float, begun: int | None = None) -> bool:
    """True if the process was still at work when it was killed: so long after it wrote to the pipe ``begun``."""
    if begun is not None:
        os.read(begun, 1)  # or it has ended
    deadline = time.monotonic() + seconds
    while time.monotonic() < deadline:
        ended, status = os.waitpid(process, os.WNOHANG)
        if ended:
            assert status == 0, "a training failed"
            return False
        time.sleep(0.001)
    os.kill(process, signal.SIGKILL)
    os.waitpid(process, 0)
    return True


def train(task: TrainingJob, begun: int | None = None) -> None:
    resume = checkpoint_path(task.output).is_file()
    for event in run_training(replace(task, resume=resume)):
        if begun is not None and isinstance(event, Progress):
            os.write(begun, b".")


def killed_training(task: TrainingJob, chance: random.Random) -> bool:
    """Trains until it is killed, mostly soon after its first step; True if it was."""
    reading, writing = os.pipe()
    process = forked(lambda: train(task, writing))
    os.close(writing)
    try:
        if chance.random() < 0.2:
            return killed_after(process, chance.uniform(0, 1))
        return killed_after(process, chance.uniform(0, 0.4), reading)
    finally:
        os.close(reading)


def arrays(path: Path) -> dict[str, bytes]:
    return {name: array.tobytes() for name, array in read_scene(path).arrays.items()}


def during_training(folder: Path, kills: int, seed: int, steps: int) -> dict[str, int]:
    """Kills trainings and goes on until each has ended as an undisturbed one."""
    chance = random.Random(seed)
    options = {"recipe": recipe("draft", steps=steps, **RATES), "seed": 2, "seeds": film.seeds()}
    task = TrainingJob(folder / "capture", folder / "whole.frog", **options)
    assert os.waitpid(forked(lambda: train(task)), 0)[1] == 0, "the undisturbed training failed"
    undisturbed = arrays(task.output)
    done = rounds = resumed = 0
    while done < kills:
        rounds += 1
        output = folder / f"killed{rounds}.frog"
        disturbed = replace(task, output=output, save_every=0.05)
        while True:
            resumed += checkpoint_path(output).is_file()
            if done >= kills:
                assert os.waitpid(forked(lambda task=disturbed: train(task)), 0)[1] == 0, "a training failed"
                break
            if not killed_training(disturbed, chance):
                break
            done += 1
            if checkpoint_path(output).is_file():
                read_tensors(checkpoint_path(output), "a training checkpoint")
            if output.is_file():
                read_scene(output)
        assert arrays(output) == undisturbed, f"round {rounds} ended with other bits"
        left = [path.name for path in folder.iterdir() if path.name.endswith(".part")]
        assert not left, f"left behind: {left}"
    return {"kills": done, "resumes": resumed, "trainings": rounds}


def main() -> None:
    folder, kills, seed, steps = Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]), int(sys.argv[4])
    print(json.dumps(during_training(folder, kills, seed, steps)))


if __name__ == "__main__":
    main()
