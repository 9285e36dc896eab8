"""Time for which a process was stopped is no time of training."""

from __future__ import annotations

import signal
from collections.abc import Callable

import pytest
from support.builders import run_python

from frog_blender.engine.training.optimize import working_time
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.optimize.working_time import worked_since


class Clocks:
    """What the system's clocks show."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.passed = self.computed = 100.0
        monkeypatch.setattr(working_time.time, "perf_counter", lambda: self.passed)
        monkeypatch.setattr(working_time.time, "process_time", lambda: self.computed)

    def go_on(self, passed: float, computed: float) -> None:
        self.passed += passed
        self.computed += computed


@pytest.mark.parametrize(
    ("passed", "computed", "counted"),
    [
        (0.02, 0.0, 0.02),  # processors' clocks of some systems are coarse
        (0.3, 0.05, 0.3),  # a busy computer
        (4.0, 4.1, 4.0),  # a round that takes long
        (4.0, 30.0, 4.0),  # on many cores
        (9.0, 0.05, 0.5),  # stopped
        (3600.0, 1.5, 1.5),  # a laptop that slept, in a round
    ],
)
def test_what_counts(monkeypatch: pytest.MonkeyPatch, passed: float, computed: float, counted: float) -> None:
    clocks = Clocks(monkeypatch)
    began = clocks.passed, clocks.computed
    clocks.go_on(passed, computed)
    assert worked_since(*began) == pytest.approx(counted)


def test_a_training_stopped_for_an_hour_takes_its_steps(
    make_trainer: Callable[..., Trainer], monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = make_trainer(10)
    clocks = Clocks(monkeypatch)
    step = trainer.optimizer.step

    def stopped() -> None:
        step()
        clocks.go_on(3600.0 if trainer.step_count == 3 else 0.01, 0.01)

    monkeypatch.setattr(trainer.optimizer, "step", stopped)
    for _ in range(10):
        trainer.step()
    assert trainer.seconds == pytest.approx(9 * 0.01 + 0.5)


@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="this system stops no process")
def test_a_process_that_is_really_stopped() -> None:
    code = """
import os, signal, time
from frog_blender.engine.training.optimize.working_time import worked_since
child = os.fork()
if child == 0:  # wakes its parent
    time.sleep(1.5)
    os.kill(os.getppid(), signal.SIGCONT)
    os._exit(0)
began = time.perf_counter(), time.process_time()
os.kill(os.getpid(), signal.SIGSTOP)
print(time.perf_counter() - began[0] - worked_since(*began))
os.waitpid(child, 0)
"""
    done = run_python(code)
    assert float(done.stdout) > 0.8, done.stderr
