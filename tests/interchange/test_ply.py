"""3DGS .ply files: what is written opens elsewhere, what comes from elsewhere is read, what lies is refused with the
reason."""

from pathlib import Path

import numpy as np
import pytest
from support.builders import pairwise, plain_camera, random_gaussians, refused
from support.foreign_files import Columns, ply, ply_columns
from support.foreign_takes import assert_equal_within

from frog_blender.engine.gaussians import ATTRIBUTES, GaussianArrays
from frog_blender.engine.interchange.frame_files import write_frame
from frog_blender.engine.interchange.imports import open_source
from frog_blender.engine.interchange.ply import read_splats, splat_bytes
from frog_blender.engine.interchange.ply_sequence import PlySequence
from frog_blender.engine.spherical_harmonics import SH_DC

COUNT = 200
STANDARD = [*"xyz", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
END = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]


def columns() -> Columns:
    return ply_columns(random_gaussians(plain_camera(), COUNT, 1, seed=2).checked())


def write(path: Path, actual: Columns, dtypes: dict[str, str] | str, kinds: str = "", extra: bool = False) -> Path:
    path.write_bytes(ply(actual, dtypes, kinds, extra))
    return path


def no_splats(path: Path) -> str:
    sentence = refused(rf"{path}.*expected", read_splats, path)
    assert len(sentence) < 700
    return sentence


def gaussians(degree: int = 3, count: int = 50) -> GaussianArrays:
    """Float32, with unit quaternions, among them opacities that logits can hardly hold."""
    made = random_gaussians(plain_camera(), count, degree, seed=4)
    made.quaternions /= np.linalg.norm(made.quaternions, axis=1, keepdims=True)
    made.opacities[:4] = (0.0, 1.0, 1e-6, 1 - 1e-6)[:count]
    return made.checked()


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("name", ["x.ply", "x.glb"])
def test_there_and_back(tmp_path: Path, name: str, degree: int) -> None:
    before = gaussians(degree)
    write_frame(tmp_path / name, before)
    source = open_source(tmp_path / name)
    assert source.left_out == 0
    assert_equal_within(source.at(0), before, 1e-6)


def test_another_program_reads_it(tmp_path: Path) -> None:
    plyfile = pytest.importorskip("plyfile")
    before = gaussians()
    write_frame(tmp_path / "x.ply", before)
    table = plyfile.PlyData.read(tmp_path / "x.ply")["vertex"].data
    assert list(table.dtype.names) == [*STANDARD, *(f"f_rest_{i}" for i in range(45)), *END]
    np.testing.assert_array_equal(np.stack([table[name] for name in "xyz"], 1), before.means)
    np.testing.assert_allclose(np.exp(table["scale_2"]), before.scales[:, 2], rtol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-table["opacity"])), before.opacities, atol=1e-6)
    np.testing.assert_array_equal(table["rot_0"], before.quaternions[:, 0])
    for channel in range(3):  # f_rest goes by channel: 15 coefficients of red first
        np.testing.assert_array_equal(table[f"f_dc_{channel}"], before.sh[:, 0, channel])
        np.testing.assert_array_equal(table[f"f_rest_{15 * channel + 4}"], before.sh[:, 5, channel])


@pytest.mark.parametrize(("dtype", "extra"), pairwise(["<f4", ">f4", "<f8", ">f8"], [False, True]))
def test_files_of_other_programs(tmp_path: Path, dtype: str, extra: bool) -> None:
    """Other numbers, another order of properties, others between them, other elements around."""
    before = read_splats(write(tmp_path / "x.ply", columns(), "<f4")).gaussians
    turned = dict(reversed(columns().items())) | {"confidence": np.zeros(COUNT)}
    after = read_splats(write(tmp_path / "y.ply", turned, dtype, extra=extra)).gaussians
    for name in ATTRIBUTES:
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=2e-6, atol=2e-6, err_msg=name)


