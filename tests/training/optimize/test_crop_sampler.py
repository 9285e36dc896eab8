"""Steps on rectangles: where they look, what they remember, and what their pixels weigh."""

from collections.abc import Mapping

import numpy as np
import pytest
import torch
from support.builders import plain_camera
from support.synthetic_capture import rig
from support.torch_drawing import cut
from support.training_steps import Make, train

from frog_blender.engine.rasterizer import RasterizeOptions
from frog_blender.engine.training.optimize import losses
from frog_blender.engine.training.optimize.losses import PhotometricLoss, photometric_loss_reference
from frog_blender.engine.training.optimize.schedule import CELL, CropSampler
from frog_blender.engine.training.optimize.trainer import Trainer

Region = tuple[int, int, int, int]

SIZES = [(160, 96), (161, 97), (175, 95), (48, 36), (47, 200), (17, 33), (16, 16), (9, 5), (1, 1)]


def picker_of(size: tuple[int, int], share: float = 1.0, region_size: float = 0.4) -> CropSampler:
    """For one camera, whose whole image has been seen with the same error everywhere."""
    picker = CropSampler([plain_camera(*size)], share, region_size)
    picker.observe(0, (0, 0, *size), torch.ones(picker.errors[0].shape))
    return picker


def picks(picker: CropSampler, count: int, seed: int = 0) -> list[Region]:
    generator = torch.Generator().manual_seed(seed)
    regions = [picker.pick(0, generator) for _ in range(count)]
    return [region for region in regions if region is not None]


def test_a_camera_is_first_seen_whole() -> None:
    cameras = [plain_camera(80, 64), plain_camera(50, 40)]
    picker, generator = CropSampler(cameras, 1.0, 0.4), torch.Generator().manual_seed(0)
    assert all(picker.pick(camera, generator) is None for camera in (0, 1) for _ in range(5))
    picker.observe(1, (0, 0, 50, 40), torch.rand(3, 4))
    assert picker.pick(0, generator) is None and picker.pick(1, generator) is not None
    picker.observe(0, (16, 0, 64, 64), torch.rand(4, 4))  # its first column of cells is still unknown
    assert picker.pick(0, generator) is None
    picker.observe(0, (0, 0, 16, 64), torch.rand(4, 1))
    assert picker.pick(0, generator) is not None


