"""Loading and launching through a stand-in for the driver, and where the compiler is looked for."""

import ctypes
import sys
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from emulated import HERE, Emulator, build
from support.equality import draw, scenes

from frog_blender.engine.errors import FrogError
from frog_blender.engine.rasterizer.cuda import launch, nvrtc
from frog_blender.engine.rasterizer.cuda.sources import Kernel

SCENE = scenes()["pose of one colour"]


@pytest.fixture
def driver(built_emulator: Emulator) -> ctypes.CDLL:
    """``fake_driver.cpp`` in the place of libcuda."""
    path = built_emulator.folder / "fake_driver.so"
    if not path.exists():
        build(HERE / "fake_driver.cpp", path)
    return launch.load_driver(str(path))


@pytest.fixture
def device(driver: ctypes.CDLL, built_emulator: Emulator) -> launch.Device:
    """One pretended GPU of compute capability 9.0."""
    properties = SimpleNamespace(total_memory=8 << 30, major=9, minor=0, name="Pretended GPU")
    stream = SimpleNamespace(cuda_stream=0x7F00AAAABBBB, synchronize=lambda: None)
    cuda = SimpleNamespace(get_device_properties=lambda index: properties, current_stream=lambda index: stream)

    def code(kernel: Kernel, capability: int) -> bytes:
        assert capability == 90
        built_emulator.library(kernel)
        name = "_".join([kernel.name, *[value for _, value in kernel.constants]])
        return str(built_emulator.folder / f"{name}.so").encode()

    return launch.Device(0, driver=driver, code=code, cuda=cuda)


def test_draws_through_the_driver(
    driver: ctypes.CDLL, device: launch.Device, built_emulator: Emulator, launch_on: Callable[[object], None]
) -> None:
    launch_on(device)
    through_driver = draw(SCENE, "cuda", torch.float32)
    launch_on(built_emulator)
    direct = draw(SCENE, "cuda", torch.float32)
    for name, values in direct.items():
        assert (through_driver[name] == values).all(), name
    assert driver.fake_depth() == 0 and driver.fake_contexts() >= 1


def test_a_failed_launch_is_a_sentence_and_leaves_no_context_behind(
    driver: ctypes.CDLL, device: launch.Device, launch_on: Callable[[object], None]
) -> None:
    launch_on(device)
    for status, reason in ((719, "unspecified launch failure"), (1, "error 1")):
        driver.fake_fail(status)
        try:
            with pytest.raises(FrogError, match=rf"Pretended GPU, project\(SH_COUNT=1\): .*\({reason}\)"):
                draw(SCENE, "cuda", torch.float32)
        finally:
            driver.fake_fail(0)
    assert driver.fake_depth() == 0


def test_a_missing_driver_is_named() -> None:
    with pytest.raises(FrogError, match=r"libcuda-of-nobody.* driver could not be loaded"):
        launch.load_driver("libcuda-of-nobody.so.1")


@pytest.mark.parametrize(("cuda", "first"), [("12.8", "12"), ("13.0", "13"), (None, "13")])
@pytest.mark.skipif(sys.platform == "win32", reason="names of Linux")
def test_the_compiler_of_torchs_own_cuda_comes_first(
    cuda: str | None, first: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("libnvrtc.so.12", "libnvrtc.so.13", "libnvrtc.alt.so.12", "libnvrtc-builtins.so.12.9"):
        (tmp_path / name).touch()
    monkeypatch.delenv("FROG_NVRTC", raising=False)
    found = nvrtc.library_candidates([tmp_path], cuda)
    assert found[0] == str(tmp_path / f"libnvrtc.so.{first}")
    assert len(found) == 4 and not any("alt" in path or "builtins" in path for path in found)
    assert found[2] == f"libnvrtc.so.{first}"  # then whatever the loader finds by name
