"""Rounds, ramps, the order of images, and time for which a process was stopped, which is no time of training."""

from collections import Counter

import pytest
import torch
from support.training_steps import Make

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.recipes import RECIPES, recipe
from frog_blender.engine.training.optimize import trainer as trainer_module
from frog_blender.engine.training.optimize.schedule import Every, ViewSampler, ramp, worked
from frog_blender.engine.training.optimize.training import Hook, Training


def rounds(every: Every, steps: int) -> list[int]:
    """Steps after which a round is due."""
    return [i for i in range(1, steps + 1) if every.due((i - 1) / steps, i / steps)]


@pytest.mark.parametrize("steps", [40, 200, 2000, 10_000, 12_345])
def test_rounds_are_as_many_in_any_training(steps: int) -> None:
    steps_due = rounds(Every(0.1, 0.6, 0.05), steps)
    assert 10 <= len(steps_due) <= 11  # whether the one at the very end counts is a matter of rounding
    assert steps_due[0] / steps == pytest.approx(0.1, abs=1.01 / steps)
    for index, step in enumerate(steps_due):
        assert step / steps == pytest.approx(0.1 + 0.05 * index, abs=1.01 / steps)


def test_ramp() -> None:
    assert [ramp(p, 0.2, 0.6) for p in (0.0, 0.2, 0.3, 0.5, 0.6, 1.0)] == pytest.approx([0, 0, 0.25, 0.75, 1, 1])
    assert [ramp(p, 0.3, 0.3) for p in (0.0, 0.29, 0.3, 0.5)] == [0, 0, 1, 1]
    assert ramp(0.0, 0.0, 0.0) == 1.0


def test_every_training_image_and_no_other_is_picked_about_as_often(capture: Capture) -> None:
    picker, generator = ViewSampler(capture), torch.Generator().manual_seed(0)
    counts = Counter(picker.pick(generator) for _ in range(18 * 60))
    assert sorted(counts) == capture.train_indices and len(counts) == 18
    assert min(counts.values()) > 30 and max(counts.values()) < 100


def test_a_scene_of_few_seeds_can_grow() -> None:
    """A share of a hundred would be nobody in a round of anchors, and no forest from a few in a density round."""
    standard = RECIPES["standard"]
    assert standard.num_new(100, 0.002, while_few=0.01) == 200
    assert standard.num_new(19_999, 0.03, while_few=1.0) == 20_000
    assert standard.num_new(20_000, 0.03, while_few=1.0) == 600


def test_more_frames_take_more_steps() -> None:
    standard = RECIPES["standard"]
    assert standard.steps_for(30) == standard.steps
    assert standard.steps_for(100) == 100 * standard.steps_per_moment > standard.steps
    assert RECIPES["draft"].steps_for(30) < standard.steps_for(30)


@pytest.mark.parametrize(
    ("name", "frames", "images", "rows"),
    [
        ("paper-exact", 300, 5700, 150),  # N3DV, as in E-D3DGS's own settings; the next is one of its HyperNeRF scenes
        ("hypernerf-exact", 164, 82, 82),
        ("technicolor-exact", 50, 750, 25),
        ("standard", 30, 300, 30),  # several cameras
        ("standard", 86, 75, 37),  # one, which sees each frame once
        ("standard", 5000, 50_000, 150),
        ("standard", 1, 1, 2),
    ],
)
def test_rows_follow_frames_and_images(name: str, frames: int, images: int, rows: int) -> None:
    assert recipe(name).temporal_rows_for(frames, images) == rows


@pytest.mark.parametrize(("rows", "share", "expected"), [(150, 0.2, 30), (250, 0.2, 50), (30, 0.0, 15), (150, 0.0, 30)])
def test_coarse_rows(rows: int, share: float, expected: int) -> None:
    settings = recipe("standard", coarse_share=share)
    assert settings.coarse_rows_for(rows) == expected
    assert settings.coarse_rows_for(2) == 2


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


def test_a_training_stopped_for_an_hour_takes_its_steps(make_trainer: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    trainer, clock = make_trainer(10), Clock()
    trainer.add_hook(Stopped(clock))
    monkeypatch.setattr(trainer_module, "time", clock)
    for _ in range(10):
        trainer.step()
    assert trainer.seconds == pytest.approx(9 * 0.01 + 0.5)
