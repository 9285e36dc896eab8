"""Splitting, cloning and pruning; test_optimizer.py shows that Adam's memory follows each Gaussian."""

from dataclasses import replace

import pytest
import torch
from support.builders import plain_camera
from support.torch_drawing import BACKGROUND
from support.training_steps import OnlyGaussians

from frog_blender.engine.model.canonical import ATTRIBUTES, CanonicalField, new_gaussians
from frog_blender.engine.rasterizer import rasterize
from frog_blender.engine.recipes import RECIPES
from frog_blender.engine.training.optimize.densification import DensificationStrategy
from frog_blender.engine.training.optimize.gaussian_state import GaussianState

COUNT = 10
RECIPE = replace(RECIPES["draft"], densify_growth=1.0, max_gaussians=1000, split_scale=0.1)
SMALL, LARGE = 0.01, 0.5  # below and above the size at which a Gaussian is split, at scene scale 1


class Scene:
    """Ten Gaussians, small and large ones."""

    def __init__(self, recipe=RECIPE) -> None:
        generator = torch.Generator().manual_seed(0)
        points = torch.randn(COUNT, 3, generator=generator)
        spacings = torch.tensor([SMALL] * 5 + [LARGE] * 5)
        values = new_gaussians(points, torch.rand(COUNT, 3, generator=generator), spacings, 4, 3)
        values["opacity_logits"] = torch.zeros(COUNT)
        self.canonical = CanonicalField(values)
        self.gaussians = GaussianState(OnlyGaussians(self.canonical), recipe, 1.0)
        self.optimizer = self.gaussians.optimizer
        self.density = DensificationStrategy(self.gaussians, recipe, 1.0)
        self.before = {name: getattr(self.canonical, name).detach().clone() for name in ATTRIBUTES}

    def round(self, pulled: dict[int, float]) -> tuple[int, int]:
        for index, pull in pulled.items():
            self.density.gradient_sum[index], self.density.seen[index] = 2 * pull, 2
        limit = self.density.recipe.growth_limit_at(0.5)
        return self.density.round(self.gaussians, limit, torch.Generator().manual_seed(1))


def test_a_small_one_is_cloned() -> None:
    scene = Scene()
    assert scene.round({2: 1.0}) == (1, 0)
    assert len(scene.canonical) == COUNT + 1
    for name in ATTRIBUTES:
        values = getattr(scene.canonical, name).detach()
        torch.testing.assert_close(values[:COUNT], scene.before[name])
        torch.testing.assert_close(values[COUNT], scene.before[name][2])


def test_a_large_one_is_split_into_two_smaller_ones_around_its_place() -> None:
    scene = Scene()
    assert scene.round({7: 1.0}) == (1, 0)
    means, scales = scene.canonical.means.detach(), scene.canonical.log_scales.detach().exp()
    halves, old = means[[7, COUNT]], scene.before["means"][7]
    torch.testing.assert_close(halves.mean(0), old)
    assert 0 < float((halves[0] - old).norm()) < 4 * LARGE
    torch.testing.assert_close(scales[[7, COUNT]], scene.before["log_scales"][[7, 7]].exp() / 1.6)
    for name in ("quaternions", "opacity_logits", "sh", "embeddings"):
        torch.testing.assert_close(getattr(scene.canonical, name)[COUNT], scene.before[name][7])
    others = [i for i in range(COUNT) if i != 7]
    torch.testing.assert_close(means[others], scene.before["means"][others])


def test_split_halves_lie_along_the_long_axis() -> None:
    scene = Scene()
    scene.canonical.log_scales.data[7] = torch.tensor([1.0, 1e-4, 1e-4]).log()
    scene.canonical.quaternions.data[7] = torch.tensor([0.5**0.5, 0, 0, 0.5**0.5])  # x turns to y
    scene.round({7: 1.0})
    offset = (scene.canonical.means[COUNT] - scene.before["means"][7]).detach().abs()
    assert float(offset[1]) > 100 * float(offset[[0, 2]].max())


def test_the_invisible_are_pruned() -> None:
    scene = Scene()
    for gone in (0, 4, 8):
        scene.density.peak_opacity[gone] = 1e-3
    assert scene.round({2: 1.0, 7: 2.0, 8: 9.0}) == (2, 3)  # two come in the places of the first who go
    torch.testing.assert_close(scene.canonical.sh.detach(), scene.before["sh"][[2, 1, 2, 3, 7, 5, 6, 7, 9]])


@pytest.mark.parametrize(("growth", "limit", "expected"), [(0.3, 20, 3), (1.0, 12, 2), (1.0, 10, 0), (1.0, 5, 0)])
def test_the_strongest_come_first_until_the_budget_is_spent(growth: float, limit: int, expected: int) -> None:
    scene = Scene(replace(RECIPE, densify_growth=growth, max_gaussians=limit))
    assert scene.round({index: 1.0 + index for index in range(5)}) == (expected, 0)
    torch.testing.assert_close(scene.canonical.sh[COUNT:].detach(), scene.before["sh"][5 - expected : 5])


