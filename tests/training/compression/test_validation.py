"""What is measured by looking, the validation images that decide what may be left out, and the search for how much."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from support import synthetic_capture as film

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.rasterizer import GaussianArrays, rasterize
from frog_blender.engine.training.compression.sensitivity import (
    PIXELS_OF_A_CHANGE,
    SampledView,
    Sensitivity,
    measure,
    view_gradients,
)
from frog_blender.engine.training.compression.validation import largest_count_within, validation_shots
from frog_blender.engine.training.optimize.schedule import ViewSampler


def test_validation_images_are_training_images_spread_over_time(capture: Capture) -> None:
    capture = film.longer(capture, 40)
    shots = validation_shots(capture, 3)
    assert 4 <= len(shots) <= 8
    assert not any(capture.is_test(capture.shots[i]) for i in shots)
    frames = sorted(capture.shots[i].frame for i in shots)
    assert np.diff(frames).min() > 0 and frames[0] < 10 and frames[-1] > 30
    assert shots == validation_shots(capture, 3) != validation_shots(capture, 4)


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


@given(st.integers(0, 500), st.floats(0, 60), st.floats(1e-3, 1e3), st.floats(0.5, 4.0))
def test_the_search_never_allows_too_much(candidates: int, allowed: float, wrong: float, power: float) -> None:
    """However far from the truth what is expected is."""
    asked = []

    def loss(count: int) -> float:
        asked.append(count)
        return count**1.5 / 100

    count, cost = largest_count_within(loss, wrong * np.arange(1, candidates + 1) ** power, allowed)
    assert len(asked) == len(set(asked)) <= 6 and all(0 < count_asked <= candidates for count_asked in asked)
    assert cost <= allowed and (count == 0 or cost == count**1.5 / 100)


def test_validation_may_begin_within_a_burst(capture: Capture) -> None:
    """One camera: the excluded image was the only image of its time."""
    shots = tuple(shot for shot in film.longer(capture, 40).shots if shot.camera == 1)
    picker, generator = ViewSampler(replace(capture, shots=shots, frame_count=40)), torch.Generator().manual_seed(0)
    picker.exclude((5,))
    assert {picker.pick_same_frame(5, generator) for _ in range(30)}.isdisjoint({5})
    assert picker.pick_same_frame(6, generator) == 6


STATIC = len(film.gaussians_at(0)) - 12  # the wall; the ball's Gaussians come after it


def true_gaussians(frame: int) -> GaussianArrays:
    return film.gaussians_at(frame).mapped(lambda value: torch.tensor(value, dtype=torch.float32))


def at(time: float) -> GaussianArrays:
    return true_gaussians(round(time * (film.FRAMES - 1)))


def looks_of(capture: Capture, cameras: tuple[int, ...] = (1, 2, 3)) -> list[SampledView]:
    return [SampledView(camera, frame / (film.FRAMES - 1)) for camera in cameras for frame in range(film.FRAMES)]


def measured(capture: Capture, gaussians_at: Callable[[float], GaussianArrays]) -> Sensitivity:
    count = len(gaussians_at(0.0))
    return measure(gaussians_at, count, capture, looks_of(capture), torch.Generator().manual_seed(0))


def test_what_moves_scores_and_what_stands_does_not(capture: Capture) -> None:
    sensitivity = measured(capture, at)
    motion = sensitivity.motion
    assert float(motion.score[:STATIC].max()) == 0
    seen = sensitivity.contribution[STATIC:] > 0.05
    assert int(seen.sum()) > 4  # of the ball, those in front
    assert float(motion.score[STATIC:][seen].min()) > 1
    # It crosses 1.8 units at about 4.3 from the cameras, half of that to each side, and is nearly opaque.
    assert float(motion.score.max()) == pytest.approx(0.9 * film.FOCAL / 4.3, rel=0.4)


def test_the_state_is_the_mean_over_the_views(capture: Capture) -> None:
    state = measured(capture, at).state
    means = torch.stack([true_gaussians(frame).means for frame in range(film.FRAMES)]).mean(0)
    torch.testing.assert_close(state["means"], means)
    still = true_gaussians(0)
    torch.testing.assert_close(state["log_scales"].exp(), still.scales)
    torch.testing.assert_close(state["opacity_logits"].sigmoid(), still.opacities)
    torch.testing.assert_close(state["sh"], still.sh)


@pytest.mark.parametrize("kind", ["fades", "tints", "grows", "turns"])
def test_every_kind_of_change_is_seen(capture: Capture, kind: str) -> None:
    def changing(time: float) -> GaussianArrays:
        g = true_gaussians(0)
        if kind == "fades":
            g.opacities[5] *= 1 - 0.5 * time
        if kind == "tints":
            g.sh[5, 0] += time
        if kind == "grows":
            g.scales[5] *= 1 + time
        if kind == "turns":
            g.scales[5] = torch.tensor([0.4, 0.05, 0.05])
            g.quaternions[5] = torch.tensor([np.cos(time / 2), 0, 0, np.sin(time / 2)])
        return g

    motion = measured(capture, changing).motion
    assert float(motion.score[5]) > 0.5
    assert float(motion.score[:5].max()) == 0 == float(motion.score[6:].max())
    if kind == "fades":  # half of the range between 1 and 0.5, of 1
        weight = float(motion.score[5]) / PIXELS_OF_A_CHANGE / 0.25
        assert 0.2 < weight <= 0.91


def test_the_contribution_is_what_leaving_out_changes(capture: Capture) -> None:
    camera, generator, count = capture.cameras[1], torch.Generator().manual_seed(0), 300
    gaussians = true_gaussians(2)
    slopes = [view_gradients(gaussians, camera, (0.1, 0.2, 0.3), generator)[1]["opacities"] for _ in range(count)]
    squares = (torch.stack(slopes) * gaussians.opacities).square()
    whole = rasterize(gaussians, camera, (0.1, 0.2, 0.3)).rgb
    for index in (3, 40, 77, STATIC, STATIC + 5):
        keep = torch.arange(len(gaussians)) != index
        without = rasterize(gaussians.part(keep), camera, (0.1, 0.2, 0.3)).rgb
        change = float((whole - without).detach().square().sum())
        error = 4 * float(squares[:, index].std()) / count**0.5  # of the mean of random signs
        assert float(squares[:, index].mean()) == pytest.approx(change, abs=error + 1e-3 * change)


@pytest.mark.parametrize("name", ["means", "quaternions", "scales", "opacities", "sh"])
def test_the_rest_energy_is_what_standing_still_changes(capture: Capture, name: str) -> None:
    """Of one Gaussian alone, whose change is small enough for the first order."""
    index, looks = STATIC + 5, 2 * [SampledView(1, 0.0), SampledView(1, 1.0)]
    size = 0.05 if name == "quaternions" else 0.01

    def swinging(time: float, rests: bool = False) -> GaussianArrays:
        g = true_gaussians(2)
        g.scales[index] *= torch.tensor([1.0, 0.5, 0.7])
        way = torch.linspace(0.4, 1.0, getattr(g, name)[index].numel()).reshape(getattr(g, name)[index].shape)
        getattr(g, name)[index] += size * way * (0.0 if rests else 2 * time - 1)
        return g

    camera, draws = capture.cameras[1], torch.Generator().manual_seed(0)
    measurements = [measure(swinging, len(swinging(0)), capture, looks, draws).motion.rest_energy for _ in range(50)]
    energies = torch.stack(measurements)
    moves, rests = (
        [rasterize(swinging(time, still), camera, capture.background).rgb for time in (0.0, 1.0)]
        for still in (False, True)
    )
    change = float(np.mean([float((a - b).detach().square().sum()) for a, b in zip(moves, rests, strict=True)]))
    error = 4 * float(energies[:, index].std()) / len(measurements) ** 0.5  # of the mean of random signs
    assert change > 0
    assert float(energies[:, index].mean()) == pytest.approx(change, abs=error + 0.05 * change)
    assert float(energies[:, :index].max()) == 0
