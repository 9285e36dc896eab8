"""Whatever is kept by Gaussian follows every change of the rows; where Gaussians stand, and how large they may be."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import torch
from support import synthetic_capture as film
from support.builders import odd_camera, steps_between
from support.training_steps import Make, compression, state_of_dynamic, train

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.cuda import launch
from frog_blender.engine.gaussians import LOW_PASS
from frog_blender.engine.model.canonical import CanonicalField, new_gaussians
from frog_blender.engine.recipes import recipe
from frog_blender.engine.scene import quantization
from frog_blender.engine.training.compression import passes
from frog_blender.engine.training.compression.budget import keep_within
from frog_blender.engine.training.optimize.gaussian_state import (
    LeastSizes,
    Reindexing,
    add_size_gradient,
    freeze_motion,
    limit_sizes,
    morton_order,
    pixel_sizes,
    sort_by_morton_code,
)
from frog_blender.engine.training.optimize.near_pruning import NearPruning
from frog_blender.engine.training.optimize.stateful import Tensors, Values
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.optimize.training import Hook, Training
from frog_blender.engine.training.session.checkpoint import restore, state_of
from frog_blender.engine.training.session.export import remove_non_finite
from frog_blender.engine.training.session.recovery import Recovery

NEW = -1.0


class Labels:
    """A label for every Gaussian, all of them and the dynamic ones alone, and the means that they had."""

    def __init__(self, trainer: Trainer) -> None:
        gaussians = trainer.gaussians
        self.all = torch.arange(float(gaussians.count))
        self.dynamic = self.all[: gaussians.num_dynamic].clone()
        self.colors = gaussians.canonical.sh.detach()[:, 0].clone()
        self.changes = 0
        gaussians.register(self.reindex)

    def reindex(self, change: Reindexing) -> None:
        self.changes += 1
        assert (len(self.all), len(self.dynamic)) == (change.count, change.num_dynamic)
        fresh = torch.tensor([NEW])
        self.all = torch.cat([self.all, fresh])[change.indices.clamp(max=change.count)]
        self.dynamic = torch.cat([self.dynamic, fresh])[change.dynamic.clamp(max=change.num_dynamic)]

    def check(self, trainer: Trainer, frozen: bool = False) -> None:
        """Each label is where its Gaussian is, whose colour no operation changes but freezing."""
        gaussians = trainer.gaussians
        assert self.changes > 0
        assert (len(self.all), len(self.dynamic)) == (gaussians.count, gaussians.num_dynamic)
        old = self.dynamic != NEW
        assert torch.equal(self.dynamic[old], self.all[: len(old)][old])
        kept = self.all != NEW
        if not frozen:
            torch.testing.assert_close(gaussians.canonical.sh.detach()[kept, 0], self.colors[self.all[kept].long()])


def grow(trainer: Trainer) -> None:
    trainer.density.gradient_sum += 1.0
    trainer.density.seen += 1.0
    trainer.density.peak_opacity[:5] = 0.0
    trainer.density.round(trainer.gaussians, trainer.count + 50, trainer.generator)


def prune_by_images(trainer: Trainer) -> None:
    context, generator = compression(trainer), torch.Generator().manual_seed(0)
    evaluator, measured = context.evaluator(), context.measure(context.sample_views(generator, 4), generator)
    context.compress(evaluator, passes.prune(context, evaluator, measured))


def spoil(trainer: Trainer) -> None:
    trainer.gaussians.canonical.means.data[[4, 9]] = torch.nan
    remove_non_finite(trainer.gaussians)


OPERATIONS: dict[str, Callable[[Trainer], object]] = {
    "densification": grow,
    "anchors": lambda trainer: trainer.inject_anchors(0.5, 8),
    "sorting": lambda trainer: sort_by_morton_code(trainer.gaussians),
    "freezing": lambda trainer: freeze_motion(trainer.gaussians, torch.arange(3, 90), state_of_dynamic(trainer)),
    "pruning": prune_by_images,
    "a budget": lambda trainer: keep_within(compression(trainer), trainer.count - 7),
    "out of memory": lambda trainer: Recovery(trainer).rollback(MemoryError()),
    "broken Gaussians": spoil,
}


@pytest.mark.parametrize("operation", OPERATIONS)
def test_every_follower_follows_every_operation(make_trainer: Make, operation: str) -> None:
    trainer = train(make_trainer(60, capacity="auto", sampling_share=0.05), until=20)
    labels = Labels(trainer)
    OPERATIONS[operation](trainer)
    labels.check(trainer)
    trainer.step()


def test_a_follower_follows_a_whole_training(make_trainer: Make) -> None:
    trainer = make_trainer(60, capacity="auto", sampling_share=0.05)
    labels = Labels(trainer)
    train(trainer)
    assert labels.changes > 20
    labels.check(trainer, frozen=True)


class Counting(Hook):
    """Counts steps and milestones."""

    def __init__(self) -> None:
        self.steps = self.milestones = 0

    def after_step(self, training: Training, before: float, now: float) -> None:
        self.steps += 1

    def before_milestone(self) -> None:
        self.milestones += 1

    def allows_growth(self, progress: float) -> bool:
        return False

    def validation_at(self, progress: float) -> tuple[int, ...]:
        return (8,)

    def state(self) -> tuple[Tensors, Values]:
        return {}, {"counted": self.steps}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        self.steps = values["counted"]


def test_a_hook_is_called_asked_and_saved(make_trainer: Make, watched: Any) -> None:
    trainer, hook = make_trainer(40, capacity="auto", watched=watched, sampling="off"), Counting()
    watched.read.clear()
    trainer.add_hook(hook)
    count = trainer.count
    train(trainer, until=20)
    assert (hook.steps, hook.milestones, trainer.count) == (20, 0, count)
    assert 8 not in watched.read[1:]  # from the second step on
    other = make_trainer(40, capacity="auto", sampling="off")
    other.add_hook(again := Counting())
    restore(other, state_of(trainer))
    assert again.steps == 20
    train(trainer, until=33)
    assert hook.milestones == 1


def test_rest_is_the_same_at_all_times_and_moves_no_one_else(make_trainer: Make) -> None:
    trainer = train(make_trainer(100), until=50)
    count, who = trainer.count, torch.tensor([3, 10, 11, 200])
    before, state = trainer.deform(0.3)[0], {n: v + 0.01 for n, v in state_of_dynamic(trainer).items()}
    memory = trainer.optimizer.adam.state[trainer.model.canonical.means]["exp_avg"].clone()
    freeze_motion(trainer.gaussians, who, state)
    canonical = trainer.model.canonical
    assert (trainer.count, canonical.num_dynamic) == (count, count - 4)
    others = torch.tensor([i for i in range(count) if i not in who.tolist()])
    for time in (0.3, 0.9):
        after = trainer.deform(time)[0]
        torch.testing.assert_close(after.means[count - 4 :], state["means"][who])
        torch.testing.assert_close(after.scales[count - 4 :], state["log_scales"][who].exp())
    after = trainer.deform(0.3)[0]
    torch.testing.assert_close(after.means[: count - 4], before.means[others])
    torch.testing.assert_close(after.opacities[: count - 4], before.opacities[others])
    now = trainer.optimizer.adam.state[canonical.means]["exp_avg"]
    torch.testing.assert_close(now, memory[torch.cat([others, who])])
    assert trainer.smoothness.graph is None or int(trainer.smoothness.graph.neighbours.max()) < canonical.num_dynamic
    train(trainer)
    assert torch.isfinite(trainer.model.canonical.means).all()


def test_a_training_leaves_neighbours_together(make_trainer: Make) -> None:
    canonical = train(make_trainer(100, capacity="auto")).model.canonical
    means = canonical.means.detach()[: canonical.num_dynamic].numpy()
    order = torch.randperm(len(means), generator=torch.Generator().manual_seed(1)).numpy()
    assert steps_between(means) < 0.7 * steps_between(means[order])


@pytest.mark.parametrize("count", [0, 1, 2, 101, 4000])
def test_the_order_is_the_one_that_files_have(count: int) -> None:
    means = np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32)
    means[17:18] = 1e6
    np.testing.assert_array_equal(morton_order(torch.from_numpy(means)), quantization.morton_order(means))


def canonical_field() -> CanonicalField:
    points, colors = (torch.from_numpy(array) for array in (film.seeds().points, film.seeds().colors))
    spacings = torch.linspace(0.01, 0.3, len(points))
    return CanonicalField(new_gaussians(points, colors, spacings, 1, 0))


def test_the_gradient_is_that_of_the_mean_size() -> None:
    canonical, unit, weight = canonical_field(), 2.5, 0.3
    (expected,) = torch.autograd.grad(weight * canonical.log_scales.exp().mean() / unit, canonical.log_scales)
    before = torch.randn_like(canonical.log_scales)
    canonical.log_scales.grad = before.clone()
    add_size_gradient(canonical, weight, unit)
    torch.testing.assert_close(canonical.log_scales.grad, before + expected)


def test_no_axis_is_longer_than_a_share_of_the_distance_to_the_nearest_training_camera(capture: Capture) -> None:
    canonical = canonical_field()
    trained = sorted({shot.camera for shot in capture.train_shots})
    assert len(trained) < len(capture.cameras)  # one is held out, and says nothing
    centers = np.array([capture.cameras[index].center for index in trained])
    means = canonical.means.detach().numpy()
    nearest = np.linalg.norm(means[:, None] - centers[None], axis=2).min(1)
    before = canonical.log_scales.detach().exp().numpy().copy()
    limited = np.minimum(before, 0.02 * nearest[:, None])
    assert (limited < before).any() and (limited == before).any()
    limit_sizes(canonical, capture, 0.02, 1e-3)
    np.testing.assert_allclose(canonical.log_scales.detach().exp().numpy(), limited, rtol=1e-5)


def test_what_lies_in_a_camera_keeps_a_size(capture: Capture) -> None:
    canonical = canonical_field()
    camera = capture.cameras[capture.train_shots[0].camera]
    canonical.means.data[0] = torch.from_numpy(camera.center).float()
    limit_sizes(canonical, capture, 0.1, 0.5)
    sizes = canonical.log_scales.detach()[0].exp()
    assert (sizes > 0).all() and (sizes <= 0.05 + 1e-6).all()


def test_nothing_stays_thinner_than_its_share_of_a_pixel(make_trainer: Make, capture: Capture) -> None:
    trainer = make_trainer(20, least_size=0.5)
    canonical, least = trainer.gaussians.canonical, trainer.least_sizes
    assert isinstance(least, LeastSizes)
    canonical.log_scales.data[::2, 1] -= 20
    before = canonical.log_scales.detach().clone()
    cameras = [capture.cameras[index] for index in capture.train_cameras]
    bounds = (0.5 * pixel_sizes(canonical.means.detach(), cameras)).log()
    least.apply()
    torch.testing.assert_close(canonical.log_scales.detach(), torch.maximum(before, bounds[:, None]))
    canonical.log_scales.data[1::2, 2] -= 20
    train(trainer, until=1)
    assert (canonical.log_scales.detach() >= bounds[:, None]).all()


@pytest.mark.parametrize("gpu", [False, True])
def test_a_pixel_is_measured_in_the_camera_that_sees_it_finest(gpu: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(launch, "on_gpu", lambda _: gpu)
    camera = odd_camera(320, 240)
    zoomed = replace(camera, intrinsics=np.diag([3.0, 3.0, 1.0]) @ camera.intrinsics).cropped(200, 100, 500, 400)
    pixels = np.random.default_rng(0).random((60, 2)) * [320, 240]
    means = camera.unproject(pixels, np.linspace(1, 9, 60)).astype(np.float32)
    means[0] = camera.center - 3 * camera.forward  # behind both
    focal, depths = camera.intrinsics[:2, :2].max(), camera.project(means.astype(np.float64))[1]
    finer, _ = zoomed.project(means.astype(np.float64))
    is_finer = ((finer >= 0) & (finer <= [500, 400])).all(axis=1) & (depths > 0)
    assert 5 < is_finer.sum() < 55
    expected = np.where(is_finer, depths / (3 * focal), depths / focal)
    expected[0] = 3 / (3 * focal)  # of the nearest, which has the smallest pixels
    sizes = pixel_sizes(torch.from_numpy(means), [camera, zoomed])
    np.testing.assert_allclose(sizes, expected, rtol=1e-4)


def test_the_paper_widens_as_3dgs_does_and_keeps_no_size(make_trainer: Make) -> None:
    paper = recipe("paper-exact")
    assert (paper.low_pass, paper.least_size) == (LOW_PASS, 0) == (0.3, 0)
    trainer = make_trainer(5, least_size=paper.least_size, low_pass=paper.low_pass)
    assert trainer.least_sizes is None and trainer.model.deform(0.5)[0].low_pass == LOW_PASS


def test_nothing_hangs_right_before_a_camera(make_trainer: Make, capture: Capture) -> None:
    trainer = make_trainer(20)
    camera = capture.cameras[capture.train_cameras[0]]
    ahead, beside = camera.rotation[2], camera.rotation[0]
    seeds = film.seeds(300).points
    nearest = np.linalg.norm(seeds - camera.center, axis=1).min()
    places = {
        "right before it": 0.3 * nearest * ahead,
        "before one that stands beside it": 0.3
        * nearest
        * (ahead + 0.8 * camera.width / camera.intrinsics[0, 0] * beside),
        "behind it": -0.3 * nearest * ahead,
        "where its wall may be": 0.3 * nearest * beside,
        "before the seeds": 0.7 * nearest * ahead,
    }
    means = trainer.gaussians.canonical.means.data
    means[:] = torch.from_numpy(seeds[0])
    means[: len(places)] = torch.from_numpy(np.array([*places.values()]) + camera.center).float()
    colors = trainer.gaussians.canonical.sh.detach()[:, 0].clone()
    other = trainer.gaussians.canonical.means.detach().clone()
    NearPruning(capture, seeds, 0.4).prune(trainer.gaussians, capture)
    left = {
        name
        for name, place in zip(places, other, strict=False)
        if (trainer.gaussians.canonical.means == place).all(1).any()
    }
    assert left == {"behind it", "where its wall may be", "before the seeds"}
    torch.testing.assert_close(trainer.gaussians.canonical.sh.detach()[:, 0], colors[2:])


def test_what_seeds_show_to_be_near_stays(make_trainer: Make, capture: Capture) -> None:
    trainer = make_trainer(20)
    camera = capture.cameras[capture.train_cameras[0]]
    seeds = film.seeds(300).points
    place = camera.center + 0.25 * np.linalg.norm(seeds - camera.center, axis=1).min() * camera.rotation[2]
    trainer.gaussians.canonical.means.data[:5] = torch.from_numpy(place).float()
    known = NearPruning(capture, np.concatenate([seeds, np.repeat(place[None], 30, 0)]).astype(np.float32), 0.4)
    count = trainer.gaussians.count
    known.prune(trainer.gaussians, capture)
    assert trainer.gaussians.count == count
    NearPruning(capture, seeds[:20], 0.4).prune(trainer.gaussians, capture)  # too few to tell
    assert trainer.gaussians.count == count
    NearPruning(capture, seeds, 0.4).prune(trainer.gaussians, capture)
    assert trainer.gaussians.count == count - 5


def test_a_training_empties_what_is_right_before_its_cameras_but_the_papers_does_not(
    make_trainer: Make, capture: Capture, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert recipe("paper-exact").near_share == 0
    camera = capture.cameras[capture.train_cameras[0]]
    place = torch.from_numpy(camera.center + 0.05 * camera.rotation[2]).float()
    for share, many, left in ((0.4, 2, 0), (0.4, 8, 3), (0.0, 2, 3)):
        monkeypatch.setattr("frog_blender.engine.training.optimize.trainer._MANY_CAMERAS", many)
        trainer = make_trainer(20, near_share=share, capacity="fixed", densify_from=2.0, mean_rate=0.0)
        trainer.gaussians.canonical.means.data[:3] = place
        train(trainer, until=2)
        assert int(((trainer.gaussians.canonical.means - place).norm(dim=1) < 0.01).sum()) == left
