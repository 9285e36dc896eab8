"""Whole trainings whose every step runs the kernels, compiled for the CPU."""

import cv2
import numpy as np
import pytest
from emulated import Emulator
from support import synthetic_capture as film
from support.masked_capture import write_masks
from support.training_steps import bits, train

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.cuda import launch
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.options import JobOptions
from frog_blender.engine.recipes import recipe
from frog_blender.engine.training.optimize.trainer import Trainer

STEPS = 12
# Every kind of round within so many steps, bursts among them.
BUSY = {"dssim_from": 0.2, "dssim_period": 6, "dssim_burst": 2, "densify_threshold": 1e-6, "sampling_share": 0.05}
BUSY |= {"smoothness_sample": 64, "warm_up": 0.2, "max_gaussians": 100, "size_weight": 0.1}


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


def test_a_usual_step_launches_few_kernels(capture: Capture, store: FrameStore, emulator: Emulator) -> None:
    settings = recipe("draft", steps_per_moment=0, steps=4000, warm_up=0.0, densify_from=0.5)
    trainer = Trainer(capture, store, film.seeds(60), settings, JobOptions(method="frog"))
    for _ in range(3):
        emulator.launched.clear()
        trainer.step()
        assert len(emulator.launched) == 14