def at_the_limit(below: float = 0.2) -> Scene:
    """Ten Gaussians where no more are allowed, of which two were hardly seen of late."""
    scene = Scene(replace(RECIPE, max_gaussians=COUNT, replaced_below=below))
    scene.density.peak_weight[[4, 8]] = torch.tensor([0.1, 0.01])
    return scene


def test_at_the_limit_the_strongest_take_the_places_of_those_least_needed() -> None:
    scene = at_the_limit()
    assert scene.round({1: 1.0, 2: 2.0, 3: 3.0}) == (2, 2)  # two are needed little enough
    torch.testing.assert_close(scene.canonical.sh.detach(), scene.before["sh"][[0, 1, 2, 3, 2, 5, 6, 7, 3, 9]])


def test_what_grows_is_not_replaced() -> None:
    scene = at_the_limit()
    assert scene.round({8: 1.0, 4: 1.0}) == (0, 0)
    assert scene.round({8: 1.0}) == (1, 1)


@pytest.mark.parametrize(("looks", "least", "most"), [(100, 3, 7), (25, 3, 7), (5, 15, 29)])
def test_what_was_needed_long_ago_is_forgotten_after_some_rounds(looks: int, least: int, most: int) -> None:
    """After more of them where rounds are short: a slow machine's, or a training's of few steps."""
    scene, everyone = Scene(), torch.ones(COUNT, dtype=torch.bool)
    for rounds in range(1, 30):  # noqa: B007
        scene.density.peak_weight[0] = 1.0  # needed in every round
        scene.density.seen[0] = looks
        scene.round({})
        if len(scene.density.least_needed(COUNT, everyone)):
            break
    assert least <= rounds <= most
    assert sorted(scene.density.least_needed(COUNT, everyone).tolist()) == list(range(1, COUNT))


def test_not_everything_is_pruned() -> None:
    scene = Scene()
    scene.density.peak_opacity[:] = 1e-3
    assert scene.round({})[1] == 0
    assert len(scene.canonical) == COUNT


def test_what_is_seen_in_one_frame_outlives_what_is_never_seen() -> None:
    scene = Scene()
    image = rasterize(scene.canonical.gaussians(), plain_camera(), BACKGROUND)
    faint = torch.full((COUNT,), 0.001)
    once = faint.clone()
    once[3] = 0.9
    for count in range(1, 20):
        scene.density.observe(image, once if count == 5 else faint, plain_camera())
        if scene.round({})[1]:
            break
    assert count > 5  # all start as visible, and a round may miss a moment
    torch.testing.assert_close(scene.canonical.means.detach(), scene.before["means"][3:4])


def test_observation_counts_only_what_is_seen_in_half_image_widths() -> None:
    camera = plain_camera(48, 32)
    points = torch.tensor([[0.0, 0, 2], [0.2, 0.1, 2], [50.0, 0, 2], [0, 0, -2]])
    canonical = CanonicalField(new_gaussians(points, torch.rand(4, 3), torch.full((4,), 0.1), 1, 0))
    density = DensificationStrategy(GaussianState(OnlyGaussians(canonical), RECIPE, 1.0), RECIPE, 1.0)
    image = rasterize(canonical.gaussians(), camera, BACKGROUND)
    gaussians = canonical.gaussians()
    density.observe(image, gaussians.opacities, camera)  # before a backward pass: nothing to see
    assert not density.seen.any()
    image.rgb[:, :24].sum().backward()
    density.observe(image, gaussians.opacities, camera)
    assert density.seen.tolist() == [1, 1, 0, 0]
    torch.testing.assert_close(density.gradient_sum, image.screen.grad.norm(dim=1) * 24)
    assert float(density.gradient_sum[0]) > 0 and not density.gradient_sum[2:].any()


def test_rates_decay_from_start_to_end() -> None:
    scene = Scene()
    rates = {}
    halfway = 1.0 - RECIPE.cool_down / 2
    for progress in (0.0, 0.5, halfway, 1.0):
        scene.optimizer.schedule(progress)
        rates[progress] = {group["name"]: group["lr"] for group in scene.optimizer.adam.param_groups}
    assert rates[0.0]["means"] == pytest.approx(RECIPE.mean_rate)
    assert rates[halfway]["means"] == pytest.approx(RECIPE.mean_rate * RECIPE.rate_decay**halfway / 2)
    assert rates[0.5]["means"] == pytest.approx(RECIPE.mean_rate * RECIPE.rate_decay**0.5)
    assert rates[halfway]["sh"] == pytest.approx(RECIPE.color_rate * RECIPE.attribute_decay**halfway / 2)
    assert set(rates[1.0].values()) == {0.0}  # cooled down
    never = Scene(replace(RECIPE, cool_down=0.0)).optimizer
    never.schedule(1.0)
    assert never.adam.param_groups[0]["lr"] == pytest.approx(RECIPE.mean_rate * RECIPE.rate_decay)
