"""Whole trainings whose every step runs the kernels, compiled for the CPU."""

from collections.abc import Iterator

import cv2
import numpy as np
import pytest
from emulated import Emulator
from support import synthetic_capture as film
from support.fake_device import ELSEWHERE, Machine
from support.masked_capture import write_masks
from support.training_steps import bits, train

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.cuda import launch
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.options import JobOptions
from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.optimize.neighbours import SMOOTHED_EVERY
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.checkpoint import restore, state_of

STEPS = 12
# Every kind of round within so many steps, bursts among them.
BUSY = {"dssim_from": 0.2, "dssim_period": 6, "dssim_burst": 2, "densify_threshold": 1e-6, "sampling_share": 0.05}
BUSY |= {"smoothness_sample": 64, "warm_up": 0.2, "max_gaussians": 100, "size_weight": 0.1}

QUIET = {"densify_from": 2.0, "sampling": "off", "warm_up": 0.0, "dssim_from": 0.0, "exposure_from": 1.0}
USUAL = {"field", "project", "scan", "emit", "sort", "blend", "loss", "blend_backward", "project_backward"}
USUAL |= {"field_backward", "field_sums", "field_table", "adam"}


@pytest.fixture(scope="module")
def masked(tmp_path_factory: pytest.TempPathFactory) -> tuple[Capture, FrameStore]:
    """The subject alone, and a mark in one camera's images that does not count."""
    folder = film.write_capture(tmp_path_factory.mktemp("masked") / "film")
    write_masks(folder / "masks", "numbered")
    (folder / "ignore").mkdir()
    mark = np.zeros((film.HEIGHT, film.WIDTH), np.uint8)
    mark[4:16, 6:22] = 255
    cv2.imwrite(str(folder / "ignore" / "cam02.png"), mark)
    capture = open_capture(folder)
    return capture, FrameStore.open(capture, cache_folder=tmp_path_factory.mktemp("cache"))


@pytest.mark.parametrize("subject", ["everything", "masked"])
def test_it_learns_what_the_processor_learns(
    subject: str, request: pytest.FixtureRequest, emulator: Emulator, monkeypatch: pytest.MonkeyPatch
) -> None:
    if subject == "masked":
        capture, store = request.getfixturevalue("masked")
    else:
        capture, store = (request.getfixturevalue(name) for name in ("capture", "store"))

    def trained() -> Trainer:
        options = JobOptions(method="frog", seed=3, steps=STEPS)
        trainer = train(Trainer(capture, store, film.seeds(60), recipe("draft", **BUSY), options))
        trainer.check()
        return trainer

    found = trained()
    emulator.turned = True
    assert bits(trained()) == bits(found)
    monkeypatch.setattr(launch, "on_gpu", lambda tensor: False)
    expected = trained()
    assert found.count == expected.count > 60
    assert found.loss == pytest.approx(expected.loss, rel=1e-3)
    assert found.evaluate(2)[0] == pytest.approx(expected.evaluate(2)[0], abs=0.1)


@pytest.fixture
def machine(emulator: Emulator, monkeypatch: pytest.MonkeyPatch) -> Iterator[Machine]:
    monkeypatch.setattr(launch, "on_gpu", lambda tensor: tensor.device == ELSEWHERE)
    with Machine() as machine:
        yield machine


def quiet(capture: Capture, store: FrameStore, **changes: float) -> Trainer:
    """On a pretended GPU, after three steps of very many, so that no round comes soon."""
    settings = recipe("standard", **{**QUIET, **changes})
    trainer = Trainer(capture, store, film.seeds(60), settings, JobOptions(steps=10_000), ELSEWHERE)
    return train(trainer, until=3)


def test_a_step_whose_image_had_no_room_is_made_again(
    machine: Machine, emulator: Emulator, capture: Capture, store: FrameStore
) -> None:
    found, launched = [], []
    for has_room in (True, False):
        emulator.launched.clear()
        trainer = quiet(capture, store)
        if not has_room:
            assert trainer.model.pair_room is not None
            trainer.model.pair_room.pairs = 10
        found.append(bits(train(trainer, until=6)))
        launched.append(sum(kernel.name == "adam" for kernel in emulator.launched))
    assert launched == [6, 7]
    assert found[0] == found[1]
    restore(trainer, state_of(trainer))
    assert trainer.model.pair_room is not None and not trainer.model.pair_room.pairs  # it may have been too much


@pytest.mark.parametrize("progress", [0.0, 0.1, 0.95])
@pytest.mark.parametrize("dssim_from", [0.0, 2.0])
def test_a_usual_step_launches_little_and_waits_for_nothing(
    progress: float, dssim_from: float, machine: Machine, emulator: Emulator, capture: Capture, store: FrameStore
) -> None:
    """With poses and all colours learned, too; what smooths the temporal table comes in every fourth."""
    trainer = quiet(capture, store, dssim_from=dssim_from, dssim_period=1, dssim_burst=1)
    trainer.step_count += round(10_000 * progress)
    train(trainer, until=trainer.step_count + 2)
    trainer.smoothness.resample()
    for _ in range(SMOOTHED_EVERY):
        emulator.launched.clear()
        machine.work.clear()
        machine.waits.clear()
        trainer.step()
        names = [kernel.name for kernel in emulator.launched]
        assert set(names) >= USUAL
        assert not machine.waits
        smoothed = 4 * (trainer.step_count % SMOOTHED_EVERY == 1)
        assert len(names) + sum(machine.work.values()) <= 30 + smoothed
