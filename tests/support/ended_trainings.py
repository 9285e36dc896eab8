"""Trains by ``frog train`` and ends it at random times; run by test_fallback_save.py in an interpreter of its own.

    python ended_trainings.py FOLDER TERM,HUP|full|kill COUNT SEED [STEPS]

FOLDER/capture is the capture; "full" wants FOLDER/disk to be a small file system, on which scene, cache and temporary
folder lie; "kill" goes on until each training has taken STEPS. Processes are forked before any thread is started, so
that each is at work at once. Prints a JSON object.
"""

import json
import os
import random
import shutil
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from support import synthetic_capture as film

from frog_blender.cli.main import main as frog
from frog_blender.engine.io.tensor_files import read_tensors
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import run as training_run
from frog_blender.engine.training.session.output_paths import checkpoint_path

STEPS = 100_000
_LONGEST = 1.0  # seconds after the first step


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


def train(capture: Path, out: Path, log: Path, options: list[str], begun: int) -> None:
    """``frog train``; writes to ``begun`` at its first step. Ends the process with the command's exit status."""
    opened = os.open(log, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND)
    for descriptor in (1, 2):
        os.dup2(opened, descriptor)
    step = Trainer.step

    def told(self: Trainer) -> None:
        step(self)
        if self.step_count == 1:
            os.write(begun, b".")

    Trainer.step = told  # type: ignore[method-assign]
    arguments = ["train", str(capture), "--out", str(out), "--recipe", "draft", "--max-gaussians", "400", *options]
    os._exit(frog(arguments))


def begun_training(capture: Path, out: Path, log: Path, options: list[str], wait: bool) -> int:
    """The number of its process; with ``wait`` once it has taken its first step."""
    reading, writing = os.pipe()
    process = forked(lambda: train(capture, out, log, options, writing))
    os.close(writing)
    if wait:
        os.read(reading, 1)
    os.close(reading)
    return process


def steps_of(path: Path) -> int:
    """Of a scene that plays, asked in a process of its own: this one must not start threads."""
    reading, writing = os.pipe()

    def play() -> None:
        scene = ScenePlayer.load(path)
        assert len(scene.at(0.4).means) == scene.count
        os.write(writing, str(scene.header.steps).encode())

    status = os.waitpid(forked(play), 0)[1]
    os.close(writing)
    assert status == 0, f"{path} does not play"
    with os.fdopen(reading) as answer:
        return int(answer.read())


def by_signal(folder: Path, names: list[str], count: int, chance: random.Random) -> dict[str, int]:
    """Ends trainings by signals in turn, most of them soon after the first step, some before it."""
    out, log, early = folder / "x.frog", folder / "log", 0
    for turn in range(count):
        name = names[turn % len(names)]
        signal_number = getattr(signal, f"SIG{name}")
        before = turn % 5 == 4
        process = begun_training(folder / "capture", out, log, ["--steps", str(STEPS)], not before)
        time.sleep(chance.uniform(0.3 if before else 0.0, _LONGEST))  # the command has to have begun
        os.kill(process, signal_number)
        if name == "HUP":
            os.kill(process, signal_number)  # as a terminal that is closed does
        status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        said = log.read_text().replace("\r", "\n")
        assert status == 3 and "frog: " in said and "Traceback" not in said, (status, said)
        left = {path.name for path in folder.iterdir()} - {"capture", "cache", "log"}
        if left:
            assert left == {"x.frog", "x.frog.checkpoint"}, left
            steps = steps_of(out)
            assert f"frog: cancelled at step {steps}, kept in {out}; --resume goes on." in said, said
        else:
            assert before and "nothing was written" in said, said
            early += 1
        for path in (out, folder / "x.frog.checkpoint"):
            path.unlink(missing_ok=True)
    return {"ended": count, "before the first step": early}


