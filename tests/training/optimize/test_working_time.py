"""Time for which a process was stopped is no time of training."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from frog_blender.engine.training.optimize import schedule
from frog_blender.engine.training.optimize import trainer as trainer_module
from frog_blender.engine.training.optimize.schedule import worked
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.optimize.training import Hook, Training


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
def test_what_counts(passed: float, computed: float, counted: float) -> None:
    assert worked(passed, computed) == pytest.approx(counted)


class Clock:
    """In the place of ``time``."""

    passed = computed = 100.0

    def perf_counter(self) -> float:
        return self.passed

    def process_time(self) -> float:
        return self.computed


class Stopped(Hook):
    """Says of each step that it took 0.01 s, and of the third that the process was stopped for an hour."""

    def __init__(self, clock: Clock) -> None:
        self._clock = clock

    def after_step(self, training: Training, before: float, now: float) -> None:
        self._clock.passed += 3600.0 if training.step_count == 3 else 0.01
        self._clock.computed += 0.01


def test_a_training_stopped_for_an_hour_takes_its_steps(
    make_trainer: Callable[..., Trainer], monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer, clock = make_trainer(10), Clock()
    trainer.add_hook(Stopped(clock))
    for module in (trainer_module, schedule):
        monkeypatch.setattr(module, "time", clock)
    for _ in range(10):
        trainer.step()
    assert trainer.seconds == pytest.approx(9 * 0.01 + 0.5)
