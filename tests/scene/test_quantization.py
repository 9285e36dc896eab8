"""Packed arrays come back within half a step, in little room, or are refused; and what is said of capacity."""

import json
import tracemalloc
import zlib
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from safetensors import safe_open
from safetensors.numpy import save
from support.builders import pairwise, refused, scene_file, steps_between

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene import quantization
from frog_blender.engine.scene.compression_report import lines, reduction_line, summary
from frog_blender.engine.scene.quantization import BLOCK, pack, unpack
from frog_blender.engine.scene.scene_file import read_scene, write_scene

QUANTISED = [name for name, bits in quantization.BITS.items() if bits > 1]


@pytest.mark.parametrize("name", QUANTISED)
@pytest.mark.parametrize("count", [1, 2, BLOCK - 1, BLOCK, BLOCK + 1, 3000])
def test_every_number_is_within_half_a_step_of_its_block(name: str, count: int) -> None:
    random = np.random.default_rng(count)
    shape = {"sh": (count, 4, 3), "opacity_logits": (count,)}.get(name, (count, 3))
    array = np.float32(random.normal(0, 3, shape) + 100 * random.normal(size=shape[1:]))
    packed = pack(name, array)
    actual = unpack(packed.content, packed.description)
    assert actual.shape == shape and actual.dtype == np.float32
    for start in range(0, count, BLOCK):
        block, back = (values[start : start + BLOCK].reshape(-1, int(np.prod(shape[1:]))) for values in (array, actual))
        step = (block.max(axis=0) - block.min(axis=0)) / (2 ** quantization.BITS[name] - 1)
        assert (np.abs(back - block) <= 0.51 * step + 1e-5 * np.abs(block)).all()


@pytest.mark.parametrize("shape", [(7, 5), (0, 3), ()])
def test_other_arrays_keep_half_precision(shape: tuple[int, ...]) -> None:
    array = np.float32(np.random.default_rng(0).normal(size=shape))
    for name in ("means", "network.bias") if shape == (0, 3) else ("network.bias",):
        packed = pack(name, array)
        np.testing.assert_array_equal(unpack(packed.content, packed.description), array.astype(np.float16))


@pytest.mark.parametrize(("name", "value"), [("means", np.nan), ("sh", np.inf), ("network.bias", 1e6)])
def test_numbers_that_cannot_be_packed(name: str, value: float) -> None:
    with pytest.raises(ValueError, match=name):
        pack(name, np.full((5, 3), value, np.float32))


@pytest.mark.parametrize("moving", [40, 13])
def test_a_packed_scene_plays_as_the_plain_one(tmp_path: Path, moving: int) -> None:
    scene = scene_file(moving=moving)
    write_scene(tmp_path / "plain.frog", scene)
    write_scene(tmp_path / "packed.frog", scene, compact=True)
    plain, packed = (ScenePlayer.load(tmp_path / f"{name}.frog") for name in ("plain", "packed"))
    assert packed.num_dynamic == moving
    for time in (0.0, 0.4, 1.0):
        for name, values in plain.at(time).arrays.items():
            np.testing.assert_allclose(getattr(packed.at(time), name), values, rtol=0.05, atol=0.06, err_msg=name)


def with_packing(path: Path, change: dict | str) -> None:
    """Writes a packed scene whose description of ``means`` is changed, or all of which is the text."""
    write_scene(path, scene_file(), compact=True)
    with safe_open(str(path), framework="numpy") as file:
        arrays, metadata = {name: file.get_tensor(name) for name in file.keys()}, dict(file.metadata())  # noqa: SIM118
    packing = json.loads(metadata["packing"])
    if isinstance(change, dict):
        packing["means"] = {**packing["means"], **change}
    metadata["packing"] = json.dumps(packing) if isinstance(change, dict) else change
    path.write_bytes(save(arrays, metadata=metadata))


