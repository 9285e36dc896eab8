"""The CUDA kernels, compiled for the CPU, against the reference in float64, through the code that drives a GPU."""

import ctypes
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from emulated import HERE, Emulator, build
from support.builders import odd_camera, random_gaussians
from support.equality import CUDA_ERROR, Scene, assert_equal, assert_neighbours_stay, assert_same_bits, draw, scenes
from support.strange_gaussians import STRANGE
from support.torch_drawing import BACKGROUND, EVERYTHING, tensors

from frog_blender.engine.cuda import launch
from frog_blender.engine.cuda.sources import Kernel
from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import joined
from frog_blender.engine.native import structs
from frog_blender.engine.rasterizer import RasterizeOptions, rasterize
from frog_blender.engine.rasterizer import cuda as module

SCENES = scenes()
SMALL = odd_camera(45, 27)


@pytest.mark.parametrize("name", SCENES)
def test_agrees_with_the_reference(name: str, emulator: Emulator) -> None:
    scene = SCENES[name]
    assert_equal(scene, draw(scene, "cuda", torch.float32), draw(scene, "reference", torch.float64), CUDA_ERROR)


@pytest.mark.parametrize("name", ["off-centre, degree 3", "pose", "giants"])
def test_threads_in_the_opposite_order_give_the_same_bits(name: str, emulator: Emulator) -> None:
    """A barrier that is missing shows here; so do sums whose order is left to chance."""
    first = draw(SCENES[name], "cuda", torch.float32)
    emulator.turned = True
    assert_same_bits(first, draw(SCENES[name], "cuda", torch.float32))


@pytest.mark.parametrize("lengths", [[0, 1, 2], [300, 0, 37], [256, 513, 33]])
@pytest.mark.parametrize("staged", ["4096", "32"])
def test_lists_are_sorted_by_depth_and_then_by_slot(lengths: list[int], staged: str, emulator: Emulator) -> None:
    """In shared memory, and where a list is too long for it."""
    ranges = torch.tensor([0, *np.cumsum(lengths)], dtype=torch.int32)
    pairs, random = int(ranges[-1]), np.random.default_rng(0)
    slots, depths = random.permutation(pairs), random.integers(1, 9, pairs)
    keys, owners = torch.from_numpy(depths << 32 | slots), torch.arange(pairs, dtype=torch.int32) * 3
    tile_splats, sorted_slots = torch.empty(2, pairs, dtype=torch.int32)
    arguments = ranges, owners, keys.clone(), tile_splats, sorted_slots
    emulator.launch(Kernel("sort", (("STAGED_KEYS", staged),)), len(lengths), *arguments)
    expected = [part.sort().values & 0xFFFFFFFF for part in keys.split(lengths)]
    assert torch.equal(sorted_slots.long(), torch.cat(expected))
    assert torch.equal(tile_splats, sorted_slots * 3)


def test_an_image_without_room_for_its_pairs_says_so_and_brings_no_gradient(emulator: Emulator) -> None:
    gaussians, room = tensors(random_gaussians(SMALL, 40, 0, seed=3)).mapped(torch.Tensor.detach), module.PairRoom()
    room.pairs, found = 10, []
    for _ in range(2):
        drawing, rgb, _ = module.draw(gaussians, SMALL, BACKGROUND, RasterizeOptions(), room=room)
        gradients = drawing.backward(torch.ones_like(rgb), None, None)
        assert drawing.state is not None
        found.append((rgb, [bool(gradient.any()) for gradient in gradients.values()], drawing.state.tolist()))
        room.grow(found[0][2][0], rgb.device)
    (empty, without, (pairs, has_no_room)), (full, with_gradients, state) = found
    assert (empty == torch.tensor(BACKGROUND)).all() and not any(without) and pairs > 10 and has_no_room == 1
    assert torch.equal(full, rasterize(gaussians, SMALL, BACKGROUND, backend="cuda").rgb)
    assert all(with_gradients) and state == [pairs, 0] and room.pairs == 2**16
    room.grow(70_000_000, rgb.device)
    assert 70_000_000 < room.pairs < 80_000_000  # twice as many would take all of the memory


def test_what_cannot_be_drawn_changes_no_neighbour(emulator: Emulator) -> None:
    assert_neighbours_stay(replace(SMALL, world_to_camera=np.eye(4)), "cuda")


def test_what_is_strange_leaves_everything_finite(emulator: Emulator) -> None:
    camera = replace(SMALL, world_to_camera=np.eye(4))
    everything = joined([*STRANGE.values(), random_gaussians(camera, 30, 0, seed=7)])
    found = draw(Scene(camera, everything, pose=True), "cuda", torch.float32)
    for name, values in found.items():
        if "depth" not in name and "_z" not in name:  # those are NaN where nothing is
            assert np.isfinite(values).all(), name
    assert found["alpha"].min() >= 0 and found["alpha"].max() <= 1


def test_an_image_over_the_budget_is_refused_with_a_sentence(emulator: Emulator) -> None:
    emulator.memory = 10_000
    with pytest.raises(FrogError, match=r"too large to draw: .* overlaps .* GPU memory"):
        draw(Scene(SMALL, random_gaussians(SMALL, 100, 0)), "cuda", torch.float32)


