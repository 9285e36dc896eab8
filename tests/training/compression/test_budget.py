"""Budgets of Gaussians and of bytes hold exactly, and a finished scene, packed or not, shows what it showed."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support.builders import odd_camera, refused, scene_file
from support.torch_player import TorchScenePlayer
from support.training_steps import Make, MakeJob, cancelled_at, compression, warnings_of

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.recipes import recipe
from frog_blender.engine.scene.scene_file import read_scene, write_scene
from frog_blender.engine.training.compression.budget import fit_within, with_budget
from frog_blender.engine.training.compression.settings import CompressionSettings
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.events import Cancelled, Finished, Started
from frog_blender.engine.training.session.export import as_packed, reorder_for_playback
from frog_blender.engine.training.session.run import run_training


def test_a_scene_is_grown_beyond_what_it_keeps_late() -> None:
    limits = [recipe("draft", max_gaussians=1000, capacity=capacity).growth_limit_at for capacity in ("auto", "fixed")]
    assert [limit(0.49) for limit in limits] == [1000, 1000] and [limit(0.5) for limit in limits] == [1075, 1000]


def most_while_trained(trainer: Trainer) -> int:
    """Gaussians that it had after any of its steps."""
    most = 0
    while not trainer.finished:
        trainer.step()
        most = max(most, trainer.count)
    return most


@pytest.mark.parametrize(("capacity", "grown"), [("auto", 344), ("fixed", 320)])
def test_the_most_gaussians_are_never_exceeded(make_trainer: Make, capacity: str, grown: int) -> None:
    """A little more while it grows, where what images do not miss is left out later."""
    trainer = make_trainer(60, capacity=capacity, max_gaussians=320)
    assert 0.95 * grown < most_while_trained(trainer) <= grown == trainer.recipe.growth_limit_at(1.0)
    assert trainer.count <= 320


def test_not_even_by_the_seeds(make_job: MakeJob, quick_seeds: None) -> None:
    assert list(run_training(make_job(20, {"seeds": None}, max_gaussians=150)))[-1].gaussians <= 150


def test_a_training_may_grow_beyond_what_it_keeps(make_trainer: Make) -> None:
    trainer = make_trainer(60, capacity="auto", max_gaussians=600, kept_gaussians=250)
    assert most_while_trained(trainer) > 300 and 200 < trainer.count <= 250
    pruned = [step for step in compression(trainer).log if step.what == "pruned"]
    assert any(step.before > 250 >= step.after for step in pruned)


def test_a_cancelled_training_keeps_no_more_either(make_job: MakeJob) -> None:
    """And goes on from all that it had."""
    task = make_job(60, capacity="auto", max_gaussians=600, kept_gaussians=250)
    assert isinstance(cancelled_at(task, 40)[-1], Cancelled)
    assert ScenePlayer.load(task.output).count == 250
    begun = next(event for event in run_training(replace(task, resume=True)) if isinstance(event, Started))
    assert begun.gaussians > 250


def test_recipes_with_a_budget() -> None:
    draft = recipe("draft", capacity="auto")
    for count, most in ((20_000, 25_000), (10_000, 20_000), (40_000, 40_000)):
        budgeted = with_budget(draft, count, "frog")
        assert (budgeted.kept_gaussians, budgeted.max_gaussians) == (count, most)
    for other in (with_budget(draft, 20_000, "ed3dgs"), with_budget(recipe("draft", capacity="fixed"), 20_000, "frog")):
        assert (other.kept_gaussians, other.max_gaussians) == (0, 20_000)


def test_a_budget_of_bytes_holds_exactly(make_job: MakeJob, tmp_path: Path) -> None:
    small = {"capacity": "auto", "hidden_width": 32, "temporal_size": 32}  # of whose file Gaussians are the most
    sizes, counts, limits = {}, {}, {}
    for name, share in (("a", 0.0), ("b", 0.86)):
        most = limits[name] = int(share * sizes.get("a", 0)) or None
        path = tmp_path / f"{name}.frog"
        finished = list(run_training(make_job(60, {"output": path, "max_bytes": most}, **small)))[-1]
        sizes[name], counts[name] = path.stat().st_size, ScenePlayer.load(path).count
        assert counts[name] == finished.capacity["gaussians"] == finished.gaussians
    assert limits["b"] - 5_000 < sizes["b"] <= limits["b"]
    assert counts["a"] > counts["b"]


def test_a_budget_that_one_gaussian_meets_is_met(make_trainer: Make) -> None:
    """The first guess of what each takes may be far off: all bytes but a few are common to all of them."""
    trainer = make_trainer(10, capacity="auto")
    fit_within(compression(trainer), lambda: 90_000 + trainer.count, 90_001)
    assert trainer.count == 1
    refused("a single Gaussian takes 90001", fit_within, compression(trainer), lambda: 90_000 + trainer.count, 90_000)


def test_a_budget_that_was_too_small_can_be_raised(make_job: MakeJob) -> None:
    """A doubtful one is named before the training, which is not lost when it proves too small."""
    settings = CompressionSettings(max_final_freeze_loss=-100.0, max_prune_loss=-100.0, max_freeze_loss=-100.0)
    task = make_job(30, {"compression": settings}, capacity="auto")
    sentence = refused("expected at least", list, run_training(replace(task, max_bytes=100)))
    least = int(sentence.split()[-1].rstrip("."))
    told = []
    refused("resume it", told.extend, run_training(replace(task, max_bytes=least + 300)))
    assert any("may be too small" in message for message in warnings_of(told)) and not task.output.exists()
    finished = list(run_training(replace(task, resume=True, max_bytes=2 * least)))[-1]
    assert isinstance(finished, Finished) and task.output.stat().st_size <= 2 * least


@pytest.mark.parametrize("moving", [1, 201, 300])
def test_the_order_is_nobodys_matter(moving: int) -> None:
    plain = scene_file(300, moving=moving)
    scene, camera = reorder_for_playback(plain), odd_camera()
    assert not np.array_equal(scene.arrays["means"], plain.arrays["means"])
    ordered, before = (ScenePlayer(file).at(0.25) for file in (scene, plain))
    np.testing.assert_allclose(draw(ordered, camera).rgb, draw(before, camera).rgb, atol=1e-5)


@pytest.mark.parametrize("compact", [False, True])
def test_files_keep_them(tmp_path: Path, compact: bool) -> None:
    scene = reorder_for_playback(scene_file(300, moving=201))
    write_scene(tmp_path / "a.frog", scene, compact=compact)
    back = read_scene(tmp_path / "a.frog")
    expected = as_packed(scene) if compact else scene
    assert back.arrays.keys() == expected.arrays.keys()
    for name, array in expected.arrays.items():
        np.testing.assert_array_equal(back.arrays[name], array, err_msg=name)
    on_device, played = TorchScenePlayer(back).at_frame(1.5), ScenePlayer(back).at_frame(1.5)
    np.testing.assert_allclose(on_device.opacities.numpy(), played.opacities, atol=1e-5)


@pytest.mark.parametrize("worst", [-100.0, 100.0])
def test_where_packing_shows_files_stay_plain(make_job: MakeJob, tmp_path: Path, worst: float) -> None:
    task = make_job(60, {"compression": CompressionSettings(max_packing_loss=worst)}, capacity="auto")
    finished = list(run_training(task))[-1]
    scene, size = read_scene(task.output), task.output.stat().st_size
    is_packed = finished.capacity["reductions"][-1]["what"] == "packed"
    assert scene.header.capacity == finished.capacity and is_packed == (worst > 0)
    assert is_packed == (size < sum(array.nbytes for array in scene.arrays.values()))
    if is_packed:
        list(run_training(replace(task, output=tmp_path / "y.frog", max_bytes=int(0.9 * size))))
        assert (tmp_path / "y.frog").stat().st_size <= 0.9 * size
