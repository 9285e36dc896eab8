"""Images at half their size, and with masks: the subject alone is learned, and nothing of what is ignored."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
import torch
from support import synthetic_capture as film
from support.builders import odd_camera
from support.image_stores import ImageStore
from support.masked_capture import ball_alpha, write_masks
from support.training_steps import train

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.hull import VisualHull
from frog_blender.engine.capture.masking import over
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.evaluation.evaluate import TrueImages, evaluate_images
from frog_blender.engine.frames.image_coding import halved_image
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.options import JobOptions
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.rasterizer import RasterizeOptions, rasterize
from frog_blender.engine.recipes import Recipe
from frog_blender.engine.training.optimize.hull_pruning import HullPruning, room_for_subject
from frog_blender.engine.training.optimize.losses import matte_loss, photometric_loss
from frog_blender.engine.training.optimize.mattes import Mattes, Truth, behind_ignored, halved, is_halved, sized
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.optimize.transfers import KeptImages
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = film.write_capture(tmp_path_factory.mktemp("masked") / "film")
    write_masks(folder / "masks", "numbered")
    return folder


@pytest.fixture(scope="module")
def masked(folder: Path) -> Capture:
    return open_capture(folder)


@pytest.fixture(scope="module")
def frames(masked: Capture, tmp_path_factory: pytest.TempPathFactory) -> FrameStore:
    return FrameStore.open(masked, cache_folder=tmp_path_factory.mktemp("cache"))


def drawing(rgb: torch.Tensor, alpha: torch.Tensor) -> Any:
    return SimpleNamespace(rgb=rgb, alpha=alpha)


def random_truth(size: tuple[int, int] = (40, 52)) -> tuple[torch.Tensor, Truth]:
    random = np.random.default_rng(3)
    pixels = torch.from_numpy(random.integers(0, 256, (*size, 3), dtype=np.uint8))
    alpha = torch.from_numpy(random.integers(0, 256, size, dtype=np.uint8))
    return torch.rand(*size, 3, generator=torch.Generator().manual_seed(1)), Truth(pixels, (0.0, 0.0, 0.0), alpha)


@pytest.mark.parametrize("dssim_weight", [0.0, 0.3])
def test_what_is_ignored_weighs_nothing(dssim_weight: float) -> None:
    rgb, truth = random_truth()
    ignored = torch.zeros(truth.pixels.shape[:2], dtype=torch.bool)
    ignored[10:20, 15:40] = True
    truth, alpha = replace(truth, ignored=ignored), torch.rand(40, 52)

    def loss(rgb: torch.Tensor, alpha: torch.Tensor) -> Any:
        return matte_loss(drawing(rgb, alpha), truth, 0.2, {"dssim": dssim_weight}, 0.7)

    first = loss(rgb, alpha)
    changed, other = rgb.clone(), alpha.clone()
    changed[10:20, 15:40], other[10:20, 15:40] = 0.9, 0.9
    again = loss(changed, other)
    one, other = first.figures(), again.figures()
    assert one.terms == other.terms and torch.equal(one.cell_errors, other.cell_errors)
    assert torch.equal(first.gradient, again.gradient) and torch.equal(first.alpha_gradient, again.alpha_gradient)
    assert not first.gradient[10:20, 15:40].any() and not first.alpha_gradient[10:20, 15:40].any()
    assert first.gradient[:10].any() and first.alpha_gradient[:10].any()


def test_the_loss_on_alpha_has_its_own_gradient() -> None:
    rgb, truth = random_truth()
    alpha = torch.rand(40, 52, dtype=torch.float64, generator=torch.Generator().manual_seed(2)).requires_grad_()
    assert truth.alpha is not None
    matte = matte_loss(drawing(rgb.double(), alpha), truth, 0.2, {"dssim": 0.0}, 0.7)
    plain = photometric_loss(rgb.double(), truth.pixels, {}, 0.7)
    extra = 0.7 * 0.2 * (alpha - truth.alpha.double() / 255).abs().mean()
    assert matte.figures().loss == pytest.approx(plain.figures().loss + float(extra.detach()), abs=1e-7)
    torch.testing.assert_close(matte.alpha_gradient, torch.autograd.grad(extra, alpha)[0])
    assert torch.equal(matte.gradient, plain.gradient)


def test_whole_images_have_the_loss_and_the_random_numbers_they_had(capture: Capture, store: FrameStore) -> None:
    rgb, truth = random_truth()
    whole = replace(truth, alpha=None)
    matte = matte_loss(drawing(rgb, rgb[..., 0]), whole, 0.2, {"dssim": 0.3}, 0.7)
    plain = photometric_loss(rgb, truth.pixels, {"dssim": 0.3}, 0.7)
    assert matte.figures().terms == plain.figures().terms and torch.equal(matte.gradient, plain.gradient)
    assert matte.alpha_gradient is None
    generator, mattes = torch.Generator().manual_seed(5), Mattes(capture, store)
    before = generator.get_state()
    assert mattes.random_background(generator) is None and torch.equal(generator.get_state(), before)
    assert mattes.background_of(3) == capture.background and not mattes.has_alpha


@pytest.mark.parametrize("room", [0, 1 << 30])
def test_truth_lies_over_the_color_of_the_step(masked: Capture, frames: FrameStore, room: int) -> None:
    mattes, shot = Mattes(masked, frames, KeptImages(torch.device("cpu"), room)), masked.shot_index(1, 2)
    assert shot is not None
    camera, color = masked.cameras[1], (0.2, 0.9, 0.4)
    truth = mattes.truth(shot, camera, (4, 6, 30, 20), color)
    alpha = ball_alpha(camera, 2)[6:26, 4:34]
    np.testing.assert_array_equal(truth.alpha, alpha)
    np.testing.assert_allclose(truth.background, color)
    pixels = frames.image(shot)[6:26, 4:34]
    expected = pixels + over(0 * pixels, alpha, color).astype(int)
    assert np.abs(truth.pixels.numpy() - expected).max() <= 1
    exposed = mattes.truth(shot, camera.with_exposure((1.25, 0.5, 1.0)), (4, 6, 30, 20), color)
    empty = np.argwhere(alpha == 0)[0]
    drawn = np.array(exposed.background) * (1.25, 0.5, 1.0)  # what the camera makes of the drawing's background
    assert np.abs(exposed.pixels[tuple(empty)].numpy() / 255 - drawn).max() < 1 / 255


@pytest.mark.parametrize("kept", [0, 1, 2])
def test_images_are_kept_whole_while_there_is_room(capture: Capture, store: FrameStore, kept: int) -> None:
    """And read once; of others the part is read each time."""
    reads: list[Any] = []

    class Counted(ImageStore):
        def part(self, *asked: Any) -> np.ndarray:
            reads.append(asked)
            return store.part(*asked)

        def prefetch(self, *asked: Any) -> None:
            reads.append(asked)

    camera, region = halved(capture.cameras[0]), (4, 6, 20, 10)
    images = KeptImages(torch.device("cpu"), kept * 3 * camera.width * camera.height)
    mattes = Mattes(capture, Counted(), images)  # type: ignore[arg-type]
    shots = [index for index, shot in enumerate(capture.shots) if shot.camera == 0][:2]
    for shot in 2 * shots:
        mattes.prefetch(shot, camera, region)
        pixels = mattes.truth(shot, camera, region).pixels
        np.testing.assert_array_equal(pixels, store.part(shot, region, True))
    whole = (0, 0, camera.width, camera.height)
    once, again = [(shot, whole, True) for shot in shots[:kept]], [(shot, region, True) for shot in shots[kept:]]
    assert reads[::2] == reads[1::2] == once + again + again


def test_gaussians_outside_the_hull_are_pruned(masked: Capture, frames: FrameStore, lively: Any) -> None:
    trainer = Trainer(masked, frames, film.seeds(300), lively(20), JobOptions(method="static", steps=20))
    trainer.add_hook(hook := HullPruning())
    keep = hook.inside(trainer, strict=False)
    depths, kept = trainer.model.canonical.means.detach().numpy()[:, 2], keep.numpy()
    assert kept[depths < 0.2].mean() > 0.8 and kept[depths > 0.6].mean() < 0.2  # the ball, and the wall behind it
    hook.after_step(trainer, 0.09, 0.11)
    assert trainer.count == int(keep.sum())


def test_what_is_outside_the_hull_for_the_most_part_goes_once_motion_is_learned(
    masked: Capture, frames: FrameStore, lively: Any
) -> None:
    """Of Gaussians that stand, while the ball moves."""
    trainer = Trainer(masked, frames, film.seeds(300), lively(20), JobOptions(method="static", steps=20))
    hull = VisualHull(masked, frames, masked.train_indices)
    means = trainer.model.canonical.means.detach().double().numpy()
    answers = [hull.contains_at(means, frame) for frame in hull.frames]
    seen = np.array([views > 0 for _, views in answers])
    inside = np.array([contained for contained, _ in answers])
    mostly = seen.any(0) & ((seen & ~inside).sum(0) <= 0.75 * seen.sum(0))
    assert 0 < mostly.sum() < inside.any(0).sum()
    trainer.add_hook(hook := HullPruning())
    np.testing.assert_array_equal(hook.inside(trainer).numpy(), mostly)
    hook.after_step(trainer, 0.65, 0.75)
    assert trainer.count == mostly.sum()


def test_a_subject_has_the_gaussians_of_its_part_of_the_images(masked: Capture, frames: FrameStore) -> None:
    shown = [ball_alpha(masked.cameras[shot.camera], shot.frame).mean() / 255 for shot in masked.train_shots]
    assert room_for_subject(masked, frames, 100_000) == pytest.approx(3 * 100_000 * np.mean(shown), rel=0.01)
    assert room_for_subject(masked, frames, 600) == 600
    assert room_for_subject(masked.without_masks(), frames, 100_000) == 100_000


def trained(folder: Path, output: Path, lively: Any, **changes: Any) -> ScenePlayer:
    seeds = film.seeds() if changes else None
    job = TrainingJob(folder, output, recipe=lively(500), seeds=seeds, seed=1, **changes)
    happened = list(run_training(job))
    assert isinstance(happened[-1], events.Finished)
    return ScenePlayer.load(output)


def test_a_training_with_masks_learns_the_subject_alone(
    folder: Path, tmp_path: Path, lively: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    subject = trained(folder, tmp_path / "subject.frog", lively)
    everything = trained(folder, tmp_path / "all.frog", lively, masks="off")
    capture = open_capture(folder)
    store = FrameStore.open(capture)
    of_subject, of_everything = (
        evaluate_images(scene, TrueImages(capture, store), split="training") for scene in (subject, everything)
    )
    assert of_subject["psnr_inside"] > 22 and of_subject["psnr_inside"] > of_everything["psnr_inside"] - 1
    hull = VisualHull(capture, store, capture.train_indices)
    for frame in range(film.FRAMES):
        gaussians = subject.at(frame / (film.FRAMES - 1))
        shown = gaussians.means[gaussians.opacities > 0.1]
        assert (shown[:, 2] > 0.6).mean() < 0.2  # hardly anything where the wall is, which only one camera looks at
        assert hull.contains_at(shown.astype(float), frame)[0].mean() > 0.8
    assert subject.header.masks.use and not everything.header.masks.use
    again = open_capture(folder, masks=subject.header.masks)
    assert again.has_masks and not open_capture(folder, masks=everything.header.masks).has_masks


def test_nothing_is_learned_of_what_is_ignored(
    tmp_path: Path, lively: Any, monkeypatch: pytest.MonkeyPatch, cache_folder: Path
) -> None:
    """A mark in every image of a camera, as large as a tenth of it, which is said to be ignored."""
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    folder = film.write_capture(tmp_path / "film")
    (folder / "ignore").mkdir()
    mark = np.zeros((film.HEIGHT, film.WIDTH), np.uint8)
    mark[4:16, 6:22] = 255
    cv2.imwrite(str(folder / "ignore" / "cam02.png"), mark)
    capture = open_capture(folder)
    store = FrameStore.open(capture)

    class Marked(ImageStore):
        """The store's images, with a white mark in one camera's."""

        ignored, alpha = store.ignored, store.alpha

        def image(self, index: int) -> np.ndarray:
            image = store.image(index).copy()
            if capture.cameras[capture.shots[index].camera].name == "cam02":
                image[mark > 0] = 255
            return image

    losses = []
    for frames in (store, Marked()):
        trainer = Trainer(capture, frames, film.seeds(), lively(60), JobOptions(steps=60))  # type: ignore[arg-type]
        train(trainer)
        losses.append((trainer.loss, trainer.model.canonical.sh.detach().clone(), trainer.evaluate(9)))
    (loss, colors, psnr), (loss_marked, colors_marked, psnr_marked) = losses
    assert loss == loss_marked and torch.equal(colors, colors_marked) and psnr == psnr_marked


def test_what_is_drawn_where_pixels_are_ignored_counts_as_unseen(capture: Capture, make_trainer: Any) -> None:
    """A Gaussian that only ignored pixels show is as good as none: density control may put it elsewhere."""
    trainer = make_trainer(10)
    camera, means = capture.cameras[0], trainer.model.canonical.means.detach()
    pixels, depths = camera.project(means.double().numpy())
    ignored = torch.zeros(camera.height, camera.width, dtype=torch.bool)
    ignored[:, : camera.width // 2] = True
    hidden = behind_ignored(ignored, means, camera, (0, 0, camera.width, camera.height))
    inside = (pixels >= 0).all(1) & (pixels[:, 0] < camera.width // 2) & (pixels[:, 1] < camera.height) & (depths > 0)
    np.testing.assert_array_equal(hidden.numpy(), inside)
    part = (camera.width // 4, 2, camera.width // 2, camera.height // 2)
    hidden_in_part = behind_ignored(ignored[2 : 2 + part[3], part[0] : part[0] + part[2]], means, camera, part)
    shown = (pixels >= part[:2]).all(1) & (pixels < (part[0] + part[2], 2 + part[3])).all(1) & (depths > 0)
    np.testing.assert_array_equal(hidden_in_part.numpy(), inside & shown)
    image = rasterize(trainer.model.canonical.gaussians(1), camera, options=RasterizeOptions(weights=True))
    image.rgb.square().mean().backward()
    opacities = trainer.model.canonical.opacity_logits.detach().sigmoid()
    trainer.density.peak_weight.zero_()
    trainer.density.observe(image, opacities, camera, hidden)
    assert trainer.density.peak_weight[hidden].max() == 0 and trainer.density.seen[hidden].max() == 0
    assert trainer.density.peak_weight[~hidden].max() > 0 and trainer.density.seen[~hidden].max() == 1


@pytest.mark.parametrize("size", [(64, 96), (65, 97)])
def test_a_halved_image_has_the_means_and_the_size_of_the_camera(size: tuple[int, int]) -> None:
    pixels = np.random.default_rng(1).integers(0, 256, (*size, 3)).astype(np.uint8)
    half = halved_image(pixels)
    camera = halved(odd_camera(size[1], size[0]))
    assert half.shape == (camera.height, camera.width, 3) and half.dtype == np.uint8
    assert half.mean() == pytest.approx(pixels.mean(), abs=1)
    whole = odd_camera(size[1], size[0])
    assert sized(pixels, whole) is pixels
    np.testing.assert_array_equal(sized(pixels, camera), half)
    assert not is_halved(odd_camera(48, 36), 0.0, 0.5), "fewer than 64 pixels a side"
    if size == (64, 96):
        means = pixels.reshape(32, 2, 48, 2, 3).mean((1, 3))
        assert np.abs(half - means).max() <= 0.5


class Watched(Trainer):
    """Remembers the sizes of what is drawn for steps, by progress, and of what shows where anchors are needed."""

    sizes: list[tuple[float, tuple[int, int]]]
    anchored: list[tuple[int, int]]

    def draw(self, shot_index: int, progress: float, options: RasterizeOptions, *more: Any) -> Any:
        truth, drawn = super().draw(shot_index, progress, options, *more)
        height, width, _ = drawn.image.rgb.shape
        assert truth.pixels.shape == (height, width, 3)
        if options.depth:
            camera = self.camera_at(self.capture.shots[shot_index].camera, progress)
            assert (camera.width, camera.height) == (width, height)
            self.anchored.append((width, height))
        elif progress >= self.recipe.warm_up:
            self.sizes.append((progress, (width, height)))
        return truth, drawn


def test_a_training_begins_at_half_size_and_ends_at_whole(
    capture: Capture, cache_folder: Path, lively: Callable[..., Recipe]
) -> None:
    large = capture.scaled(2.0)
    changes = {"half_size_until": 0.5, "sampling_until": 0.95, "densify_until": 0.0, "region_share": 0.0}
    recipe = lively(60, **{**changes, "max_gaussians": 5000})
    store = FrameStore.open(large, cache_folder=cache_folder)
    trainer = Watched(large, store, film.seeds(), recipe, JobOptions(steps=60))
    trainer.sizes, trainer.anchored = [], []
    train(trainer)
    whole = (large.cameras[0].width, large.cameras[0].height)
    half = (whole[0] // 2, whole[1] // 2)
    assert {size for progress, size in trainer.sizes if progress < 0.5} == {half}
    assert {size for progress, size in trainer.sizes if progress > 0.52} == {whole}
    assert set(trainer.anchored) == {half, whole}
