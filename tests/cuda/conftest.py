"""The emulator in place of a GPU, for tests that ask for it."""

import sys
from collections.abc import Callable
from pathlib import Path

import pytest
import torch

from frog_blender.engine.cuda import launch, nvrtc
from frog_blender.engine.errors import FrogError

sys.path.insert(0, str(Path(__file__).parent / "emulator"))


@pytest.fixture(scope="session")
def compiler() -> nvrtc.Compiler:
    """NVRTC, where it is installed."""
    try:
        return nvrtc.compiler()
    except FrogError as error:
        pytest.skip(str(error))


@pytest.fixture(scope="session")
def built_emulator(tmp_path_factory: pytest.TempPathFactory):
    """Keeps the compiled kernels for the whole run."""
    import emulated

    if emulated.COMPILER is None:
        pytest.skip("the emulator compiles the kernels with g++ on Linux; there is none here")
    return emulated.Emulator(tmp_path_factory.mktemp("emulator"))


@pytest.fixture
def launch_on(monkeypatch: pytest.MonkeyPatch) -> Callable[[object], None]:
    """Makes kernels run on a device of the test's, whatever device the tensors are on."""

    def use(launcher: object) -> None:
        monkeypatch.setattr(launch, "launcher_for", lambda device: launcher)

    return use


@pytest.fixture
def emulator(built_emulator, launch_on: Callable[[object], None], monkeypatch: pytest.MonkeyPatch):
    """Kernels, compiled by g++, compute what tensors on the CPU ask for; float64 is left to torch."""
    launch_on(built_emulator)
    monkeypatch.setattr(launch, "on_gpu", lambda tensor: tensor.dtype != torch.float64)
    built_emulator.reset()
    return built_emulator