def test_text_with_bytes_of_colours(tmp_path: Path) -> None:
    """Of point clouds with sizes, for which no harmonics are written; other elements lie around."""
    actual = columns()
    colors = np.stack([actual.pop(f"f_dc_{channel}") for channel in range(3)], axis=1)
    stored = np.rint((0.5 + SH_DC * colors) * 255).clip(0, 255).astype(np.uint8)
    actual = {name: column for name, column in actual.items() if not name.startswith("f_rest")}
    actual |= dict(zip(("red", "green", "blue"), stored.T, strict=True))
    lines = ["ply", "format ascii 1.0", "element camera 1", "property float a", f"element vertex {COUNT}"]
    lines += [f"property {'uchar' if name in ('red', 'green', 'blue') else 'float'} {name}" for name in actual]
    lines += ["element face 1", "property list uchar int vertex_index", "end_header", "17"]
    rows = [" ".join(map(repr, row)) for row in zip(*(column.tolist() for column in actual.values()), strict=True)]
    (tmp_path / "x.ply").write_text("\n".join([*lines, *rows, "3 0 1 2", ""]))
    after = read_splats(tmp_path / "x.ply").gaussians
    before = read_splats(write(tmp_path / "y.ply", columns(), "<f4")).gaussians
    for name in set(ATTRIBUTES) - {"sh"}:
        np.testing.assert_array_equal(getattr(after, name), getattr(before, name))
    np.testing.assert_allclose(0.5 + SH_DC * after.sh[:, 0], stored / 255, atol=1e-6)


@pytest.mark.parametrize("value", [b"\1\0\0\0\0\0\xf0\x7f", b"\xff\xff\xff\xff\xff\xff\xef\x7f"])
def test_doubles_that_no_float_holds_are_left_out(tmp_path: Path, value: bytes) -> None:
    """A signalling NaN, and the largest of all."""
    path = write(tmp_path / "x.ply", columns(), "<f8")
    content = path.read_bytes()
    start = content.index(b"end_header\n") + len(b"end_header\n")
    path.write_bytes(content[:start] + value + content[start + 8 :])
    with np.errstate(all="raise"):
        splats = read_splats(path)
    assert splats.left_out == 1 and len(splats.arrays["means"]) == COUNT - 1


@pytest.mark.parametrize("share", [0.0, 0.05, 0.9999])
def test_truncated(tmp_path: Path, share: float) -> None:
    content = splat_bytes(gaussians())
    (tmp_path / "x.ply").write_bytes(content[: int(len(content) * share)])
    no_splats(tmp_path / "x.ply")


HEAD = "ply\nformat binary_little_endian 1.0\n"
ONE = "property float x\nend_header\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nonsense", "no PLY"),
        ("ply\n" + "x" * 200_000, "does not end"),
        (HEAD + "element vertex 4000000000\n" + ONE, "announces"),
        (HEAD + "element vertex 99999999999999999999\n" + ONE, "the line"),
        (HEAD + "end_header\n", "no Gaussians"),
        (HEAD + "element chunk 4000000000\nproperty double a\nelement vertex 1\n" + ONE, "announces"),
        (HEAD + "element face 4000000000\nproperty list uint float x\nelement vertex 1\n" + ONE, "lists"),
        (HEAD + "element vertex 1\nelement vertex 1\n" + ONE, "the line"),
        (HEAD + "element vertex 1\nproperty float x\n" + ONE, "cannot be"),
        (HEAD + "element vertex 1\nproperty quaternion x\nend_header\n", "type quaternion"),
        (HEAD + "elephant\nelement vertex 1\n" + ONE, "elephant"),
        (HEAD + "element vertex 1\n" + ONE + "1234", "no y, z"),
        (HEAD + "element vertex 1\nproperty uint packed_position\nend_header\n1234", "no x, y, z"),
        ("ply\nformat ascii 1.0\nelement vertex 1\n" + ONE + "1\n", "no y, z"),
        ("ply\nformat ascii 1.0\nelement vertex 3\n" + ONE + "1\n2\n", "fewer numbers than the 3 of its vertex"),
        ("ply\nformat ascii 1.0\nelement vertex 4000000000\n" + ONE + "1 x\n", "fewer numbers than the 4,000,000,000"),
        ("ply\nformat text 1.0\nelement vertex 1\n" + ONE + "1\n", "the format text"),
    ],
    ids=lambda value: value[-40:] if len(value) > 40 else value,
)
def test_headers_that_lie(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "x.ply").write_text(text, newline="")
    assert said in no_splats(tmp_path / "x.ply")


def test_a_number_of_colours_that_no_degree_has(tmp_path: Path) -> None:
    content = splat_bytes(gaussians(1, 1)).replace(b"property float f_rest_8\n", b"")
    (tmp_path / "x.ply").write_bytes(content)
    assert "8 properties f_rest" in no_splats(tmp_path / "x.ply")


