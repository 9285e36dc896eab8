"""Numbers far from all others of their block stand apart: they stay as they are, and so do the steps of the others."""

from __future__ import annotations

import json
import zlib
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pytest
from support.builders import pairwise, scene_file

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene import quantization
from frog_blender.engine.scene.quantization import BITS, BLOCK, pack, unpack
from frog_blender.engine.scene.scene_file import write_scene

QUANTISED = [name for name, bits in BITS.items() if bits > 1]


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
    found, apart = back(name, array)
    assert apart == len(places)
    np.testing.assert_array_equal(found[places, 1], array[places, 1])
    assert np.abs(found - array).max() < 3 * error


@pytest.mark.parametrize("name", QUANTISED)
def test_what_a_scene_ends_with_or_holds_often(name: str) -> None:
    """No extremes but constants: a plane, two values, and the largest numbers that there are."""
    for values in ([0.25], [0.0, 0.5], [0.0] * 9 + [1.0], [-1e30, 1e30]):
        array = np.float32(np.resize(values, (2 * BLOCK + 7, 3)))
        found, _ = back(name, array)
        np.testing.assert_allclose(found, array, atol=1e-6 + 2e-3 * np.ptp(values))


def test_two_halves_that_lie_far_apart_are_both_kept() -> None:
    """Neither half of a block is nobody: at most half of the numbers stand apart, and none is moved."""
    array = ordinary("means", BLOCK)
    array[::2] += 1e6
    found, apart = back("means", array)
    assert apart == array.size // 2
    np.testing.assert_allclose(found, array, atol=1e-3)


def with_far_rows(count: int = 600) -> tuple[object, object]:
    """A scene as ``helpers`` makes it, and the same with three Gaussians astray, which nobody sees."""
    scene = scene_file(count, moving=300)
    arrays = {name: array.copy() for name, array in scene.arrays.items()}
    arrays["means"][[5, 310]] = (2.1e7, -8e6, 3e5)
    arrays["log_scales"][200, 1] = 15.0
    arrays["sh"][320] *= 500
    arrays["embeddings"][7] *= 1e5
    arrays["opacity_logits"][[5, 7, 200, 310, 320]] = -20.0
    return scene, replace(scene, arrays=arrays)


def in_whole_blocks(array: np.ndarray, bits: int) -> np.ndarray:
    """As it would be read again if nothing stood apart: the range of a block is that of all of its numbers."""
    found = np.empty_like(array)
    for begin in range(0, len(array), BLOCK):
        block = array[begin : begin + BLOCK].astype(np.float64)
        least = block.min(axis=0)
        step = np.maximum(np.ptp(block, axis=0) / (2**bits - 1), 1e-30)
        found[begin : begin + BLOCK] = least + np.rint((block - least) / step) * step
    return found


def test_a_packed_scene_looks_the_same_with_far_gaussians(tmp_path: Path) -> None:
    _, astray = with_far_rows()
    path = tmp_path / "x.frog"
    together = {name: in_whole_blocks(array, BITS[name]) for name, array in astray.arrays.items() if name in QUANTISED}
    images = {}
    for kind in ("plain", "packed", "together"):
        written = replace(astray, arrays=astray.arrays | together) if kind == "together" else astray
        write_scene(path, written, compact=kind == "packed")
        scene = ScenePlayer.load(path)
        images[kind] = draw(scene.at_frame(3), scene.header.cameras[0]).rgb
    assert np.abs(images["packed"] - images["plain"]).max() < 0.06
    assert np.abs(images["together"] - images["plain"]).max() > 0.2, "the test's own scene shows nothing"


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


def test_only_blocks_have_numbers_apart() -> None:
    packed = pack("network.bias", np.ones(7, np.float32))
    with pytest.raises(ValueError, match="apart"):
        unpack(packed.content, {**packed.description, "apart": 1})
    assert quantization.BITS["lifetimes"] == 1
