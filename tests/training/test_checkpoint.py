"""Going on from a checkpoint is as if nothing had happened; one that does not fit is refused in a sentence."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from helpers import scene_file

from frog_blender.engine.errors import FrogError
from frog_blender.engine.files import write_scene
from frog_blender.engine.training.checkpoint import checkpoint_path, load_checkpoint, save_checkpoint
from frog_blender.engine.training.trainer import Trainer

Make = Callable[..., Trainer]
Bits = Callable[[Trainer], dict[str, bytes]]


def train(trainer: Trainer, until: int | None = None) -> Trainer:
    while not trainer.finished and trainer.step_count != until:
        trainer.step()
    return trainer


@pytest.mark.parametrize("method", ["frog", "static", "auto"])
@pytest.mark.parametrize("stop", [1, 33, 52, 75])  # before the first round, between rounds, within a burst
def test_resumed_bits_are_those_of_an_undisturbed_training(
    make_trainer: Make, bits: Bits, tmp_path: Path, method: str, stop: int
) -> None:
    changes = {"dssim_period": 25, "dssim_burst": 6}
    if method == "auto":
        method, changes = "frog", {**changes, "capacity": "auto"}
    undisturbed = train(make_trainer(80, method, seed=3, **changes))
    save_checkpoint(tmp_path / "c", train(make_trainer(80, method, seed=3, **changes), until=stop))
    resumed = make_trainer(80, method, seed=99, **changes)
    load_checkpoint(tmp_path / "c", resumed)
    assert resumed.step_count == stop and resumed.progress == stop / 80
    train(resumed)
    assert bits(resumed) == bits(undisturbed)
    assert resumed.loss == undisturbed.loss


def test_saving_disturbs_nothing(make_trainer: Make, bits: Bits, tmp_path: Path) -> None:
    undisturbed, trainer = train(make_trainer(40)), make_trainer(40)
    while not trainer.finished:
        trainer.step()
        if trainer.step_count % 9 == 0:
            save_checkpoint(tmp_path / "c", trainer)
    assert bits(trainer) == bits(undisturbed)
    assert [entry.name for entry in tmp_path.iterdir()] == ["c"]


def test_more_steps_may_be_asked_for(make_trainer: Make, tmp_path: Path) -> None:
    save_checkpoint(tmp_path / "c", train(make_trainer(20)))
    longer = make_trainer(40)
    load_checkpoint(tmp_path / "c", longer)
    assert longer.step_count == 20 and longer.progress == 0.5
    assert train(longer).step_count == 40


@pytest.mark.parametrize(
    ("method", "changes", "word"),
    [
        ("static", {}, "method"),
        ("frog", {"hidden_width": 32}, "hidden_width"),
        ("frog", {"sh_degree": 2, "dssim_weight": 0.1}, "sh_degree, dssim_weight"),
    ],
)
def test_another_training_is_refused(make_trainer: Make, tmp_path: Path, method: str, changes: dict, word: str) -> None:
    save_checkpoint(tmp_path / "c", train(make_trainer(20), until=3))
    with pytest.raises(FrogError, match=f"{word} differ"):
        load_checkpoint(tmp_path / "c", make_trainer(20, method, **changes))


def test_files_that_are_no_checkpoint(make_trainer: Make, tmp_path: Path) -> None:
    trainer = make_trainer(20)
    save_checkpoint(tmp_path / "c", train(trainer, until=2))
    content = (tmp_path / "c").read_bytes()
    write_scene(tmp_path / "scene", scene_file())
    (tmp_path / "empty").write_bytes(b"")
    (tmp_path / "cut").write_bytes(content[: len(content) // 2])
    (tmp_path / "other").write_bytes(b"\x80\x04\x95" + bytes(100))
    for name in ("scene", "empty", "cut", "other", "missing"):
        with pytest.raises(FrogError) as caught:
            load_checkpoint(tmp_path / name, make_trainer(20))
        assert "\n" not in str(caught.value) and str(tmp_path / name) in str(caught.value)
    assert checkpoint_path(tmp_path / "a.frog") == tmp_path / "a.frog.checkpoint"
