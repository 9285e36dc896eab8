"""Whatever ends or kills a training, or takes its disk or memory, nothing that it learned is lost."""

import errno
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch
from support.builders import refused, run_python
from support.system_faults import can_mount
from support.training_steps import MakeJob, cancelled_at, warnings_of

from frog_blender.engine.errors import FrogError
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session import checkpoint, events, fallback_save
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.output_paths import checkpoint_path
from frog_blender.engine.training.session.run import run_training

STEPS = 60


@pytest.fixture
def task(make_job: MakeJob, tmp_path: Path) -> TrainingJob:
    return make_job(STEPS, {"output": tmp_path / "out" / "x.frog"})


@pytest.mark.parametrize("cancels", [False, True])
def test_frames_make_room_where_none_could_be_kept(
    task: TrainingJob, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, cancels: bool
) -> None:
    """In the end no image of them is held, however a training comes to it."""
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))  # other tests may still hold what they share
    write, asked = fallback_save.write_atomically, []

    def full_of_frames(path: Path, content: bytes) -> None:
        if any((tmp_path / "cache").rglob("image.tiles")):
            raise FrogError(f"{path}: full.") from OSError(errno.ENOSPC, "No space left on device")
        write(path, content)

    monkeypatch.setattr(fallback_save, "write_atomically", full_of_frames)
    stream = []
    for event in run_training(replace(task, event_seconds=0.0), lambda: bool(asked)):
        stream.append(event)
        if cancels and isinstance(event, events.Progress) and event.step > 0:
            asked.append(True)
    assert isinstance(stream[-1], events.Cancelled if cancels else events.Finished)
    assert "MB of decoded frames were deleted to free space." in warnings_of(stream)[-1] and task.output.is_file()


