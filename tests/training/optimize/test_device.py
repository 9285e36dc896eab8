"""Training on another device than the CPU, without having one: on a pretended GPU (``elsewhere``)."""

import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from support import synthetic_capture as film
from support.builders import refused, run_python
from support.fake_device import ELSEWHERE, Machine, Remote
from support.training_steps import Make, bits, compression, train

from frog_blender.cli.main import main
from frog_blender.engine.errors import FrogError
from frog_blender.engine.model import interface as interface_module
from frog_blender.engine.rasterizer import rasterize
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.training.compression import sensitivity, validation
from frog_blender.engine.training.compression.settings import CompressionSettings
from frog_blender.engine.training.optimize import device as device_module
from frog_blender.engine.training.optimize import losses, neighbours, training
from frog_blender.engine.training.optimize import trainer as trainer_module
from frog_blender.engine.training.optimize.camera_refinement import ExposureCompensation
from frog_blender.engine.training.optimize.device import choose_device
from frog_blender.engine.training.optimize.losses import PhotometricLoss, photometric_loss_reference
from frog_blender.engine.training.optimize.optimizer import NativeAdam
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.optimize.training import TrainingDiverged
from frog_blender.engine.training.optimize.trial import try_step
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.checkpoint import restore, state_of
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.output_paths import checkpoint_path
from frog_blender.engine.training.session.run import run_training

ENGINE = Path(trainer_module.__file__).parents[2]
CPU = torch.device("cpu")
STEPS = 16
# Every kind of round within so many steps, bursts among them.
BUSY = {"dssim_period": 6, "dssim_burst": 2, "densify_threshold": 1e-6, "sampling_share": 0.05, "smoothness_sample": 64}


def photometric_loss_on_any_device(
    image: torch.Tensor, pixels: torch.Tensor, terms: Mapping[str, float], weight: float
) -> PhotometricLoss:
    """As a GPU has it: the library's differs in the last bits."""
    return photometric_loss_reference(image, pixels.float() / 255, terms, weight)


def plain_step(adam: NativeAdam, state: None = None, again: bool = False) -> None:
    """Of torch alone."""
    for group in adam.param_groups:
        for parameter in (each for each in group["params"] if each.grad is not None):
            memory = adam.state[parameter]
            if not memory:
                memory.update(step=0, exp_avg=torch.zeros_like(parameter), exp_avg_sq=torch.zeros_like(parameter))
            memory["step"] += 1
            (first, second), count = group["betas"], memory["step"]
            memory["exp_avg"].lerp_(parameter.grad, 1 - first)
            memory["exp_avg_sq"].lerp_(parameter.grad.square(), 1 - second)
            root = memory["exp_avg_sq"].sqrt() * (1 - second**count) ** -0.5 + group["eps"]
            parameter.data -= group["lr"] / (1 - first**count) * memory["exp_avg"] / root


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Iterator[Machine]:
    """A pretended GPU, and everywhere the operations in plain torch that both devices have."""
    machine = Machine(ENGINE / "training", ENGINE / "model")

    def slowly(*arguments: Any, **keywords: Any) -> Any:
        with machine.uncounted():  # the CUDA rasterizer waits once, whatever is drawn
            return rasterize(*arguments, **{**keywords, "backend": "reference"})

    for module in (training, interface_module, sensitivity, validation):
        monkeypatch.setattr(module, "rasterize", slowly)
    monkeypatch.setattr(losses, "photometric_loss", photometric_loss_on_any_device)
    monkeypatch.setattr(neighbours, "by_tree", neighbours.by_distances)
    monkeypatch.setattr(NativeAdam, "step", torch.no_grad()(plain_step))
    with machine:
        yield machine


class InPlainTorch(Trainer):
    """Whose model is computed by what both devices have."""

    def __init__(self, *arguments: Any, **named: Any) -> None:
        super().__init__(*arguments, **named)
        self.model.backend = "reference"


class Elsewhere(InPlainTorch):
    """Trains there whatever device it is given."""

    def __init__(self, *arguments: Any) -> None:
        super().__init__(*arguments[:-1], ELSEWHERE)


@pytest.fixture
def make(make_trainer: Make) -> Make:
    def make(device: torch.device, method: str = "frog", **changes: Any) -> Trainer:
        there = partial(InPlainTorch, device=device)
        return make_trainer(STEPS, method, trainer_type=there, seeds=80, **{"seed": 3, **BUSY, **changes})

    return make


def lies_elsewhere(trainer: Trainer) -> set[bool]:
    """Of all that grows with the Gaussians."""
    kinds, arrays = ("model.", "adam.", "density.", "neighbourhood."), trainer.state()[0]
    return {isinstance(arrays[name], Remote) for name in arrays if name.startswith(kinds) and arrays[name].dim()}