@pytest.mark.parametrize(
    "change",
    [
        *({"shape": shape} for shape in ([41, 3], [39, 3], [40, 4], [2**40, 3], [-40, 3])),
        *({"shape": shape} for shape in ([], "ab", None, {}, [40.5, 3], [40.0, 3], [True, 3], [1e30], [2**80, 3])),
        *({"bits": bits} for bits in (0, 8, 3, -8, 64, None, "many", [8], 1e300)),
        *({"shape": [-5, -3], "bits": bits} for bits in (0, True, 16.0)),
        *("[" * 100_000, "{", "null", '{"means": 3}', '{"nothing": {"shape": [1], "bits": 8}}', '{"means": {}}'),
    ],
    ids=lambda change: str(change)[:40],
)
def test_descriptions_that_do_not_fit_are_one_sentence(tmp_path: Path, change: dict | str) -> None:
    with_packing(tmp_path / "x.frog", change)
    refused("x.frog", read_scene, tmp_path / "x.frog")


def test_a_bomb_is_refused_before_it_is_unpacked() -> None:
    bomb = np.frombuffer(zlib.compress(bytes(10_000_000)), np.uint8)
    for shape in ([2, 3], [1_000_000, 3], [2**28, 3], [2**45, 0], [0, 2**45], [2**62, 2**62]):
        with pytest.raises(ValueError, match="array of shape"):
            unpack(bomb, {"shape": shape, "bits": 8})
    fitting = {"shape": [10_000_000 // 6 - 100, 3], "bits": 16}
    with pytest.raises(ValueError, match="expected at most"):
        quantization.unpack_scene({"means": bomb}, {"means": fitting})
    few = pack("means", np.float32(np.random.default_rng(0).normal(size=(50, 3))))
    with pytest.raises(ValueError, match="expected at most"):
        quantization.unpack_scene({"means": few.content, "sh": bomb}, {"means": few.description, "sh": fitting})


def test_many_arrays_together_are_no_bomb_either(tmp_path: Path) -> None:
    """Each may be as large as a network; all of them together would take seventeen thousand million bytes."""
    content = pack("network.x", np.zeros(2**22, np.float32)).content
    names = [f"network.x{index}" for index in range(1000)]
    packed = {name: pack(name, array) for name, array in scene_file().arrays.items()}
    bomb = {name: part.content for name, part in packed.items()} | dict.fromkeys(names, content)
    packing = {name: part.description for name, part in packed.items()}
    packing |= {name: {"shape": [2**22], "bits": 0} for name in names}
    path = tmp_path / "x.frog"
    path.write_bytes(save(bomb, metadata={"frog": scene_file().header.to_json(), "packing": json.dumps(packing)}))
    assert path.stat().st_size < 10e6
    tracemalloc.start()
    refused(r"arrays of 16,777,2\d\d,\d\d\d bytes, expected at most", read_scene, path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 50e6


def test_neighbours_in_space_become_neighbours_in_memory() -> None:
    """One that is far away leaves the others in order."""
    means = np.float32(np.random.default_rng(3).uniform(-1, 1, (4000, 3)))
    means[17] = 1e6
    order = quantization.morton_order(means)
    assert sorted(order) == list(range(4000)) and quantization.morton_order(means[:0]).shape == (0,)
    assert steps_between(means[order[order != 17]]) < 0.2 * steps_between(np.delete(means, 17, axis=0))


@pytest.mark.parametrize("moving", [0, 1, 30, 50])
def test_dynamic_ones_stay_before_static_ones(moving: int) -> None:
    means = np.float32(np.random.default_rng(4).normal(size=(50, 3)))
    order = quantization.morton_order_by_range(means, moving)
    assert sorted(order[:moving]) == list(range(moving))
    np.testing.assert_array_equal(order[:moving], quantization.morton_order(means[:moving]))
    np.testing.assert_array_equal(order[moving:], moving + quantization.morton_order(means[moving:]))


def ordinary(name: str, count: int, seed: int = 0) -> np.ndarray:
    """Numbers as a scene has them: in each block of normal distribution, its middle elsewhere."""
    random = np.random.default_rng(seed)
    middles = random.normal(size=(-(-count // BLOCK), 3))[np.arange(count) // BLOCK]
    return np.float32(middles + random.normal(0, 0.3, (count, 3)))


def back(name: str, array: np.ndarray) -> tuple[np.ndarray, int]:
    """The array out of its packing, and how many numbers stood apart."""
    packed = pack(name, array)
    return unpack(packed.content, packed.description), packed.description.get("apart", 0)


@pytest.mark.parametrize("name", QUANTISED)
def test_in_ordinary_blocks_nothing_stands_apart(name: str) -> None:
    for seed, count in product(range(3), (1, 2, 3, 100, 3 * BLOCK + 5)):
        assert back(name, ordinary(name, count, seed))[1] == 0, (seed, count)


@pytest.mark.parametrize(("name", "far", "size"), pairwise(QUANTISED, [1, 5, 100], [1e3, 2.1e7]))
def test_far_numbers_stay_and_leave_their_neighbours_alone(name: str, far: int, size: float) -> None:
    """Among them several in one block, of either sign and of several magnitudes, and one in a last block of three."""
    count, random = 3 * BLOCK + 3, np.random.default_rng(far)
    array = ordinary(name, count)
    error = np.abs(back(name, array)[0] - array).max()
    places = np.append(random.permutation(BLOCK)[:far], count - 1)
    array[places, 1] = np.float32(random.choice([-1, 1], len(places)) * size * 10 ** random.uniform(0, 1, len(places)))
    actual, apart = back(name, array)
    assert apart == len(places)
    np.testing.assert_array_equal(actual[places, 1], array[places, 1])
    assert np.abs(actual - array).max() < 3 * error


@pytest.mark.parametrize("name", QUANTISED)
def test_what_a_scene_ends_with_or_holds_often(name: str) -> None:
    """No extremes but constants: a plane, two values, and the largest numbers that there are."""
    for values in ([0.25], [0.0, 0.5], [0.0] * 9 + [1.0], [-1e30, 1e30]):
        array = np.float32(np.resize(values, (2 * BLOCK + 7, 3)))
        actual, _ = back(name, array)
        np.testing.assert_allclose(actual, array, atol=1e-6 + 2e-3 * np.ptp(values))


def one_apart() -> tuple[np.ndarray, dict]:
    array = ordinary("means", BLOCK)
    array[9, 2] = 1e6
    packed = pack("means", array)
    assert packed.description["apart"] == 1
    return packed.content, packed.description


@pytest.mark.parametrize("apart", [0, 2, -1, 769, 2**40, 1.0, True, "1", None, [1]])
def test_a_number_of_those_apart_that_is_not_true_is_refused(apart: object) -> None:
    content, description = one_apart()
    with pytest.raises(ValueError, match=r"apart|from other than"):
        unpack(content, json.loads(json.dumps({**description, "apart": apart})))


@pytest.mark.parametrize("place", [768, 2**31, 2**32 - 1])
def test_a_place_that_is_none_is_refused(place: int) -> None:
    content, description = one_apart()
    stored = bytearray(zlib.decompress(content.tobytes()))
    stored[-8:-4] = place.to_bytes(4, "little")
    with pytest.raises(ValueError, match="apart at"):
        unpack(np.frombuffer(zlib.compress(bytes(stored)), np.uint8), description)


def reduced(*values: object) -> dict[str, Any]:
    names = ("what", "progress", "before", "after", "loss", "bytes")
    return dict(zip(names, values, strict=True))


CAPACITY: dict[str, Any] = {
    "gaussians": 20_704,
    "dynamic": 5_927,
    "sh_degree": 1,
    "reductions": [
        reduced("frozen", 0.85, 20_704, 5_927, 0.0213, 1_890_000),
        reduced("pruned", 0.93, 6_000, 5_927, None, -9),
    ],
}


def test_the_report_in_words() -> None:
    assert summary(CAPACITY) == "20,704 Gaussians, 5,927 of them dynamic; SH degree 1"
    freeze, prune = lines(CAPACITY)
    expected = "at 85 %, freeze: 20,704 -> 5,927 dynamic Gaussians; saves 1.89 MB; costs 0.021 dB"
    assert freeze == expected
    assert prune == "at 93 %, prune: 6,000 -> 5,927 Gaussians"
    assert lines({}) == []
    assert reduction_line(CAPACITY["reductions"][0] | {"is_forced": True}) == f"{freeze}, which a limit forces"
