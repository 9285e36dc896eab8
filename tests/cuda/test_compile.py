"""Every CUDA kernel compiles for every generation of GPU and is kept; loading and launching it by a stand-in driver."""

import ctypes
import sys
from collections.abc import Callable
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import pytest
import torch
from emulated import HERE, Emulator, build
from support.equality import draw, scenes

from frog_blender.engine.cuda import compile as compiling
from frog_blender.engine.cuda import launch, nvrtc
from frog_blender.engine.cuda.sources import CHOICES, KERNELS, Kernel, kernel
from frog_blender.engine.errors import FrogError

ARCHITECTURES = (75, 89, 90)  # Turing, Ada, Hopper
PROJECT = kernel("project", SH_COUNT=1)
EVERY = [
    kernel(name, **dict(zip(choices, values, strict=True)))
    for name, choices in CHOICES.items()
    for values in product(*choices.values())
]


@pytest.mark.parametrize(("index", "which"), list(enumerate(EVERY)))
def test_compiles(index: int, which: Kernel, compiler: nvrtc.Compiler) -> None:
    """Each specialisation for one generation, each generation for a third of them."""
    code = compiler.build(which, compiler.target(ARCHITECTURES[index % len(ARCHITECTURES)]))
    assert code.startswith(b"\x7fELF")
    assert f".text.{which.name}\0".encode() in code


def test_every_file_is_compiled() -> None:
    assert {path.stem for path in KERNELS.glob("*.cu")} == CHOICES.keys()


def test_a_gpu_newer_than_the_compiler_gets_what_its_driver_can_finish(compiler: nvrtc.Compiler) -> None:
    target = compiler.target(999)
    assert target == f"compute_{compiler.architectures[-1]}"
    assert f".entry {PROJECT.name}".encode() in compiler.build(PROJECT, target)


def test_a_gpu_older_than_the_compiler_is_named(compiler: nvrtc.Compiler) -> None:
    with pytest.raises(FrogError, match=r"capability 3\.5; this version of CUDA starts at [5-9]\.\d\."):
        compiler.target(35)


def test_an_error_says_which_kernel_and_shows_the_log(compiler: nvrtc.Compiler) -> None:
    with pytest.raises(FrogError) as raised:
        compiler.build(Kernel("project", (("SH_COUNT", "no_such_number"),)), "sm_75")
    log = str(raised.value.__cause__)
    assert str(raised.value) == "The CUDA kernel project(SH_COUNT=no_such_number) did not compile for sm_75."
    assert "no_such_number" in log and "project.cu(" in log


def test_only_known_specialisations_can_be_asked_for() -> None:
    for name, constants in (("project", {"SH_COUNT": 2}), ("project", {}), ("emit", {"SH_COUNT": 1})):
        with pytest.raises(ValueError, match=name):
            kernel(name, **constants)


def test_without_a_compiler_a_sentence_says_what_is_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("FROG_NVRTC", "/no/such/libnvrtc.so")
    nvrtc.compiler.cache_clear()
    try:
        with pytest.raises(FrogError, match="NVRTC"):
            nvrtc.compiler()
    finally:
        nvrtc.compiler.cache_clear()


class Recorder:
    """In the compiler's place: makes up code, and counts."""

    version, architectures = (12, 0), (75, 90)

    def __init__(self) -> None:
        self.built: list[str] = []

    def target(self, capability: int) -> str:
        return f"sm_{capability}"

    def build(self, which: Kernel, target: str) -> bytes:
        self.built.append(target)
        return f"{which} {target}".encode()


@pytest.fixture
def recorder() -> Recorder:
    return Recorder()


def test_code_is_compiled_once(recorder: Recorder, tmp_path: Path) -> None:
    first = compiling.machine_code(PROJECT, 90, tmp_path / "a", compiler=recorder)
    assert first == compiling.machine_code(PROJECT, 90, tmp_path / "a", compiler=recorder)
    assert recorder.built == ["sm_90"]
    assert not list((tmp_path / "a").glob(".*.part"))


class IncludesOthers(Kernel):
    """A kernel whose headers have changed."""

    headers = {"types.h": "// changed"}


def test_anything_that_changes_the_code_has_a_file_of_its_own(recorder: Recorder, tmp_path: Path) -> None:
    compiling.machine_code(PROJECT, 90, tmp_path, compiler=recorder)
    compiling.machine_code(PROJECT, 75, tmp_path, compiler=recorder)
    compiling.machine_code(kernel("project", SH_COUNT=4), 90, tmp_path, compiler=recorder)
    recorder.version = (12, 1)
    compiling.machine_code(PROJECT, 90, tmp_path, compiler=recorder)
    compiling.machine_code(IncludesOthers(PROJECT.name, PROJECT.constants), 90, tmp_path, compiler=recorder)
    assert len(recorder.built) == len(list(tmp_path.iterdir())) == 5


@pytest.mark.parametrize("damage", [b"", b"frog kernel 1\n", b"something else altogether", None])
def test_a_damaged_file_is_compiled_again(damage: bytes | None, recorder: Recorder, tmp_path: Path) -> None:
    code = compiling.machine_code(PROJECT, 90, tmp_path, compiler=recorder)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]) if damage is None else damage)
    assert compiling.machine_code(PROJECT, 90, tmp_path, compiler=recorder) == code
    assert recorder.built == ["sm_90"] * 2 and path.read_bytes() == whole


def test_a_cache_that_cannot_be_written_only_costs_time(recorder: Recorder, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    for _ in range(2):
        assert compiling.machine_code(PROJECT, 90, tmp_path / "file" / "cache", compiler=recorder)
    assert len(recorder.built) == 2


def test_the_cache_lies_where_this_user_keeps_caches(
    recorder: Recorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path))
    compiling.machine_code(PROJECT, 90, compiler=recorder)
    assert len(list((tmp_path / "kernels").glob("project-sm_90-*.bin"))) == 1


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
