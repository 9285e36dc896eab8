"""Networks made narrower: which units leave, what the others take over, and that a training goes on afterwards."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import torch
from support.training_steps import compression, train

from frog_blender.engine.errors import FrogError
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.rasterizer import rasterize
from frog_blender.engine.training.compression.network_pruning import (
    output_sensitivities,
    prune_hidden_units,
    visible_moments,
    without_units,
)
from frog_blender.engine.training.compression.sensitivity import SampledView
from frog_blender.engine.training.compression.settings import CompressionSettings
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.checkpoint import load_checkpoint, save_checkpoint, state_of
from frog_blender.engine.training.session.export import export_scene
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.session import Session

Make = Callable[..., Trainer]
ANY_LOSS = CompressionSettings(max_width_loss=100.0)


def moments_of(values: torch.Tensor, weights: torch.Tensor) -> torch.Tensor:
    """(outputs, U + 1, U + 1) of values (n, U), weighed by (n, outputs)."""
    values = torch.cat([values, torch.ones(len(values), 1)], dim=1).double()
    return torch.einsum("no,nu,nv->ouv", weights.double(), values, values)


def layer(outputs: int, units: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    return torch.randn(outputs, units, generator=generator), torch.randn(outputs, generator=generator)


def test_units_that_the_others_can_replace_leave_at_no_cost() -> None:
    """Half of the units are mixtures of the other half."""
    generator = torch.Generator().manual_seed(0)
    free = torch.rand(500, 16, generator=generator)
    values = torch.cat([free @ torch.rand(16, 16, generator=generator) + 0.5, free], dim=1)
    values = values[:, torch.randperm(32, generator=generator)]
    weight, bias = layer(5, 32)
    *_, found = without_units(moments_of(values, torch.rand(500, 5, generator=generator)), weight, bias)
    assert len(found.units) == 16 and not found.weight[:, sorted(set(range(32)) - set(found.units.tolist()))].any()
    before, after = values @ weight.T + bias, values @ found.weight.T + found.bias
    torch.testing.assert_close(after, before, atol=0.02 * float(before.abs().max()), rtol=0)


def test_the_others_are_corrected_in_the_best_way() -> None:
    """Least squares over what is left, each output by its own weights, finds nothing better."""
    generator = torch.Generator().manual_seed(2)
    values, weights = torch.rand(400, 40, generator=generator), torch.rand(400, 3, generator=generator)
    weight, bias = layer(3, 40)
    found = without_units(moments_of(values, weights), weight, bias)[-1]
    kept = torch.cat([values[:, found.units], torch.ones(400, 1)], dim=1).double()
    for output in range(3):
        wanted = (values.double() @ weight[output].double() + bias[output]) * weights[:, output].double().sqrt()
        best = torch.linalg.lstsq(kept * weights[:, output].double().sqrt()[:, None], wanted[:, None]).solution[:, 0]
        mine = torch.cat([found.weight[output, found.units], found.bias[output, None]]).double()
        torch.testing.assert_close(mine, best, atol=2e-4, rtol=2e-3)


def test_units_that_are_nearly_the_same_leave_first() -> None:
    """Moments that are as good as singular do not make any other unit look cheap."""
    generator = torch.Generator().manual_seed(3)
    base = torch.rand(20_000, 16, generator=generator)
    twins = base + 1e-4 * torch.rand(20_000, 16, generator=generator)
    weight, bias = layer(4, 32)
    *_, found = without_units(moments_of(torch.cat([base, twins], dim=1), torch.ones(20_000, 4)), weight, bias)
    assert sorted(unit % 16 for unit in found.units.tolist()) == list(range(16))
    values = torch.cat([base, twins], dim=1)
    before, after = values @ weight.T + bias, values @ found.weight.T + found.bias
    torch.testing.assert_close(after, before, atol=1e-3, rtol=0)


def test_outputs_that_no_image_shows() -> None:
    values = torch.rand(100, 32)
    *_, found = without_units(torch.zeros(2, 33, 33, dtype=torch.float64), *layer(2, 32))
    assert torch.isfinite(found.weight).all() and len(found.units) == 16
    assert torch.isfinite(values @ found.weight.T + found.bias).all()


def test_what_an_image_changes_with_an_output(halfway: Make) -> None:
    """Summed over the Gaussians it is what it changes with the outputs' bias, opacity reduction and all."""
    trainer = halfway()
    model, look, camera = trainer.model, SampledView(2, 0.4), trainer.capture.cameras[2]
    found = output_sensitivities(trainer, model, trainer.capture, look, torch.Generator().manual_seed(5)).sum(0)
    gaussians, _ = trainer.deform(look.time, trainer.progress)
    image = rasterize(gaussians, camera, trainer.capture.background)
    signs = 2.0 * torch.randint(2, image.rgb.shape, generator=torch.Generator().manual_seed(5)) - 1
    image.rgb.backward(signs)
    expected = model.deformation.output_bias.grad
    model.zero_grad(set_to_none=True)
    torch.testing.assert_close(found, expected, rtol=1e-3, atol=1e-4 * float(expected.abs().max()))


