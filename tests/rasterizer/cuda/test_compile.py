"""Every CUDA kernel compiles for every generation of GPU, without a GPU; compiled code is kept on disk."""

from itertools import product
from pathlib import Path

import pytest

from frog_blender.engine.errors import FrogError
from frog_blender.engine.rasterizer.cuda import compile as compiling
from frog_blender.engine.rasterizer.cuda import nvrtc
from frog_blender.engine.rasterizer.cuda.sources import CHOICES, KERNELS, Kernel, kernel

ARCHITECTURES = (75, 89, 90)  # Turing, Ada, Hopper
EMIT = kernel("emit", TILE_KEY="short")
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
    assert f".entry {EMIT.name}".encode() in compiler.build(EMIT, target)


def test_a_gpu_older_than_the_compiler_is_named(compiler: nvrtc.Compiler) -> None:
    with pytest.raises(FrogError, match=r"capability 3\.5; this version of CUDA starts at [5-9]\.\d\."):
        compiler.target(35)


def test_an_error_says_which_kernel_and_shows_the_log(compiler: nvrtc.Compiler) -> None:
    with pytest.raises(FrogError) as raised:
        compiler.build(Kernel("emit", (("TILE_KEY", "no_such_type"),)), "sm_75")
    log = str(raised.value.__cause__)
    assert str(raised.value) == "The CUDA kernel emit(TILE_KEY=no_such_type) did not compile for sm_75."
    assert "no_such_type" in log and "emit.cu(" in log


def test_only_known_specialisations_can_be_asked_for() -> None:
    for name, constants in (("emit", {"TILE_KEY": "long"}), ("emit", {}), ("project", {"SH_COUNT": 2})):
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
    first = compiling.machine_code(EMIT, 90, tmp_path / "a", compiler=recorder)
    assert first == compiling.machine_code(EMIT, 90, tmp_path / "a", compiler=recorder)
    assert recorder.built == ["sm_90"]
    assert not list((tmp_path / "a").glob(".*.part"))


class IncludesOthers(Kernel):
    """A kernel whose headers have changed."""

    headers = {"types.h": "// changed"}


def test_anything_that_changes_the_code_has_a_file_of_its_own(recorder: Recorder, tmp_path: Path) -> None:
    compiling.machine_code(EMIT, 90, tmp_path, compiler=recorder)
    compiling.machine_code(EMIT, 75, tmp_path, compiler=recorder)
    compiling.machine_code(kernel("emit", TILE_KEY="int"), 90, tmp_path, compiler=recorder)
    recorder.version = (12, 1)
    compiling.machine_code(EMIT, 90, tmp_path, compiler=recorder)
    compiling.machine_code(IncludesOthers(EMIT.name, EMIT.constants), 90, tmp_path, compiler=recorder)
    assert len(recorder.built) == len(list(tmp_path.iterdir())) == 5


@pytest.mark.parametrize("damage", [b"", b"frog kernel 1\n", b"something else altogether", None])
def test_a_damaged_file_is_compiled_again(damage: bytes | None, recorder: Recorder, tmp_path: Path) -> None:
    code = compiling.machine_code(EMIT, 90, tmp_path, compiler=recorder)
    (path,) = tmp_path.iterdir()
    whole = path.read_bytes()
    path.write_bytes(whole[:-1] + bytes([whole[-1] ^ 1]) if damage is None else damage)
    assert compiling.machine_code(EMIT, 90, tmp_path, compiler=recorder) == code
    assert recorder.built == ["sm_90"] * 2 and path.read_bytes() == whole


def test_a_cache_that_cannot_be_written_only_costs_time(recorder: Recorder, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("no folder")
    for _ in range(2):
        assert compiling.machine_code(EMIT, 90, tmp_path / "file" / "cache", compiler=recorder)
    assert len(recorder.built) == 2


def test_the_cache_lies_where_this_user_keeps_caches(
    recorder: Recorder, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("FROG_CACHE", str(tmp_path))
    compiling.machine_code(EMIT, 90, compiler=recorder)
    assert len(list((tmp_path / "kernels").glob("emit-sm_90-*.bin"))) == 1
