"""``frog train --events``: a training that another program follows and commands."""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
from support.builders import REPOSITORY

from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.events import event_of
from frog_blender.engine.training.session.output_paths import checkpoint_path

TRAIN = [sys.executable, "-m", "frog_blender.cli", "train"]
SMALL = ["--recipe", "draft", "--max-gaussians", "250", "--device", "cpu"]
PATIENCE = 300.0  # seconds


class Followed:
    """A training in a process of its own, and what it says."""

    def __init__(self, *options: object) -> None:
        command = [*TRAIN, *map(str, options), *SMALL, "--events"]
        pipe = subprocess.PIPE
        self.process = subprocess.Popen(command, cwd=REPOSITORY, stdin=pipe, stdout=pipe, stderr=pipe)
        assert self.process.stdin is not None and self.process.stdout is not None and self.process.stderr is not None
        self.input, self.output, self.errors = self.process.stdin, self.process.stdout, self.process.stderr

        self.patience = threading.Timer(PATIENCE, self.process.kill)
        self.patience.start()

    def events(self) -> Iterator[events.Event]:
        """All that follow; every line is one."""
        for line in self.output:
            event = event_of(line)
            assert event is not None, line
            yield event

    def send(self, line: str) -> None:
        self.input.write(f"{line}\n".encode())
        self.input.flush()

    def end(self) -> None:
        self.patience.cancel()
        self.process.kill()
        self.process.wait()
        for stream in (self.input, self.output, self.errors):
            stream.close()


@pytest.fixture
def follow(own_cache: Path) -> Iterator[type[Followed]]:
    begun: list[Followed] = []

    class Kept(Followed):
        def __init__(self, *options: object) -> None:
            super().__init__(*options)
            begun.append(self)

    yield Kept
    for training in begun:
        training.end()


def test_a_whole_training(follow: type[Followed], filmed: Path, tmp_path: Path) -> None:
    training = follow(filmed, "--out", tmp_path / "x.frog", "--steps", "12")
    said = list(training.events())
    assert training.process.wait() == 0
    kinds = {type(event) for event in said}
    assert {events.Started, events.Progress, events.Evaluated, events.Preview, events.Saved} <= kinds
    last = said[-1]
    assert isinstance(last, events.Finished) and (last.path, last.steps) == (str(tmp_path / "x.frog"), 12)
    assert last.phases and last.capacity["gaussians"] == last.gaussians
    assert read_scene(tmp_path / "x.frog").header.steps == 12


def test_it_pauses_and_ends_with_its_input(follow: type[Followed], filmed: Path, tmp_path: Path) -> None:
    training = follow(filmed, "--out", tmp_path / "x.frog", "--steps", "100000", "--end-with-input")
    stream = training.events()
    training.send("no such word")
    while not isinstance(next(stream), events.Progress):
        pass
    training.send("preview nobody")
    assert any(isinstance(event, events.WarningEvent) and "'nobody'" in event.message for event in stream)
    training.send("pause")
    while not checkpoint_path(tmp_path / "x.frog").is_file():  # before a pause what was learned goes to disk
        assert training.process.poll() is None
        time.sleep(0.02)
    training.send("resume")
    while not isinstance(next(stream), events.Progress):
        pass
    training.send("pause")
    training.input.close()
    last = list(stream)[-1]
    assert training.process.wait() == 3
    assert isinstance(last, events.Cancelled) and last.path == str(tmp_path / "x.frog") and last.step > 0
    assert read_scene(tmp_path / "x.frog").header.steps == last.step