def test_a_layer_keeps_sixteen_units() -> None:
    values = torch.rand(100, 40)
    found = without_units(moments_of(values, torch.ones(100, 2)), *layer(2, 40))
    assert [len(each.units) for each in found] == [36, 32, 28, 24, 20, 16]
    assert without_units(moments_of(values[:, :16], torch.ones(100, 2)), *layer(2, 16)) == []


def test_what_no_image_shows_has_no_moments(halfway: Make) -> None:
    trainer = halfway()
    looks = [SampledView(0, 0.25), SampledView(3, 0.75)]
    found = visible_moments(trainer, trainer.model, looks, 1, torch.Generator().manual_seed(0))
    assert found.shape == (14, 65, 65) and (found.diagonal(dim1=1, dim2=2)[:, -1] > 0).all()
    assert all(parameter.grad is None for parameter in trainer.model.parameters())
    trainer.model.canonical.opacity_logits.data -= 100.0  # nothing is drawn
    found = visible_moments(trainer, trainer.model, looks, 1, torch.Generator().manual_seed(0))
    assert not found.any()


def narrowed(trainer: Trainer) -> Trainer:
    generator, context = torch.Generator().manual_seed(0), compression(trainer)
    views, evaluator = context.sample_views(generator, 8), context.evaluator()
    context.compress(evaluator, prune_hidden_units(context, evaluator, views, generator))
    return trainer


def test_a_narrower_network_trains_saves_and_plays(halfway: Make, filmed: Path, tmp_path: Path) -> None:
    trainer = halfway(ANY_LOSS)
    field = trainer.model.deformation
    memory = trainer.optimizer.adam.state[field.output_weight]["exp_avg"].clone()
    rows = field.embedding_weight.detach().clone()
    narrowed(trainer)
    assert trainer.model.settings.hidden_width == len(field.bias) == 16
    assert field.modulation_weight.shape == field.embedding_weight.shape == (16, 32)
    units = [int((rows == row).all(1).nonzero()) for row in field.embedding_weight]
    assert torch.equal(trainer.optimizer.adam.state[field.output_weight]["exp_avg"], memory[:, units])
    last = compression(trainer).record.log[-1]
    assert (last.what, last.before, last.after) == ("network width", 64, 16) and last.bytes > 0
    before = field.bias.detach().clone()
    train(trainer)
    assert (field.bias != before).any()
    session = Session(TrainingJob(filmed, tmp_path / "a.frog", lossless=True), trainer)
    export_scene(session, session.output)
    played = ScenePlayer.load(tmp_path / "a.frog")
    assert played.header.model["hidden_width"] == 16
    expected = trainer.deform(0.4, 1.0)[0].means.detach().numpy()
    np.testing.assert_allclose(played.at(0.4).means, expected, atol=1e-5)


def test_a_network_that_is_needed_stays_as_it_is(halfway: Make) -> None:
    trainer = halfway(CompressionSettings(max_width_loss=-100.0))
    weight = trainer.model.deformation.output_weight.detach().clone()
    narrowed(trainer)
    assert trainer.model.settings.hidden_width == 64 and compression(trainer).record.log == []
    assert torch.equal(trainer.model.deformation.output_weight, weight)


@pytest.mark.parametrize("changes", [{"head_width": 16, "modulation": False}, {"fusion": "dual"}])
def test_networks_of_more_layers_stay_as_they_are(halfway: Make, changes: dict) -> None:
    trainer = halfway(**changes)
    width = trainer.model.settings.hidden_width
    assert "network width" not in [each.what for each in compression(narrowed(trainer)).record.log]
    assert trainer.model.settings.hidden_width == width


def test_a_narrow_training_is_resumed(make_trainer: Make, halfway: Make, tmp_path: Path) -> None:
    trainer = narrowed(halfway(ANY_LOSS))
    save_checkpoint(tmp_path / "c", trainer)
    other = make_trainer(120, capacity="auto", compression=ANY_LOSS)
    load_checkpoint(tmp_path / "c", other)
    assert other.model.settings.hidden_width == 16
    while not trainer.finished:
        trainer.step()
        other.step()
    for name, array in state_of(trainer)[0].items():
        assert (array == state_of(other)[0][name]).all(), name


def test_a_checkpoint_that_does_not_fit_leaves_the_width(make_trainer: Make, halfway: Make, tmp_path: Path) -> None:
    trainer = narrowed(halfway(ANY_LOSS))
    trainer.model.temporal_table.data = trainer.model.temporal_table.data[:3]
    save_checkpoint(tmp_path / "c", trainer)
    other = make_trainer(120, capacity="auto")
    with pytest.raises(FrogError, match="do not fit"):
        load_checkpoint(tmp_path / "c", other)
    assert other.model.settings.hidden_width == 64
    other.step()
