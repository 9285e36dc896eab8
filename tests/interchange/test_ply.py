"""3DGS .ply files: what is written opens elsewhere, what comes from elsewhere is read, what lies is refused."""

from __future__ import annotations

import resource
import sys
from pathlib import Path

import numpy as np
import pytest
from support.builders import ATTRIBUTES, pairwise, plain_camera, random_gaussians

from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.interchange.ply import read_splats, splat_bytes, write_splats
from frog_blender.engine.playback.frame_delta import canonical_gaussians

STANDARD = [*"xyz", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
END = ["opacity", "scale_0", "scale_1", "scale_2", "rot_0", "rot_1", "rot_2", "rot_3"]


def gaussians(degree: int = 3, count: int = 50) -> GaussianArrays:
    """Float32, with unit quaternions, among them opacities that logits can hardly hold."""
    made = random_gaussians(plain_camera(), count, degree, seed=4)
    made.quaternions /= np.linalg.norm(made.quaternions, axis=1, keepdims=True)
    made.opacities[:4] = (0.0, 1.0, 1e-6, 1 - 1e-6)[:count]
    return made.checked()


@pytest.mark.parametrize("degree", range(4))
def test_there_and_back(tmp_path: Path, degree: int) -> None:
    before = gaussians(degree)
    write_splats(tmp_path / "x.ply", before)
    splats = read_splats(tmp_path / "x.ply")
    after = canonical_gaussians(splats.arrays)
    assert splats.left_out == 0
    for name in ATTRIBUTES:
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=1e-6, atol=1e-6, err_msg=name)


def test_another_program_reads_it(tmp_path: Path) -> None:
    plyfile = pytest.importorskip("plyfile")
    before = gaussians()
    write_splats(tmp_path / "x.ply", before)
    table = plyfile.PlyData.read(tmp_path / "x.ply")["vertex"].data
    assert list(table.dtype.names) == [*STANDARD, *(f"f_rest_{i}" for i in range(45)), *END]
    np.testing.assert_array_equal(np.stack([table[name] for name in "xyz"], 1), before.means)
    np.testing.assert_allclose(np.exp(table["scale_2"]), before.scales[:, 2], rtol=1e-6)
    np.testing.assert_allclose(1 / (1 + np.exp(-table["opacity"])), before.opacities, atol=1e-6)
    np.testing.assert_array_equal(table["rot_0"], before.quaternions[:, 0])
    for channel in range(3):  # f_rest goes by channel: 15 coefficients of red first
        np.testing.assert_array_equal(table[f"f_dc_{channel}"], before.sh[:, 0, channel])
        np.testing.assert_array_equal(table[f"f_rest_{15 * channel + 4}"], before.sh[:, 5, channel])


def foreign(path: Path, order: str, kind: str, extra: bool = True) -> GaussianArrays:
    """Written as another program might: other numbers, other properties between, other elements around."""
    made = gaussians(1, 20)
    opacities = np.clip(made.opacities.astype(float), 1e-6, 1 - 1e-6)
    columns = {f"scale_{i}": np.log(made.scales[:, i]) for i in range(3)}
    columns |= {f"rot_{i}": 3 * made.quaternions[:, i] for i in range(4)}
    columns |= {"opacity": np.log(opacities / (1 - opacities)), "confidence": np.zeros(20)}
    columns |= {name: made.means[:, i] for i, name in enumerate("xyz")}
    columns |= {f"f_dc_{i}": made.sh[:, 0, i] for i in range(3)}
    columns |= {f"f_rest_{i}": made.sh[:, 1 + i % 3, i // 3] for i in range(9)}
    sign = {"little": "<", "big": ">"}[order]
    code = {"float": "f4", "float32": "f4", "double": "f8", "float64": "f8"}[kind]
    table = np.empty(20, [(name, sign + code) for name in columns])
    for name, values in columns.items():
        table[name] = values
    around = ["element chunk 2", "property uchar a", "property int16 b"] if extra else []
    after = ["element face 1", "property list uchar int vertex_index"] if extra else []
    lines = ["ply", f"format binary_{order}_endian 1.0", "comment made elsewhere", *around, "element vertex 20"]
    lines += [*(f"property {kind} {name}" for name in columns), *after, "end_header"]
    end = "\r\n" if extra else "\n"
    body = b"123456" * extra + table.tobytes() + b"\x03" * 13 * extra
    path.write_bytes((end.join(lines) + end).encode() + body)
    return made


@pytest.mark.parametrize(("order", "kind", "extra"), pairwise(["little", "big"], ["float", "float64"], [False, True]))
def test_files_of_other_programs(tmp_path: Path, order: str, kind: str, extra: bool) -> None:
    before = foreign(tmp_path / "x.ply", order, kind, extra)
    after = canonical_gaussians(read_splats(tmp_path / "x.ply").arrays)
    for name in ATTRIBUTES:
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), rtol=2e-6, atol=2e-6, err_msg=name)


