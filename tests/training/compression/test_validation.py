"""The validation images that decide what may be left out, and the search for how much."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import synthetic_capture as film
from support.training_steps import compression, train

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.training.compression.validation import largest_count_within, validation_shots
from frog_blender.engine.training.optimize.schedule import ViewSampler
from frog_blender.engine.training.optimize.trainer import Trainer

Make = Callable[..., Trainer]


def test_validation_images_are_training_images_spread_over_time(capture: Capture) -> None:
    capture = film.longer(capture, 40)
    found = validation_shots(capture, 3)
    assert 4 <= len(found) <= 8
    assert not any(capture.is_test(capture.shots[i]) for i in found)
    frames = sorted(capture.shots[i].frame for i in found)
    assert np.diff(frames).min() > 0 and frames[0] < 10 and frames[-1] > 30
    assert found == validation_shots(capture, 3) != validation_shots(capture, 4)


def test_where_images_are_few_none_is_spared(capture: Capture) -> None:
    assert validation_shots(capture, 0) == ()


def test_validation_images_are_not_drawn(capture: Capture) -> None:
    capture = film.longer(capture, 10)
    excluded = validation_shots(capture, 0)
    picker, generator = ViewSampler(capture), torch.Generator().manual_seed(0)
    picker.exclude(excluded)
    assert excluded and not set(excluded) & {picker.pick(generator) for _ in range(400)}
    other = next(i for i, s in enumerate(capture.shots) if not capture.is_test(s) and i not in excluded)
    assert not set(excluded) & {picker.pick_same_frame(other, generator) for _ in range(50)}
    picker.exclude(())
    assert set(excluded) < {picker.pick(generator) for _ in range(400)}


def test_no_test_image_is_ever_looked_at(make_trainer: Make, watched: Callable, capture: Capture) -> None:
    store = watched()
    trainer = train(make_trainer(60, capacity="auto", watched=store))
    assert compression(trainer).log
    assert store.read and not any(capture.is_test(capture.shots[index]) for index in store.read)


@given(st.integers(0, 500), st.floats(0, 60), st.floats(1e-3, 1e3), st.floats(0.5, 4.0))
def test_the_search_never_allows_too_much(candidates: int, allowed: float, wrong: float, power: float) -> None:
    """However far from the truth what is expected is."""
    asked = []

    def loss(number: int) -> float:
        asked.append(number)
        return number**1.5 / 100

    number, cost = largest_count_within(loss, wrong * np.arange(1, candidates + 1) ** power, allowed)
    assert len(asked) == len(set(asked)) <= 6 and all(0 < each <= candidates for each in asked)
    assert cost <= allowed and (number == 0 or cost == number**1.5 / 100)


def test_validation_may_begin_within_a_burst(capture: Capture) -> None:
    """One camera: the excluded image was the only image of its time."""
    shots = tuple(shot for shot in film.longer(capture, 40).shots if shot.camera == 1)
    picker, generator = ViewSampler(replace(capture, shots=shots, frame_count=40)), torch.Generator().manual_seed(0)
    picker.exclude((5,))
    assert {picker.pick_same_frame(5, generator) for _ in range(30)}.isdisjoint({5})
    assert picker.pick_same_frame(6, generator) == 6