def with_exposures(trainer: Trainer) -> Trainer:
    cameras = [camera.with_exposure((1.2, 1.0, 0.8)) for camera in trainer.capture.cameras]
    trainer.rig.capture = trainer.capture.with_cameras(cameras)
    return trainer


@pytest.mark.parametrize("method", ["frog", pytest.param("static", marks=pytest.mark.slow)])
def test_it_learns_elsewhere_what_it_learns_here(machine: Machine, make: Make, method: str) -> None:
    """Half there, then from a checkpoint here, and there again: any two devices mixed in one operation fail on the
    way."""
    here = train(with_exposures(make(CPU, method)))
    first = train(with_exposures(make(ELSEWHERE, method)), until=STEPS // 2)
    second = make(CPU, method, seed=99)
    restore(second, state_of(first))
    there = make(ELSEWHERE, method, seed=100)
    restore(there, state_of(train(second, until=STEPS - 2)))
    train(there)
    assert there.count > 80 and there.step_count == STEPS
    assert lies_elsewhere(there) == {True} and lies_elsewhere(here) == {False}
    assert bits(there) == bits(here)
    assert there.loss == pytest.approx(here.loss, rel=1e-5)
    assert there.exposures is not None and bool((there.exposures.sums.cpu() > 0).any())
    assert there.evaluate(2) == here.evaluate(2)
    assert type(there.render_image(0)) is np.ndarray and there.render_image(0).dtype == np.float32
    assert there.smoothness.graph is not None or method == "static"
    assert not machine.homeless


def test_compression_is_the_same_elsewhere(machine: Machine, make: Make) -> None:
    few = {"num_sensitivity_views": 2, "num_training_views": 2, "num_weight_views": 3}
    any_loss = {"freeze_score": 1e9, "max_freeze_loss": 1e9, "max_final_freeze_loss": 1e9}
    settings = CompressionSettings(**few, **any_loss)
    there, here = (train(make(device, compression=settings, capacity="auto")) for device in (ELSEWHERE, CPU))
    logs = [compression(trainer).log for trainer in (there, here)]
    done, expected = ([(step.what, step.before, step.after) for step in log] for log in logs)
    assert done == expected
    assert "frozen" in {what for what, _, _ in done}
    assert lies_elsewhere(there) == {True} and bits(there) == bits(here)
    assert not machine.homeless


def test_the_watch_notices_what_is_made_without_saying_where() -> None:
    """And mixtures, and numpy views: the tests above would be worth nothing otherwise."""
    with Machine(Path(__file__).parent) as machine:
        torch.zeros(3, device="cpu")
        assert not machine.homeless
        torch.zeros(3)
        assert len(machine.homeless) == 1
        remote = torch.ones(3, device=ELSEWHERE)
        with pytest.raises(AssertionError, match="on the CPU together with"):
            remote + torch.ones(3, device="cpu")
        with pytest.raises(RuntimeError):
            remote.numpy()
        assert not machine.waits
        assert float(remote.sum()) == 3 and sum(machine.waits.values()) == 1


def test_a_step_waits_for_nothing(machine: Machine, make: Make) -> None:
    """Two small copies come back by themselves. Pixels are measured every hundredth of a training, which so few steps
    all are."""
    trainer = make(ELSEWHERE, least_size=0.0, densify_from=2.0, sampling="off", dssim_from=0.0, warm_up=0.0)
    trainer.exposures = ExposureCompensation(trainer.rig, trainer.recipe, ELSEWHERE, every=1.0)  # never updated
    trainer.steps = 30
    train(trainer, until=2)
    trainer.smoothness.resample()
    machine.waits.clear()
    machine.fetches = 0
    for _ in range(17):
        trainer.step()
    assert not machine.waits
    assert machine.fetches == 2 * 17


def test_a_job_elsewhere_writes_a_scene_and_goes_on(
    machine: Machine, filmed: Path, tmp_path: Path, own_cache: Path, lively: Any
) -> None:
    settings = {"recipe": lively(5), "seeds": film.seeds(80), "device": "cpu"}
    task = TrainingJob(filmed, tmp_path / "x.frog", steps=3, **settings)
    stream = list(run_training(task, trainer_type=Elsewhere))
    assert next(event for event in stream if isinstance(event, events.Started)).device == ELSEWHERE.type
    assert any(isinstance(event, events.Preview) and event.image.dtype == np.uint8 for event in stream)
    assert isinstance(stream[-1], events.Finished) and checkpoint_path(task.output).is_file()
    assert np.isfinite(read_scene(task.output).arrays["means"]).all()
    stream = list(run_training(replace(task, steps=5, resume=True), trainer_type=InPlainTorch))
    assert next(event for event in stream if isinstance(event, events.Started)).device == "cpu"
    assert isinstance(stream[-1], events.Finished) and stream[-1].steps == 5


@pytest.mark.parametrize(("device", "seen"), [(CPU, 2), (ELSEWHERE, 3)], ids=str)
def test_a_loss_that_is_not_a_number_is_seen(
    device: torch.device, seen: int, machine: Machine, make: Make, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Elsewhere when the next step begins, or before something is saved."""
    trainer = train(make(device), until=2)
    trainer.check()
    shown = trainer.loss
    monkeypatch.setattr(losses, "l1", lambda image, truth: (image * torch.nan).mean())
    with pytest.raises(TrainingDiverged, match=r"unstable at step 2 \(the loss"):
        trainer.step()
        trainer.state()
    assert trainer.loss == shown and trainer.step_count == seen


def test_the_loss_that_is_shown_is_a_running_mean(make: Make) -> None:
    trainer, means = make(CPU), [math.nan]
    for _ in range(3):
        trainer.step()
        newest = sum(trainer.loss_terms.values())
        means.append(newest if math.isnan(means[-1]) else 0.98 * means[-1] + 0.02 * newest)
        assert trainer.loss == pytest.approx(means[-1])


GPU = torch.device("cuda", 0)


@pytest.fixture
def find_gpu(monkeypatch: pytest.MonkeyPatch) -> Callable[..., None]:
    """Torch sees this GPU, or none, and ``trial`` draws on it."""

    def find(gpu: torch.device | None, trial: Callable[[torch.device], None] = lambda device: None) -> None:
        monkeypatch.setattr(device_module, "first_gpu", lambda: gpu)
        monkeypatch.setattr(device_module, "try_step", trial)

    return find


def test_automatic_takes_the_gpu_where_there_is_one(find_gpu: Callable[..., None]) -> None:
    find_gpu(GPU)
    assert choose_device("auto") == choose_device("cuda") == (GPU, "")
    assert choose_device("cpu") == (CPU, "")
    find_gpu(None)
    assert choose_device("auto") == choose_device("cpu") == (CPU, "")
    refused("device is 'tpu', expected one of auto, cpu, cuda", choose_device, "tpu")


@pytest.mark.parametrize(
    "error",
    [FrogError("The kernel did not compile.\nline 1: bad"), RuntimeError("no driver"), OSError("gone")],
    ids=str,
)
def test_a_gpu_that_cannot_be_used_is_left_aside_with_a_word(find_gpu: Callable[..., None], error: Exception) -> None:
    def refuse(device: torch.device) -> None:
        raise error

    find_gpu(GPU, refuse)
    device, left_aside = choose_device("auto")
    assert device == CPU and left_aside.endswith(".") and "\n" not in left_aside
    assert str(error).split("\n")[0].rstrip(".") in left_aside
    refused("'cuda' cannot be used: ", choose_device, "cuda")


def test_the_trial_step_is_right_and_would_notice(monkeypatch: pytest.MonkeyPatch) -> None:
    try_step(CPU)
    step = NativeAdam.step
    monkeypatch.setattr(NativeAdam, "step", lambda adam: [step(adam), step(adam)])
    refused("A step's step on the device cpu is not what plain torch finds", try_step, CPU)


def test_what_cannot_be_had_is_one_sentence(
    filmed: Path, tmp_path: Path, find_gpu: Callable[..., None], capsys: pytest.CaptureFixture[str]
) -> None:
    find_gpu(None)
    assert main(["train", str(filmed), "--out", str(tmp_path / "x.frog"), "--device", "cuda"]) == 1
    said = capsys.readouterr().err
    assert said.startswith("frog: ") and "sees no NVIDIA GPU" in said and said.count("\n") == 1
    assert not (tmp_path / "x.frog").exists()


def test_torchs_threads_sleep_while_they_wait_and_nobody_inherits_that() -> None:
    """OpenMP says itself with which settings it began."""
    code = "import os, frog_blender.engine.training.session.run; print(os.environ.get('OMP_WAIT_POLICY'))"
    done = run_python(code, OMP_DISPLAY_ENV="TRUE")
    assert done.stdout == "None\n", done.stderr
    if "OMP_WAIT_POLICY" in done.stderr:  # not every library says it
        assert "OMP_WAIT_POLICY = 'PASSIVE'" in done.stderr
    done = run_python(code, OMP_WAIT_POLICY="ACTIVE")
    assert done.stdout == "ACTIVE\n", "what somebody chose stays"