def test_rows_that_hold_no_numbers_are_left_out(tmp_path: Path) -> None:
    made = gaussians(0)
    made.means[3, 1], made.sh[7, 0, 2] = np.nan, np.inf
    made.quaternions[9] = 0
    write_splats(tmp_path / "x.ply", made)
    splats = read_splats(tmp_path / "x.ply")
    assert splats.left_out == 2 and len(splats.arrays["means"]) == 48
    np.testing.assert_array_equal(splats.arrays["quaternions"][7], (1, 0, 0, 0))  # it had no direction
    np.testing.assert_array_equal(splats.arrays["means"][3], made.means[4])
    made.means[:] = np.nan
    write_splats(tmp_path / "x.ply", made)
    assert "not one Gaussian" in refused(tmp_path / "x.ply")


@pytest.mark.parametrize("value", [b"\1\0\0\0\0\0\xf0\x7f", b"\xff\xff\xff\xff\xff\xff\xef\x7f"])
def test_doubles_that_no_float_holds_are_left_out(tmp_path: Path, value: bytes) -> None:
    """A signalling NaN, and the largest of all."""
    foreign(tmp_path / "x.ply", "little", "double", extra=False)
    content = (tmp_path / "x.ply").read_bytes()
    start = content.index(b"end_header\n") + len(b"end_header\n")
    (tmp_path / "x.ply").write_bytes(content[:start] + value + content[start + 8 :])
    with np.errstate(all="raise"):
        splats = read_splats(tmp_path / "x.ply")
    assert splats.left_out == 1 and len(splats.arrays["means"]) == 19


def test_sizes_that_no_number_holds_are_left_out(tmp_path: Path) -> None:
    foreign(tmp_path / "x.ply", "little", "double", extra=False)
    content = (tmp_path / "x.ply").read_bytes()
    start = content.index(b"end_header\n") + len(b"end_header\n")
    table = np.frombuffer(content[start:], np.float64).reshape(20, -1).copy()
    table[:9, :3] = 800.0  # the exponential of which is infinite, and of whose sizes half are so
    table[9:11, :3] = 710.0
    (tmp_path / "x.ply").write_bytes(content[:start] + table.tobytes())
    with np.errstate(all="raise"), pytest.raises(FrogError):
        read_splats(tmp_path / "x.ply")


def test_infinite_logits_are_certain(tmp_path: Path) -> None:
    content = bytearray(splat_bytes(gaussians(0)))
    size, opacity = 4 * 17, 4 * 9
    start = len(content) - 50 * size
    content[start + opacity : start + opacity + 4] = np.float32(np.inf).tobytes()
    (tmp_path / "x.ply").write_bytes(content)
    splats = read_splats(tmp_path / "x.ply")
    assert splats.left_out == 0 and canonical_gaussians(splats.arrays).opacities[0] == 1.0