HALF_COLORS = {name: "<f2" for name in columns() if name.startswith("f_")}


@pytest.mark.parametrize(
    ("dtype", "kind"), [("<f2", "ushort"), (">f2", "short"), (">f2", "float16"), (HALF_COLORS, "")], ids=str
)
def test_half_floats(tmp_path: Path, dtype: dict[str, str] | str, kind: str) -> None:
    """By whatever name of 16 bits, or of colours alone."""
    before = read_splats(write(tmp_path / "x.ply", columns(), "<f4")).gaussians
    source = read_splats(write(tmp_path / "half.ply", columns(), dtype, kind))
    assert source.left_out == 0
    for name in ATTRIBUTES:
        exact = 1e-6 if kind == "" and name != "sh" else 4e-3
        np.testing.assert_allclose(getattr(source.gaussians, name), getattr(before, name), rtol=exact, atol=exact)


@pytest.mark.parametrize("kind", ["<u2", "<i2"])
def test_sixteen_bits_that_are_no_half_floats(tmp_path: Path, kind: str) -> None:
    """Quantised: each property from its least to its largest in all whole numbers."""
    levels = {name: np.interp(c, (c.min(), c.max() + 1e-9), (0, 32767)) for name, c in columns().items()}
    assert "no half floats" in no_splats(write(tmp_path / "x.ply", levels, kind))
    random = np.random.default_rng(0)
    noise = {name: random.integers(0, 65535, COUNT).astype("<u2").view(kind) for name in columns()}
    assert "no half floats" in no_splats(write(tmp_path / "x.ply", noise, kind))

    ones = {name: np.ones(COUNT) for name in columns()}
    assert "whole numbers of" in no_splats(write(tmp_path / "x.ply", ones, "<i4" if kind == "<i2" else "u1"))


def changed(names: str, values: object) -> Columns:
    """The columns whose names begin so hold these values."""
    actual = columns()
    for name in actual:
        if name.startswith(names):
            actual[name] = np.resize(np.asarray(values, np.float32), COUNT)
    return actual


@pytest.mark.parametrize(
    ("names", "values", "said"),
    [
        ("scale_", np.arange(256), "sizes of e to the"),
        ("scale_", 60.0, "sizes of e to the"),
        ("opacity", [50_000.0, 40_000.0], "opacities with logits of"),
        ("rot_", 0.0, "quaternions of length 0"),
        ("rot_", 255.0, "quaternions of length 510"),
        ("f_dc_", 128.0, "colours of 128"),
        ("x", [np.nan, np.nan, 1.0], "not finite"),
        ("x", np.inf, "200 of 200 Gaussians with numbers that are not finite"),
        ("f_rest_3", [1e20, 1e30, 0.0], "too large"),
    ],
)
def test_numbers_that_mean_something_else(tmp_path: Path, names: str, values: object, said: str) -> None:
    assert said in no_splats(write(tmp_path / "x.ply", changed(names, values), "<f4"))


def test_numbers_that_may_mean_something_else_are_told(tmp_path: Path) -> None:
    """As they are of files that hold opacities and sizes themselves."""
    assert not read_splats(write(tmp_path / "x.ply", columns(), "<f4")).notes
    for names, values, said in (("opacity", [0.1, 0.9], "taken for logits"), ("scale_", [0.1, 2.0], "for logarithms")):
        (note,) = read_splats(write(tmp_path / "x.ply", changed(names, values), "<f4")).notes
        assert said in note
    sequence = PlySequence(tmp_path, 24.0)
    assert sequence.at(0) is not None and sequence.notes == (note,)


def test_single_rows_that_cannot_be_drawn_are_left_out(tmp_path: Path) -> None:
    actual = columns()
    actual["scale_1"][3], actual["y"][5], actual["f_dc_0"][7] = 40.0, 1e25, np.nan
    actual["x"][9], actual["scale_2"][11] = 2.1e7, -np.inf
    splats = read_splats(write(tmp_path / "x.ply", actual, "<f4"))
    assert splats.left_out == 3 and len(splats.arrays["means"]) == COUNT - 3
    assert splats.arrays["means"].max() == np.float32(2.1e7), "what is far may stay"
    assert splats.arrays["log_scales"].min() == -30.0, "a size of zero is a thin one"
