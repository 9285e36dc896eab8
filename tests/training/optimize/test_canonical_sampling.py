"""Where new anchors are put, and image similarity."""

from functools import partial

import numpy as np
import pytest
import torch
from support.builders import odd_camera

from frog_blender.engine.rasterizer import Image
from frog_blender.engine.training.optimize.canonical_sampling import (
    choose_pixels,
    distances_along_rays,
    error_map,
    new_anchors,
    pixel_errors,
    undeformed,
    worst_points,
)

NAN = float("nan")


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def images(height: int = 40, width: int = 60) -> tuple[torch.Tensor, torch.Tensor]:
    """A smooth truth and a drawing of it that is off by different shares in different places."""
    y, x = torch.meshgrid(torch.linspace(0, 3, height), torch.linspace(0, 5, width), indexing="ij")
    truth = (0.6 + 0.2 * torch.sin(x) * torch.cos(2 * y))[:, :, None].repeat(1, 1, 3)
    error = 0.3 * torch.rand(height // 4, width // 4, generator=generator(3))
    error = error.repeat_interleave(4, 0).repeat_interleave(4, 1)
    return truth, truth * (1 - error[:, :, None])


errors_of = partial(pixel_errors, kind="relative")


def test_the_dim_half_of_an_image_receives_anchors_too() -> None:
    truth, drawn = images()
    light = torch.ones(40, 60, 1)
    light[:, 30:] = 0.25
    mirrored = torch.cat([truth[:, :30], truth[:, :30].flip(1)], 1) * light
    drawn = torch.cat([drawn[:, :30], drawn[:, :30].flip(1)], 1) * light

    def share(score: torch.Tensor) -> float:
        chosen = choose_pixels(score, torch.ones(40, 60), 100, generator())
        return float((chosen % 60 >= 30).float().mean())

    assert share(error_map(drawn, mirrored)) > 0.05
    assert share((drawn - mirrored).abs().mean(2)) == 0  # as the plain error would have it


def test_pixels_without_depth_are_never_chosen() -> None:
    score, depth = torch.rand(20, 30, generator=generator()), torch.ones(20, 30)
    depth[:, :25] = NAN
    depth[0] = float("inf")
    for seed in range(5):
        chosen = choose_pixels(score, depth, 50, generator(seed))
        assert 1 <= len(chosen) <= 50 and len(chosen.unique()) == len(chosen)
        assert (chosen % 30 >= 25).all() and (chosen // 30 > 0).all()
    assert len(choose_pixels(score, torch.full((20, 30), NAN), 50, generator())) == 0


@pytest.fixture
def drawn_wall() -> tuple[Image, torch.Tensor]:
    """An image of a wall at Euclidean distance 3 to 4, half of it without depth."""
    camera = odd_camera(60, 40)
    truth, drawn = images()
    depth = torch.linspace(3, 4, 60).expand(40, 60).clone()
    depth[:20] = NAN
    size = (camera.height, camera.width)
    return Image(drawn, torch.ones(size), torch.zeros(5), torch.zeros(5, 2), median_depth=depth), truth


def test_anchors_project_back_to_the_pixels_they_came_from(drawn_wall: tuple[Image, torch.Tensor]) -> None:
    camera = odd_camera(60, 40)
    image, truth = drawn_wall
    embedding = torch.tensor([1.0, -2.0])
    pixels = np.random.default_rng(0).uniform(0, [60, 40], (50, 2))
    existing = torch.from_numpy(camera.unproject(pixels, np.full(50, 3.5))).float()
    points, colors = worst_points(errors_of(image, truth), image.median_depth, truth, camera, 40, generator())
    new = new_anchors(points, colors, embedding.expand(len(points), -1), existing, 4)
    assert 20 <= len(new["means"]) <= 40
    pixels, _ = camera.project(new["means"].double().numpy())
    centers = np.floor(pixels) + 0.5
    np.testing.assert_allclose(pixels, centers, atol=1e-3)
    columns, rows = np.floor(pixels).astype(int).T
    assert (rows >= 20).all()  # where there is a depth
    distances = np.linalg.norm(new["means"].numpy() - camera.center, axis=1)
    np.testing.assert_allclose(distances, image.median_depth.numpy()[rows, columns], rtol=1e-5)
    colors = new["sh"][:, 0] * 0.28209479177387814 + 0.5
    torch.testing.assert_close(colors, truth[rows, columns])
    assert torch.equal(new["embeddings"], embedding.expand(len(colors), 2))
    assert new["sh"].shape == (len(colors), 4, 3) and torch.isfinite(new["log_scales"]).all()


def test_an_image_without_any_depth_gives_no_anchor(drawn_wall: tuple[Image, torch.Tensor]) -> None:
    image, truth = drawn_wall
    image.median_depth[:] = NAN
    points, colors = worst_points(
        errors_of(image, truth), image.median_depth, truth, odd_camera(60, 40), 40, generator()
    )
    points, embeddings = undeformed(points, torch.randn(9, 3), torch.randn(9, 3), torch.randn(9, 2))
    new = new_anchors(points, colors, embeddings, torch.randn(9, 3), 1)
    assert {name: len(value) for name, value in new.items()} == dict.fromkeys(new, 0)


def test_mean_depth_lies_on_the_same_ray_at_its_own_depth(drawn_wall: tuple[Image, torch.Tensor]) -> None:
    """The mean depth is planar; along the ray it is longer, the more so off the axis."""
    image, truth = drawn_wall
    camera = odd_camera(60, 40)
    image.mean_depth = torch.full((40, 60), 2.5)
    along = distances_along_rays(image, camera, "mean")
    points, _ = worst_points(errors_of(image, truth), along, truth, camera, 40, generator())
    _, planar = camera.project(points.double().numpy())
    np.testing.assert_allclose(planar, 2.5, rtol=1e-5)
    assert (along >= 2.5).all() and along.max() > 2.51


def test_inverse_deformation_takes_off_the_nearest_motion_and_copies_its_embedding() -> None:
    deformed = torch.tensor([[0.0, 0, 0], [5, 0, 0]])
    motion = torch.tensor([[1.0, 0, 0], [0, 2, 0]])
    embeddings = torch.tensor([[1.0, 2], [3, 4]])
    points, copied = undeformed(torch.tensor([[4.5, 0, 0], [0.5, 0, 0.0]]), deformed, motion, embeddings)
    torch.testing.assert_close(points, torch.tensor([[4.5, -2, 0], [-0.5, 0, 0.0]]))
    assert torch.equal(copied, embeddings[[1, 0]])


def test_coverage_is_a_second_cue() -> None:
    """Black on black shows no error; where nothing covers, anchors are wanted all the same."""
    camera = odd_camera(60, 40)
    black = torch.zeros(40, 60, 3)
    alpha = torch.ones(40, 60)
    alpha[:, 50:] = 0.55
    image = Image(black, alpha, torch.zeros(5), torch.zeros(5, 2), median_depth=torch.full((40, 60), 3.0))
    points, _ = worst_points(errors_of(image, black), image.median_depth, black, camera, 60, generator())
    pixels, _ = camera.project(points.double().numpy())
    assert len(pixels) and (pixels[:, 0] > 50).all()
    assert not pixel_errors(image, black, "l1").any(), "the paper's cue is the difference alone"