def by_full_disk(folder: Path, count: int, chance: random.Random) -> dict[str, int]:
    """Fills the one disk after the first step; some trainings are cancelled then, others come to their end."""
    disk = folder / "disk"
    counts = {"cancelled": 0, "finished": 0, "elsewhere": 0}
    for turn in range(count):
        for name in ("out", "tmp", "cache"):
            shutil.rmtree(disk / name, ignore_errors=True)
            (disk / name).mkdir()
        out, cancels = disk / "out" / "x.frog", bool(turn % 2)
        options = ["--save-every", "0.2", *(["--lossless"] if turn % 3 == 2 else [])]
        options += ["--steps", str(STEPS)] if cancels else ["--seconds", "2"]
        process = begun_training(folder / "capture", out, folder / "log", options, wait=True)
        time.sleep(chance.uniform(0.0, 0.7))
        fill(disk / "filler")
        if cancels:
            time.sleep(chance.uniform(0.0, 0.5))
            os.kill(process, signal.SIGINT)
        status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
        said = (folder / "log").read_text().replace("\r", "\n")
        assert status == (3 if cancels else 0) and "Traceback" not in said, (status, said)
        assert "No space left on device" in said or "the disk is full" in said, said
        scenes = [*disk.rglob("*.frog")]
        assert len(scenes) == 1 and steps_of(scenes[0]) > 0, (scenes, said)
        assert f"{scenes[0]}" in said
        assert not [*disk.rglob("*.part")]
        counts["cancelled" if cancels else "finished"] += 1
        counts["elsewhere"] += scenes[0] != out
        (disk / "filler").unlink()
    return counts


def by_kill(folder: Path, count: int, chance: random.Random, steps: int) -> dict[str, int]:
    """Kills trainings, mostly soon after the first step, and goes on until each has ended as an undisturbed one."""
    options = ["--steps", str(steps), "--save-every", "0.05"]
    process = begun_training(folder / "capture", folder / "whole.frog", folder / "log", options, wait=False)
    assert os.waitpid(process, 0)[1] == 0, "the undisturbed training failed"
    undisturbed = arrays_of(folder / "whole.frog")
    counts = {"kills": 0, "resumes": 0, "trainings": 0}
    while counts["kills"] < count:
        counts["trainings"] += 1
        out, status = folder / f"killed{counts['trainings']}.frog", -signal.SIGKILL
        while status:
            resume = ["--resume"] * checkpoint_path(out).is_file()
            counts["resumes"] += len(resume)
            process = begun_training(
                folder / "capture", out, folder / "log", [*options, *resume], chance.random() < 0.8
            )
            if counts["kills"] < count:
                time.sleep(chance.uniform(0, 0.4))
                os.kill(process, signal.SIGKILL)  # which does nothing to one that has ended
            status = os.waitstatus_to_exitcode(os.waitpid(process, 0)[1])
            assert status in (0, -signal.SIGKILL), (folder / "log").read_text()
            counts["kills"] += status != 0
            if checkpoint_path(out).is_file():
                read_tensors(checkpoint_path(out), "a training checkpoint")
            if out.is_file():
                read_scene(out)
        assert arrays_of(out) == undisturbed, f"training {counts['trainings']} ended with other bits"
        assert not [*folder.glob("*.part")], "half-written files were left behind"
    return counts


def arrays_of(path: Path) -> dict[str, bytes]:
    return {name: array.tobytes() for name, array in read_scene(path).arrays.items()}


def fill(path: Path) -> None:
    with path.open("wb", buffering=0) as file:
        for size in (1 << 22, 1 << 16, 1 << 12, 1):
            try:
                while True:
                    file.write(bytes(size))
            except OSError:
                continue


def main() -> None:
    folder, how, count, seed = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    training_run.stored_seeds = lambda *_, **__: film.seeds()
    chance = random.Random(seed)
    if how == "full":
        answer = by_full_disk(folder, count, chance)
    elif how == "kill":
        answer = by_kill(folder, count, chance, int(sys.argv[5]))
    else:
        answer = by_signal(folder, how.split(","), count, chance)
    print(json.dumps(answer))


if __name__ == "__main__":
    main()