def test_the_backward_pass_can_run_twice(emulator: Emulator) -> None:
    leaves = tensors(random_gaussians(SMALL, 40, 0, seed=3))
    image = rasterize(leaves, SMALL, BACKGROUND, EVERYTHING, backend="cuda")
    loss = image.rgb.square().sum()
    once = torch.autograd.grad(loss, leaves.means, retain_graph=True)[0]
    assert torch.equal(once, torch.autograd.grad(loss, leaves.means)[0])


def test_inputs_need_not_be_contiguous(emulator: Emulator) -> None:
    gaussians = random_gaussians(SMALL, 40, 0, seed=3)
    expected = rasterize(tensors(gaussians), SMALL, backend="cuda")
    leaves = tensors(gaussians)
    turned = leaves.mapped(lambda leaf: torch.stack([leaf] * 2, -1)[..., 0])
    assert torch.equal(rasterize(turned, SMALL, backend="cuda").rgb, expected.rgb)


def test_tensors_that_the_kernels_would_misread_are_refused(emulator: Emulator) -> None:
    leaves = tensors(random_gaussians(SMALL, 6, 1))
    misread = {"opacities": leaves.opacities.double(), "sh": leaves.sh[:, :2], "scales": leaves.means[:5]}
    for name, wrong in misread.items():
        with pytest.raises(ValueError, match=name):
            rasterize(leaves.changed({name: wrong}), SMALL, backend="cuda")
    with pytest.raises(ValueError, match="pose"):
        module.rasterize(leaves, SMALL, BACKGROUND, EVERYTHING, torch.eye(3))


def test_tensors_on_the_cpu_are_refused_without_the_emulator() -> None:
    with pytest.raises(ValueError, match="GPU"):
        rasterize(tensors(random_gaussians(SMALL, 6, 1)), SMALL, backend="cuda")


STAGED = ("x", "y", "along", "lean", "across", "log2_opacity", "red", "green", "blue", "depth")
STAGED += ("extent_x", "extent_y", "radius", "widest")
"""What the kernels copy as four float4 and then read by name."""
LAYOUT = """
#include "cuda_on_cpu.h"
#include "common.cuh"
static_assert(offsetof(Splat, first_row) == offsetof(Staged, rows), "rows");
{same}
extern "C" {{
{layouts}
extern const int constants[] = {{THREADS, TILE, sizeof(Splat), SPLAT_GRADIENTS}};
}}
"""


def test_structs_and_constants_are_those_of_the_kernels(built_emulator: Emulator, tmp_path: Path) -> None:
    """As a C++ compiler lays them out."""
    layouts, expected = [], {}
    for name in ("Gaussians", "Camera", "Options", "Gradients", "Adam"):
        struct = getattr(structs, name)
        fields = [field for field, *_ in struct._fields_]
        sizes = [f"sizeof(Frog{name})", *(f"offsetof(Frog{name}, {field})" for field in fields)]
        layouts.append(f"extern const size_t {name}[] = {{{', '.join(sizes)}}};")
        expected[name] = [ctypes.sizeof(struct), *(getattr(struct, field).offset for field in fields)]
    same = [f'static_assert(offsetof(Splat, {name}) == offsetof(Staged, {name}), "{name}");' for name in STAGED]
    (tmp_path / "layout.cpp").write_text(LAYOUT.format(same="\n".join(same), layouts="\n".join(layouts)))
    library = build(tmp_path / "layout.cpp", tmp_path / "layout.so")
    for name, layout in expected.items():
        assert list((ctypes.c_size_t * len(layout)).in_dll(library, name)) == layout, name
    constants = list((ctypes.c_int * 4).in_dll(library, "constants"))
    assert constants == [launch.THREADS, module.TILE, 4 * structs.SPLAT_FLOATS, module.MOMENTS]


def test_the_emulator_shows_missing_barriers_and_empty_shared_memory(built_emulator: Emulator, tmp_path: Path) -> None:
    code = "__shared__ float s[256]; s[threadIdx.x] = threadIdx.x; {} out[threadIdx.x] = s[255 - threadIdx.x];"
    for barrier, sound in (("__syncthreads();", True), ("", False)):
        forward, backward = (run_kernel(code.format(barrier), tmp_path, turned) for turned in (False, True))
        assert np.array_equal(forward, backward) == sound
        assert np.isfinite(forward).all() == sound


def run_kernel(code: str, folder: Path, turned: bool) -> np.ndarray:
    """What one block of a kernel ``f(float *out)`` with this body writes."""
    name = f"f{len(list(folder.iterdir()))}"
    (folder / f"{name}.cu").write_text(f'extern "C" __global__ void f(float *out) {{ {code} }}')
    options = [f"-I{folder}", "-DKERNEL=f", f'-DKERNEL_FILE="{name}.cu"']
    function = build(HERE / "driver.cpp", folder / f"{name}.so", *options).frog_launch
    out = np.zeros(256, np.float32)
    address = ctypes.c_void_p(out.ctypes.data)
    arguments = (ctypes.c_void_p * 1)(ctypes.addressof(address))
    function(arguments, 1, len(out), turned)
    return out