def refused(path: Path) -> str:
    with pytest.raises(FrogError) as caught:
        read_splats(path)
    sentence = str(caught.value)
    assert "\n" not in sentence and str(path) in sentence and sentence.endswith(".") and len(sentence) < 700
    return sentence


def test_no_file(tmp_path: Path) -> None:
    assert "no file" in refused(tmp_path / "none.ply")
    refused(tmp_path)


@pytest.mark.parametrize("share", [0.0, 0.002, 0.05, 0.5, 0.9999])
def test_truncated(tmp_path: Path, share: float) -> None:
    content = splat_bytes(gaussians())
    (tmp_path / "x.ply").write_bytes(content[: int(len(content) * share)])
    refused(tmp_path / "x.ply")


HEAD = "ply\nformat binary_little_endian 1.0\n"
ONE = "property float x\nend_header\n"


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("nonsense", "no PLY"),
        ("ply\n", "does not end"),
        ("ply\n" + "x" * 200_000, "does not end"),
        (HEAD + "element vertex 4000000000\n" + ONE, "announces"),
        (HEAD + "element vertex 99999999999999999999\n" + ONE, "number of rows"),
        (HEAD + "element vertex -4\n" + ONE, "number of rows"),
        (HEAD + "element vertex 0\n" + ONE, "no Gaussians"),
        (HEAD + "end_header\n", "no Gaussians"),
        (HEAD + "element vertex 1\nend_header\n", "no Gaussians"),
        (HEAD + "element chunk 4000000000\nproperty double a\nelement vertex 1\n" + ONE, "announces"),
        (HEAD + "element vertex 1\nproperty list uint float x\nend_header\n", "lists"),
        (HEAD + "element face 4000000000\nproperty list uint float x\nelement vertex 1\n" + ONE, "lists"),
        (HEAD + "element vertex 1\nelement vertex 1\n" + ONE, "twice"),
        (HEAD + "element vertex 1\nproperty float x\n" + ONE, "cannot be"),
        (HEAD + "element vertex 1\nproperty quaternion x\nend_header\n", "type quaternion"),
        (HEAD + "elephant\nelement vertex 1\n" + ONE, "elephant"),
        (HEAD + "element vertex 1\n" + ONE + "1234", "no y, z"),
        (HEAD + "element vertex 1\nproperty uint packed_position\nend_header\n1234", "compressed"),
        ("ply\nformat ascii 1.0\nelement vertex 1\n" + ONE + "1\n", "ascii"),
        ("ply\nelement vertex 1\n" + ONE + "1234", "no Gaussians"),
    ],
    ids=lambda value: value[-40:] if len(value) > 40 else value,
)
def test_headers_that_lie(tmp_path: Path, text: str, said: str) -> None:
    (tmp_path / "x.ply").write_text(text, newline="")
    assert said in refused(tmp_path / "x.ply")


def test_a_number_of_colours_that_no_degree_has(tmp_path: Path) -> None:
    content = splat_bytes(gaussians(1, 1)).replace(b"property float f_rest_8\n", b"")
    (tmp_path / "x.ply").write_bytes(content)
    assert "8 properties f_rest" in refused(tmp_path / "x.ply")


def test_random_damage_is_refused_or_harmless(tmp_path: Path) -> None:
    content, random, path = splat_bytes(gaussians(1)), np.random.default_rng(5), tmp_path / "x.ply"
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    header = content.index(b"end_header") + 11
    for _ in range(400):
        changed = bytearray(content)
        for _ in range(int(random.integers(1, 4))):
            changed[int(random.integers(header))] = int(random.integers(256))
        path.write_bytes(changed)
        try:
            assert canonical_gaussians(read_splats(path).arrays).checked().means.size
        except FrogError as error:
            assert "\n" not in str(error)
    unit = 1 if sys.platform == "darwin" else 1024
    assert (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before) * unit < 50e6