@pytest.mark.parametrize("region_size", [0.05, 0.4, 1.0])
@pytest.mark.parametrize("size", SIZES)
def test_rectangles_lie_in_the_image_on_whole_cells_and_have_the_size(
    size: tuple[int, int], region_size: float
) -> None:
    """The image's last cell may be cut; small images are taken whole, and nothing is smaller than 48 pixels."""
    picker = picker_of(size, region_size=region_size)
    regions = picks(picker, 200)
    assert len(regions) == 200
    for axis in (0, 1):
        length = size[axis]
        cells = -(-length // CELL)
        cells_a_side = min(cells, max(3, round(cells * region_size)))
        starts, lengths = {region[axis] for region in regions}, {region[axis + 2] for region in regions}
        assert all(start % CELL == 0 for start in starts)
        assert starts == {CELL * first for first in range(cells - cells_a_side + 1)}  # each place comes up
        for region in regions:
            start, extent = region[axis], region[axis + 2]
            assert 0 <= start < start + extent <= length
            assert extent == cells_a_side * CELL or (start + extent == length and extent > (cells_a_side - 1) * CELL)
        assert lengths <= {cells_a_side * CELL, cells_a_side * CELL - (cells * CELL - length)}
    camera = plain_camera(*size)
    assert all(RasterizeOptions(region=region).region_of(camera) == region for region in regions)


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_share_of_steps_on_rectangles(share: float) -> None:
    count = len(picks(picker_of((160, 96), share), 2000))
    assert abs(count / 2000 - share) < (0.04 if 0 < share < 1 else 1e-9)


def test_rectangles_follow_the_error() -> None:
    """Of ten by six cells two are wrong, one nine times as much (in squares) as the other, away from the borders: all
    rectangles are centred on one of them, in that proportion."""
    picker = CropSampler([plain_camera(160, 96)], 1.0, 0.3)
    cells = torch.zeros(6, 10)
    cells[2, 2], cells[3, 7] = 0.3**2, 0.1**2
    picker.observe(0, (0, 0, 160, 96), cells)
    regions = picks(picker, 2000)
    assert {region[2:] for region in regions} == {(48, 48)}
    counts = {corner: sum(region[:2] == corner for region in regions) for corner in {region[:2] for region in regions}}
    assert counts.keys() == {(16, 16), (96, 32)}
    assert abs(counts[16, 16] / 2000 - 0.9) < 0.03
    assert picks(picker, 20, seed=1) == picks(picker, 20, seed=1) != picks(picker, 20, seed=2)


def test_only_cells_that_were_seen_are_updated() -> None:
    picker = picker_of((90, 70))
    expected = picker.errors[0].copy()
    assert expected.shape == (5, 6) and (expected == 1).all()
    cells = torch.zeros(3, 4)  # rows 2 to 4 and columns 2 to 5, the last of each cut
    cells[0, 1] = 4.0
    picker.observe(0, (32, 32, 58, 38), cells)
    expected[2:, 2:] = 0.7
    expected[2, 3] = 0.7 + 0.3 * 4
    np.testing.assert_allclose(picker.errors[0], expected, rtol=1e-6)


REGION: Region = (16, 0, 32, 32)


class Stubborn(CropSampler):
    """Always the same rectangle."""

    def pick(self, camera: int, generator: torch.Generator) -> Region | None:
        return REGION


def one_step(trainer: Trainer, masked: bool) -> tuple[dict[str, torch.Tensor], torch.Tensor]:
    """Gradients of one step by parameter, and what densification collected. ``masked`` draws the whole image, but is
    told that all is well outside the rectangle."""
    gradients: dict[str, torch.Tensor] = {}
    trainer.density.gradient_sum.zero_()

    def flattering(
        image: torch.Tensor, pixels: torch.Tensor, terms: Mapping[str, float], weight: float
    ) -> PhotometricLoss:
        truth = image.detach().clone()
        cut(truth, REGION)[:] = cut(pixels.float() / 255, REGION)
        return photometric_loss_reference(image, truth, {"square": terms["square"]}, weight)

    def read(*_: object) -> None:
        gradients.update({n: p.grad.clone() for n, p in trainer.model.named_parameters() if p.grad is not None})
        gradients["pulls"] = trainer.density.gradient_sum.clone()  # a round may be due after the step

    trainer.optimizer.step = read  # type: ignore[method-assign]
    with pytest.MonkeyPatch.context() as patch:
        if masked:
            patch.setattr(losses, "photometric_loss", flattering)
        else:
            trainer.crops = Stubborn(trainer.capture.cameras, 1.0, 0.4)
        trainer.step()
    return gradients, gradients.pop("pulls")


def pair(make_trainer: Make, emphasis: float) -> list[tuple[dict[str, torch.Tensor], torch.Tensor]]:
    """``one_step`` on the rectangle, and masked, of the same shot in the middle of the same training."""
    steps = []
    for masked in (False, True):
        recipe = {"dssim_weight": 0.0, "smoothness_weight": 0.0, "table_smoothness": 0.0, "region_emphasis": emphasis}
        trainer = train(make_trainer(40, **recipe), until=20)
        steps.append(one_step(trainer, masked))
    return steps


@pytest.mark.parametrize("emphasis", [0.0, 0.5, 1.0])
def test_a_rectangle_weighs_as_the_recipe_says(make_trainer: Make, emphasis: float) -> None:
    """Without emphasis, a step on a rectangle has the gradients of a whole step whose loss is masked to it."""
    (gradients, pulls), (expected, expected_pulls) = pair(make_trainer, emphasis)
    camera = rig()[0]
    weight = (camera.width * camera.height / (REGION[2] * REGION[3])) ** emphasis
    expected = {name: gradient * weight for name, gradient in expected.items()}
    assert gradients.keys() == expected.keys() and len(gradients) > 8
    for name, gradient in expected.items():
        error = (gradients[name] - gradient).norm() / gradient.norm().clamp(min=1e-12)
        assert float(error) < 1e-4, name
    if not emphasis:  # pulls are in half image widths, whatever part of the image was drawn
        pulled = expected_pulls > 0
        assert int(pulled.sum()) > 20
        torch.testing.assert_close(pulls[pulled], expected_pulls[pulled], rtol=1e-3, atol=1e-9)