def test_no_folder_at_all_is_one_sentence(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    def full(*_: object) -> None:
        raise FrogError("x.frog: could not be written (No space left on device); nothing was changed.")

    monkeypatch.setattr(fallback_save, "write_atomically", full)
    refused("No space left", list, run_training(task))
    assert checkpoint_path(task.output).is_file(), "what was learned is there"


def test_rescued_scenes_do_not_overwrite_each_other(task: TrainingJob, own_cache: Path) -> None:
    ends = []
    for _ in range(2):
        for event in run_training(replace(task, overwrite=True)):
            if isinstance(event, events.Started):
                task.output.mkdir()  # where the scene is to lie
        ends.append(event)
        task.output.rmdir()
    assert [Path(end.path) for end in ends] == [own_cache / "rescued" / name for name in ("x.frog", "x-2.frog")]
    assert all(read_scene(end.path).header.steps == STEPS for end in ends)


def short_of_memory(most: int, error: Exception, where: str = "draw") -> type[Trainer]:
    """Trainers whose memory ends ``where`` there are more Gaussians than ``most``."""

    def limited(self: Trainer, *arguments: Any, **options: Any) -> Any:
        if self.count > most:
            raise error
        return getattr(Trainer, where)(self, *arguments, **options)

    return type("ShortOfMemory", (Trainer,), {where: limited})


@pytest.mark.parametrize(
    ("capacity", "error"),
    [
        ("fixed", torch.OutOfMemoryError("CUDA out of memory. Tried to allocate 2.00 GiB.")),
        ("auto", RuntimeError("[enforce fail at alloc_cpu.cpp:117] . DefaultCPUAllocator: can't allocate memory")),
        ("auto", MemoryError("the rasterizer's backward pass ran out of memory")),
    ],
    ids=["cuda", "torch", "native"],
)
def test_memory_that_ends_costs_gaussians_not_the_training(task: TrainingJob, error: Exception, capacity: str) -> None:
    task = replace(task, recipe=replace(task.recipe, capacity=capacity))
    stream = list(run_training(task, trainer_type=short_of_memory(330, error)))
    (warning,) = warnings_of(stream)
    assert "Out of memory at" in warning and "with at most" in warning
    end = stream[-1]
    assert isinstance(end, events.Finished) and end.steps == STEPS and 0 < end.gaussians <= 330


def test_a_training_with_fewer_gaussians_resumes(task: TrainingJob) -> None:
    short = short_of_memory(330, MemoryError("no more"))
    assert isinstance(cancelled_at(task, 50, short)[-1], events.Cancelled)
    end = list(run_training(replace(task, resume=True), trainer_type=short))[-1]
    assert isinstance(end, events.Finished) and end.gaussians <= 330


def test_memory_that_stays_short_ends_in_a_sentence(task: TrainingJob) -> None:
    short = short_of_memory(0, MemoryError("no more"))
    refused(r"Not enough memory.*smaller scale", list, run_training(task, trainer_type=short))


@pytest.mark.parametrize("where", ["evaluate", "render_image", "state"])
def test_memory_that_ends_between_steps_costs_gaussians_too(task: TrainingJob, where: str) -> None:
    """In an evaluation on the way or at the end, a preview, a copy of what was learned."""
    stream = list(run_training(task, trainer_type=short_of_memory(330, MemoryError("no more"), where)))
    assert any("Continuing from step" in warning for warning in warnings_of(stream))
    assert isinstance(stream[-1], events.Finished) and stream[-1].steps == STEPS and stream[-1].gaussians <= 330
    steps = [event.step for event in stream if isinstance(event, events.Evaluated)]
    assert steps == sorted(set(steps)), "no evaluation is told twice"


def test_a_checkpoint_without_memory_costs_nothing_else(task: TrainingJob, monkeypatch: pytest.MonkeyPatch) -> None:
    def none_left(*_: object, **__: object) -> bytes:
        raise MemoryError

    monkeypatch.setattr(checkpoint, "serialize", none_left)
    stream = list(run_training(task))
    (warning,) = warnings_of(stream)
    assert warning.endswith("out of memory); nothing was changed. Training continues without this checkpoint.")
    assert isinstance(stream[-1], events.Finished) and ScenePlayer.load(task.output).header.steps == STEPS


def test_memory_that_really_ends_is_recognised() -> None:
    """torch's own words when the system refuses memory, in a process that may not have much."""
    code = """
import resource, torch
from frog_blender.engine.training.session.recovery import is_out_of_memory
resource.setrlimit(resource.RLIMIT_AS, (8 << 30, 8 << 30))
try:
    torch.ones(4 << 30)
except BaseException as error:
    print(is_out_of_memory(error))
"""
    pytest.importorskip("resource")
    done = run_python(code)
    assert done.stdout.strip() == "True", done.stderr


class Broken(Trainer):
    def step(self) -> None:
        if self.step_count == 50:
            raise ZeroDivisionError("a mistake of ours")
        super().step()


def test_what_nobody_foresaw_keeps_what_was_learned(task: TrainingJob) -> None:
    with pytest.raises(ZeroDivisionError):
        list(run_training(task, trainer_type=Broken))
    stream = list(run_training(replace(task, resume=True)))
    steps = [event.step for event in stream if isinstance(event, events.Progress)]
    assert isinstance(stream[-1], events.Finished) and steps[0] > 40


def test_what_a_killed_training_left_unfinished_is_removed(task: TrainingJob) -> None:
    task.output.parent.mkdir()
    others = task.output.parent / ".y.frog.abc.part"
    for path in (task.output.parent / ".x.frog.abc.part", task.output.parent / ".x.frog.checkpoint.d.part", others):
        path.write_bytes(b"half a file")
    list(run_training(task))
    assert {path.name for path in task.output.parent.iterdir()} == {others.name, "x.frog", "x.frog.checkpoint"}


pytestmark = pytest.mark.skipif(not hasattr(os, "fork"), reason="processes are forked to be ended")
SCRIPT = Path(__file__).parents[2] / "support" / "ended_trainings.py"
ON_A_SMALL_DISK = 'mount -t tmpfs -o size=264m tmpfs "$1" && shift && exec "$@"'


def answer_of(filmed: Path, folder: Path, *arguments: object, disk: Path | None = None) -> dict[str, int]:
    """What ``ended_trainings`` says of the trainings that it ended; on a small disk where one is given."""
    (folder / "capture").symlink_to(filmed)
    command = [sys.executable, str(SCRIPT), str(folder), *map(str, arguments)]
    environment = {**os.environ, "FROG_CACHE": str((disk or folder) / "cache"), "OMP_NUM_THREADS": "1"}
    if disk:
        disk.mkdir()
        command = ["unshare", "-rm", "sh", "-c", ON_A_SMALL_DISK, "sh", str(disk), *command]
        environment["TMPDIR"] = str(disk / "tmp")
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=3000, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


def test_who_asks_a_training_to_end_gets_its_scene(filmed: Path, tmp_path: Path) -> None:
    assert answer_of(filmed, tmp_path, "TERM,HUP,INT", 3, 3)["ended"] == 3


@pytest.mark.skipif(not can_mount(), reason="this system does not let its users mount a small file system")
def test_the_one_disk_that_fills_up_costs_no_scene(filmed: Path, tmp_path: Path) -> None:
    answer = answer_of(filmed, tmp_path, "full", 2, 3, disk=tmp_path / "disk")
    assert answer == {"cancelled": 1, "finished": 1, "elsewhere": 0}


@pytest.mark.parametrize(("kills", "steps"), [(3, 100), pytest.param(200, 1500, marks=pytest.mark.slow)])
def test_kills(filmed: Path, tmp_path: Path, kills: int, steps: int) -> None:
    answer = answer_of(filmed, tmp_path, "kill", kills, 1, steps)
    assert answer["kills"] >= kills and answer["resumes"] > 0
