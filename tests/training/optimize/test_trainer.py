"""A whole training in miniature: what it begins with, that it learns, repeats, and never looks at what is held out."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any
from unittest.mock import create_autospec

import numpy as np
import pytest
import torch
from support import synthetic_capture as film
from support.builders import scene_file
from support.training_steps import Make, bits, compression, train

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.seeds import Seeds
from frog_blender.engine.evaluation.evaluate import TrueImages, evaluate_images
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.model.interface import SceneModel, ScheduleState
from frog_blender.engine.options import JobOptions
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.rasterizer import RasterizeOptions
from frog_blender.engine.recipes import RECIPES, Recipe, recipe
from frog_blender.engine.registry import METHODS
from frog_blender.engine.training.compression.sensitivity import sample_views
from frog_blender.engine.training.optimize import losses, neighbours
from frog_blender.engine.training.optimize.densification import DensificationStrategy
from frog_blender.engine.training.optimize.initialization import first_model
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.run import add_hooks

STEPS = 600


@pytest.fixture(scope="module")
def trained(make_trainer: Make) -> dict[str, Trainer]:
    return {method: train(make_trainer(STEPS, method)) for method in ("frog", "static")}


def moving_psnr(trainer: Trainer, store: FrameStore, camera: int) -> float:
    """Over the pixels of one camera that clearly change in time."""
    shots = [i for i, shot in enumerate(trainer.capture.shots) if shot.camera == camera]
    truth = np.stack([store.image(i) / 255.0 for i in shots])
    drawn = np.stack([trainer.render_image(i) for i in shots])
    mask = truth.std(0).max(-1) > 15 / 255
    assert 0.1 < mask.mean() < 0.6
    return -10 * float(np.log10(((truth - drawn)[:, mask] ** 2).mean()))


def test_the_loss_falls(make_trainer: Make, trained: dict[str, Trainer]) -> None:
    for method, trainer in trained.items():
        early = train(make_trainer(STEPS, method), until=10).loss
        assert trainer.loss < 0.5 * early, method
        assert trainer.step_count == STEPS and trainer.progress == 1.0 and trainer.seconds > 0


@pytest.mark.parametrize("camera", range(4), ids=["held out", "first", "second", "third"])
def test_what_moves_is_followed(trained: dict[str, Trainer], store: FrameStore, camera: int) -> None:
    """Static Gaussians can only smear the ball."""
    frog, static = (moving_psnr(trained[method], store, camera) for method in ("frog", "static"))
    assert frog > static + 3
    assert frog > 19


@pytest.mark.parametrize(
    "method", ["curves", *(pytest.param(method, marks=pytest.mark.slow) for method in ("d3dgs", "hexplane"))]
)
def test_baselines_follow_what_moves(
    make_trainer: Make, trained: dict[str, Trainer], store: FrameStore, method: str
) -> None:
    baseline = train(make_trainer(STEPS, method))
    for camera in (0, 2):
        assert moving_psnr(baseline, store, camera) > moving_psnr(trained["static"], store, camera) + 1.5


def test_the_same_seed_gives_the_same_bits_and_another_seed_others(make_trainer: Make) -> None:
    first, second, other = (bits(train(make_trainer(50, seed=seed))) for seed in (4, 4, 5))
    assert first == second
    assert first["model.canonical.means"] != other["model.canonical.means"]
    assert first["random"] != other["random"]


@pytest.mark.parametrize("method", ["frog", "hexplane"])
def test_torchs_own_random_numbers_are_neither_used_nor_changed(make_trainer: Make, method: str) -> None:
    learned = []
    for state in (1, 2):
        torch.manual_seed(state)
        before = torch.get_rng_state()
        learned.append(bits(train(make_trainer(12, method))))
        assert torch.equal(torch.get_rng_state(), before)
    assert learned[0] == learned[1]


def test_number_of_threads_does_not_change_the_training(
    make_trainer: Make, set_thread_count: Callable[[int], None]
) -> None:
    learned = []
    for threads in (1, 3):
        set_thread_count(threads)
        learned.append(bits(train(make_trainer(40))))
    assert learned[0] == learned[1]


def test_no_held_out_image_is_ever_read(watched: Any, capture: Capture, lively: Any) -> None:
    capture = capture.with_holdout(3)
    trainer = Trainer(capture, watched, film.seeds(), lively(150, capacity="auto"), JobOptions(steps=150))
    add_hooks(trainer)
    assert compression(train(trainer)).log
    held_out = {i for i, shot in enumerate(capture.shots) if capture.is_test(shot)}
    assert len(held_out) == 6 + 2 * 3
    assert set(watched.read) == set(range(24)) - held_out


def test_evaluation_looks_at_held_out_images_and_changes_nothing(make_trainer: Make, watched: Any) -> None:
    undisturbed = train(make_trainer(60))
    trainer = make_trainer(60, watched=watched)
    while not trainer.finished:
        trainer.step()
        if trainer.step_count % 7 == 0:
            before = len(watched.read)
            psnr, split = trainer.evaluate(4)
            assert split == "held-out" and 5 < psnr < 50
            assert all(trainer.capture.is_test(trainer.capture.shots[i]) for i in watched.read[before:])
            trainer.render_image(3)
    assert bits(trainer) == bits(undisturbed)


def test_evaluation_without_held_out_images(capture: Capture, store: FrameStore, lively: Any) -> None:
    everything = replace(capture, test_cameras=frozenset())
    trainer = Trainer(everything, store, film.seeds(), lively(5), JobOptions(steps=5))
    assert trainer.evaluate(3)[1] == "training"


class Watched(Trainer):
    """Remembers degrees, schedules and how many anchors were added."""

    def __init__(self, *arguments: Any, **options: Any) -> None:
        self.degrees: set[int] = set()
        self.states: list[ScheduleState] = []
        self.anchors = 0
        super().__init__(*arguments, **options)

    def draw(self, shot_index: int, progress: float, options: RasterizeOptions, *more: Any) -> Any:
        truth, drawn = super().draw(shot_index, progress, options, *more)
        self.degrees.add(drawn.gaussians.sh_degree)
        return truth, drawn

    def schedule_state(self, progress: float | None = None) -> ScheduleState:
        self.states.append(super().schedule_state(progress))
        return self.states[-1]

    def inject_anchors(self, progress: float, shot: int) -> None:
        before = self.count
        super().inject_anchors(progress, shot)
        self.anchors += self.count - before


def watched_call(monkeypatch: pytest.MonkeyPatch, owner: Any, name: str) -> Any:
    """A function or method, which does what it did and keeps how it was called."""
    real = getattr(owner, name)
    monkeypatch.setattr(owner, name, mock := create_autospec(real, side_effect=real))
    return mock


def test_a_short_training_passes_through_every_schedule(make_trainer: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    rounds: list[tuple[int, int]] = []
    density_round = DensificationStrategy.round

    def watch_round(*arguments: Any) -> Any:
        rounds.append(density_round(*arguments))
        return rounds[-1]

    trainer = make_trainer(120, sh_degree=3, deformed_sh=4, densify_threshold=1e-5, trainer_type=Watched)
    monkeypatch.setattr(DensificationStrategy, "round", watch_round)
    ssim = watched_call(monkeypatch, losses, "native_ssim")
    add_gradient = watched_call(monkeypatch, neighbours.NeighbourGraph, "add_gradient")
    start = trainer.count
    train(trainer)
    r = trainer.recipe
    fine, opacity = [state.fine_rows for state in trainer.states], [state.opacity for state in trainer.states]
    assert trainer.degrees == {0, 1, 2, 3}
    assert min(opacity) == 0 and max(opacity) == 1 and len(set(opacity)) > 5
    assert max(fine) == 1
    expected = int((r.densify_until - r.densify_from) / r.densify_every) + 1
    assert expected - 1 <= len(rounds) <= expected
    assert sum(new for new, _ in rounds) > 0
    assert trainer.anchors > 0
    assert trainer.count > start
    bursts = sum(r.dssim_from <= i / 120 and i % r.dssim_period < r.dssim_burst for i in range(120))
    assert ssim.call_count == bursts > 0
    assert add_gradient.call_count > 15  # every fourth step
    assert trainer.smoothness.graph is not None and int(trainer.smoothness.graph.neighbours.max()) < trainer.count


def test_at_the_limit_anchors_take_the_places_of_those_least_needed(make_trainer: Make) -> None:
    trainer = make_trainer(60, densify_until=0.0, max_gaussians=1, sampling_share=0.1)  # more are there already
    train(trainer, until=20)
    count = trainer.count
    means = trainer.model.canonical.means
    trainer.inject_anchors(0.5, 0)  # all were needed of late
    assert trainer.model.canonical.means is means
    trainer.density.peak_weight[[2, 5]] = 0.01
    before = means.detach().clone()
    trainer.smoothness.resample()
    pairs = trainer.smoothness.graph
    trainer.inject_anchors(0.5, 0)
    assert trainer.count == count
    sample = trainer.smoothness.graph
    assert {2, 5} <= set(pairs.neighbours[pairs.weights > 0].tolist())
    assert not {2, 5} & {*sample.anchors.tolist(), *sample.neighbours[sample.weights > 0].tolist()}
    kept = [i for i in range(count) if i not in (2, 5)]
    torch.testing.assert_close(trainer.model.canonical.means[kept].detach(), before[kept])
    assert not (trainer.model.canonical.means[[2, 5]].detach() == before[[2, 5]]).any()
    assert trainer.density.peak_weight.tolist() == [1.0] * count


def test_a_burst_stays_at_one_frame_and_changes_the_camera(make_trainer: Make, watched: Any) -> None:
    trainer = make_trainer(200, watched=watched, dssim_period=10, dssim_burst=5, dssim_from=0.0, sampling="off")
    train(trainer)
    shots = [trainer.capture.shots[i] for i in watched.read[-200:]]  # exposures looked at some before
    bursts = [shots[start : start + 5] for start in range(0, 200, 10)]
    assert all(len({shot.frame for shot in burst}) == 1 for burst in bursts)
    assert len({shot.frame for burst in bursts for shot in burst}) > 3
    assert any(len({shot.camera for shot in burst}) > 1 for burst in bursts)


def test_seconds_limit_a_training(capture: Capture, store: FrameStore, lively: Any) -> None:
    trainer = Trainer(capture, store, film.seeds(), lively(10**6), JobOptions(seconds=0.3))
    train(trainer)
    assert trainer.finished and trainer.seconds >= 0.3 and 0 < trainer.step_count < 10**5


def test_one_seed_is_enough(capture: Capture, store: FrameStore, lively: Any) -> None:
    trainer = Trainer(capture, store, film.seeds(1), lively(60), JobOptions(steps=60))
    train(trainer)
    assert np.isfinite(trainer.loss) and trainer.count >= 1


LATE = 0.25  # frames


@pytest.fixture
def late(capture: Capture) -> Capture:
    return replace(capture, shots=tuple(replace(shot, offset=LATE) for shot in capture.shots))


def time_of(frame: float) -> float:
    return min(frame, film.FRAMES - 1) / (film.FRAMES - 1)


def test_training_draws_the_scene_as_it_was(
    lively: Callable[..., Recipe], late: Capture, store: FrameStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    trainer = Trainer(late, store, film.seeds(), lively(20), JobOptions(steps=20))
    draw, deform = (watched_call(monkeypatch, *of) for of in ((trainer.model, "draw"), (trainer, "deform")))
    shots = late.train_indices[:5]
    for shot in shots:
        trainer.draw(shot, 1.0, RasterizeOptions())
        trainer.render_image(shot, 16)
    times = [time_of(late.shots[shot].frame + LATE) for shot in shots]
    assert [call.args[0] for call in draw.call_args_list] == [call.args[0] for call in deform.call_args_list] == times


def test_what_is_seen_is_sampled_around_the_times_of_the_images(late: Capture) -> None:
    shots = [index for index, shot in enumerate(late.shots) if shot.frame == 3]
    views = sample_views(late, shots, 400, torch.Generator().manual_seed(0))
    times = [view.time * (film.FRAMES - 1) for view in views]
    assert 3.25 - 0.5 <= min(times) < 2.8 and 3.7 < max(times) <= 3.25 + 0.5


def test_evaluation_draws_the_scene_as_it_was(
    late: Capture, store: FrameStore, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = ScenePlayer(scene_file())
    header = replace(scene.header, cameras=late.cameras, test_cameras=tuple(late.test_cameras), test_frames=())
    scene.header = replace(header, camera_shots=((),) * len(late.cameras), frame_count=late.frame_count)
    at = watched_call(monkeypatch, scene, "at")
    evaluate_images(scene, TrueImages(late, store), split="held-out")
    times = [time_of(shot.frame + LATE) for shot in filter(late.is_test, late.shots)]
    assert [call.args[0] for call in at.call_args_list] == times


LAST = film.FRAMES - 1


def timed_seeds() -> Seeds:
    """Of 300 points, the last twenty are there at the last frame."""
    frames = np.full(300, np.nan, np.float32)
    frames[280:] = LAST
    return replace(film.seeds(), frames=frames)


def begun(capture: Capture, seeds: Seeds, method: str = "frog", **settings: bool) -> SceneModel:
    torch.manual_seed(0)
    chosen = METHODS[method].adapted(recipe("draft", **{"moment_seeds": True} | settings))
    return first_model(capture, seeds, chosen, method, 4.0, torch.device("cpu"))


@pytest.mark.parametrize("method", METHODS)
def test_every_method_begins_with_them(capture: Capture, method: str) -> None:
    """Those that know when a Gaussian is there show them then alone, and all the others at all times."""
    model = begun(capture, timed_seeds(), method)
    with torch.no_grad():
        first, last = (model.deform(time)[0].opacities for time in (0.0, 1.0))
    assert bool((first[280:] < 0.3 * last[280:]).all()) == (method in ("frog", "curves"))
    assert (first[:280] > 0.3 * last[:280]).all()
    assert METHODS[method].adapted(recipe("draft")).size_limit == recipe("draft").size_limit


def test_who_has_points_at_how_many_times() -> None:
    chosen = recipe("draft", moment_seeds=True)
    assert chosen.moments_for(30, 330) == 8  # of 15 coarse rows
    assert chosen.moments_for(300, 6000) == 15
    assert chosen.moments_for(2, 40) >= 2
    none: list[dict[str, Any]] = [
        {"moment_seeds": False},
        {"modulation": False},
        {"deformed_opacity": False},
        {"fusion": "dual"},
        {"head_width": 64},
        {"temporal_size": 32},
    ]
    assert not any(replace(chosen, **change).moments_for(30, 330) for change in none)
    for method in METHODS:
        adapted = METHODS[method].adapted(Recipe(moment_seeds=True))
        assert bool(adapted.moments_for(30, 330)) == (method in ("frog", "curves"))
    assert {name for name, settings in RECIPES.items() if settings.moments_for(30, 330)} == {"draft", "standard"}
