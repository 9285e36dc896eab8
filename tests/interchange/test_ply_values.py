"""Half floats in .ply files are read, and numbers that cannot be splats are refused with the reason."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support.builders import ATTRIBUTES, plain_camera, random_gaussians

from frog_blender.cli.main import main
from frog_blender.engine.errors import FrogError
from frog_blender.engine.interchange.ply import read_splats, splat_bytes
from frog_blender.engine.playback.frame_delta import canonical_gaussians

COUNT = 200
NAMES = {"<f2": "ushort", ">f2": "ushort", "<i2": "short", "<u2": "uint16"}
NAMES |= {"<f4": "float", ">f4": "float", "u1": "uchar", "<i4": "int"}
Columns = dict[str, np.ndarray]


def columns() -> Columns:
    """Properties of a 3DGS file by name, float32."""
    content = splat_bytes(random_gaussians(plain_camera(), COUNT, 1, seed=2).checked())
    header, _, body = content.partition(b"end_header\n")
    names = [line.split()[-1] for line in header.decode().splitlines() if line.startswith("property")]
    return dict(zip(names, np.frombuffer(body, "<f4").reshape(COUNT, -1).T.copy(), strict=True))


def write(path: Path, found: Columns, dtypes: dict[str, str] | str, kinds: str = "") -> Path:
    """The columns as these types, each named as PLY names it, or all as ``kinds``."""
    chosen = {name: dtypes if isinstance(dtypes, str) else dtypes.get(name, "<f4") for name in found}
    table = np.empty(COUNT, list(chosen.items()))
    for name, values in found.items():
        table[name] = values
    order = "big" if any(dtype.startswith(">") for dtype in chosen.values()) else "little"
    lines = ["ply", f"format binary_{order}_endian 1.0", f"element vertex {COUNT}"]
    lines += [f"property {kinds or NAMES[dtype]} {name}" for name, dtype in chosen.items()]
    path.write_bytes("\n".join([*lines, "end_header\n"]).encode() + table.tobytes())
    return path


def refused(path: Path) -> str:
    with pytest.raises(FrogError) as caught:
        read_splats(path)
    sentence = str(caught.value)
    assert "\n" not in sentence and str(path) in sentence and "expected" in sentence
    return sentence


@pytest.mark.parametrize(
    ("dtype", "kind"),
    [("<f2", "ushort"), (">f2", "uint16"), (">f2", "short"), ("<f2", "int16"), ("<f2", "half"), (">f2", "float16")],
)
def test_half_floats(tmp_path: Path, dtype: str, kind: str) -> None:
    """By whatever name of 16 bits."""
    before = canonical_gaussians(read_splats(write(tmp_path / "x.ply", columns(), "<f4")).arrays)
    found = read_splats(write(tmp_path / "half.ply", columns(), dtype, kind))
    assert found.left_out == 0
    for name, values in vars(canonical_gaussians(found.arrays)).items():
        np.testing.assert_allclose(values, getattr(before, name), rtol=4e-3, atol=4e-3, err_msg=name)
    assert set(ATTRIBUTES) == set(vars(before))


def test_half_floats_beside_floats(tmp_path: Path) -> None:
    halves = {name: "<f2" for name in columns() if name.startswith("f_")}
    before, after = (read_splats(write(tmp_path / "x.ply", columns(), kind)).arrays for kind in ("<f4", halves))
    np.testing.assert_array_equal(after["means"], before["means"])
    np.testing.assert_allclose(after["sh"], before["sh"], rtol=1e-3, atol=1e-3)


@pytest.mark.parametrize("kind", ["<u2", "<i2"])
def test_sixteen_bits_that_are_no_half_floats(tmp_path: Path, kind: str) -> None:
    """Quantised: each property from its least to its largest in all whole numbers."""
    levels = {name: np.interp(c, (c.min(), c.max() + 1e-9), (0, 32767)) for name, c in columns().items()}
    assert "no half floats" in refused(write(tmp_path / "x.ply", levels, kind))
    random = np.random.default_rng(0)
    noise = {name: random.integers(0, 65535, COUNT).astype("<u2").view(kind) for name in columns()}
    assert "no half floats" in refused(write(tmp_path / "x.ply", noise, kind))


@pytest.mark.parametrize(("kind", "dtype"), [("uchar", "u1"), ("char", "i1"), ("int", "<i4"), ("uint", "<u4")])
def test_whole_numbers_are_no_splats(tmp_path: Path, kind: str, dtype: str) -> None:
    ones = {name: np.ones(COUNT) for name in columns()}
    assert "whole numbers of" in refused(write(tmp_path / "x.ply", ones, dtype, kind))


def test_whole_numbers_that_nobody_reads_may_stay(tmp_path: Path) -> None:
    found = columns() | {"red": np.full(COUNT, 7), "label": np.arange(COUNT)}
    splats = read_splats(write(tmp_path / "x.ply", found, {"red": "u1", "label": "<i4"}))
    assert len(splats.arrays["means"]) == COUNT


def changed(names: str, values: object) -> Columns:
    """The columns whose names begin so hold these values."""
    found = columns()
    for name in found:
        if name.startswith(names):
            found[name] = np.resize(np.asarray(values, np.float32), COUNT)
    return found


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
        ("x", np.inf, "not one Gaussian"),
        ("f_rest_3", [1e20, 1e30, 0.0], "too large"),
    ],
)
def test_numbers_that_mean_something_else(tmp_path: Path, names: str, values: object, said: str) -> None:
    assert said in refused(write(tmp_path / "x.ply", changed(names, values), "<f4"))


def test_single_rows_that_cannot_be_drawn_are_left_out(tmp_path: Path) -> None:
    found = columns()
    found["scale_1"][3], found["y"][5], found["f_dc_0"][7] = 40.0, 1e25, np.nan
    found["x"][9], found["scale_2"][11] = 2.1e7, -np.inf
    splats = read_splats(write(tmp_path / "x.ply", found, "<f4"))
    assert splats.left_out == 3 and len(splats.arrays["means"]) == COUNT - 3
    assert splats.arrays["means"].max() == np.float32(2.1e7), "what is far may stay"
    assert splats.arrays["log_scales"].min() == -30.0, "a size of zero is a thin one"


@pytest.mark.parametrize("length", [1e-30, 1e-3, 20.0])
def test_quaternions_of_any_length_are_made_units(tmp_path: Path, length: float) -> None:
    found = columns()
    before = canonical_gaussians(read_splats(write(tmp_path / "x.ply", found, "<f4")).arrays).quaternions
    for name in ("rot_0", "rot_1", "rot_2", "rot_3"):
        found[name] = found[name] * np.float32(length)
    after = read_splats(write(tmp_path / "x.ply", found, "<f4")).arrays["quaternions"]
    np.testing.assert_allclose(np.linalg.norm(after, axis=1), 1, rtol=1e-6)
    np.testing.assert_allclose(after, before, atol=1e-5)


def test_the_command_says_so_and_writes_nothing(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = write(tmp_path / "x.ply", changed("scale_", 60.0), "<f4")
    assert main(["import", str(path)]) == 1
    assert "sizes of e to the 60" in capsys.readouterr().err and list(tmp_path.iterdir()) == [path]
