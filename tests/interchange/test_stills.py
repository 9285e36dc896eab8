"""One time's Gaussians in other formats: out and in again, and as other programs write them."""

from __future__ import annotations

import json
import struct
import zlib
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from support import foreign_files
from support.foreign_takes import partly_static, sorted_like

from frog_blender.cli.main import main
from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.interchange.frame_files import write_frame
from frog_blender.engine.interchange.gltf import EXTENSION
from frog_blender.engine.interchange.imports import import_scene, open_source
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.transform import transform


@pytest.fixture
def scene(tmp_path: Path) -> ScenePlayer:
    return partly_static(tmp_path)


def read(path: Path) -> tuple[GaussianArrays, int]:
    """A file's Gaussians with z up, and how many are left out."""
    source = open_source(path)
    return source.at(0), source.left_out


def turns_apart(found: GaussianArrays, expected: GaussianArrays) -> float:
    """The largest difference of quaternions, whatever their signs."""
    return float((1 - np.abs((found.quaternions * expected.quaternions).sum(axis=1))).max())


@pytest.mark.parametrize(("sh_count", "version"), [(1, 3), (4, 4), (9, 4), (16, 3), (16, 4)])
def test_spz_there_and_back(tmp_path: Path, sh_count: int, version: int) -> None:
    if version == 4:
        pytest.importorskip("zstandard")
    before = partly_static(tmp_path, sh_count=sh_count).at_frame(3)
    before.sh = before.sh.clip(-0.9, 0.9)
    write_frame(tmp_path / "x.spz", before, spz_version=version)
    after, left_out = read(tmp_path / "x.spz")
    assert (tmp_path / "x.spz").read_bytes()[:5] == (b"NGSP\4" if version == 4 else b"\x1f\x8b\x08\0\0")
    assert left_out == 0 and after.sh.shape == before.sh.shape
    np.testing.assert_allclose(after.means, before.means, atol=1e-5)
    np.testing.assert_allclose(np.log(after.scales), np.log(before.scales), atol=0.5 / 16 + 1e-3)
    np.testing.assert_allclose(after.opacities, before.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(after.sh[:, 0], before.sh[:, 0], atol=0.5 / 255 / 0.15 + 1e-4)
    assert turns_apart(after, before) < 1e-5


def test_spz_says_where_up_is(scene: ScenePlayer, tmp_path: Path) -> None:
    """In the file y is up: what has z = 3 here has y = 3 there, in 24-bit fixed point."""
    before = scene.at_frame(0)
    before.means = np.tile(np.array([[1, 2, 3]], np.float32), (40, 1))
    write_frame(tmp_path / "x.spz", before)
    content = zlib.decompress((tmp_path / "x.spz").read_bytes(), 31)
    magic, version, count, _, bits, _, _ = struct.unpack_from("<IIIBBBB", content)
    place = [int.from_bytes(content[16 + 3 * i : 19 + 3 * i], "little", signed=True) / 2**bits for i in range(3)]
    assert (magic, version, count, place) == (0x5053474E, 3, 40, [1, 3, -2])


def test_old_spz_is_read(tmp_path: Path) -> None:
    """Version 2, whose turns are three bytes: made by hand, unpacked and packed."""
    head = struct.pack("<IIIBBBB", 0x5053474E, 2, 1, 0, 8, 0, 0)
    body = (256).to_bytes(3, "little") * 3 + bytes([230, 85, 128, 170, 123, 123, 123, 128, 128, 128])
    for content in (head + body, zlib.compress(head + body, wbits=31)):
        (tmp_path / "x.spz").write_bytes(content)
        found, _ = read(tmp_path / "x.spz")
        np.testing.assert_allclose(found.means, [[1, -1, 1]], atol=1e-6)
        np.testing.assert_allclose(found.scales, np.exp(123 / 16 - 10), rtol=1e-5)
        np.testing.assert_allclose(found.opacities, 230 / 255, rtol=1e-6)


RDF, LUB = 6, 3  # axes as an extension numbers them: those of most .ply files, and mirrored ones


def fourth_spz(path: Path, gaussians: GaussianArrays, axes: int, degree: int = 0) -> None:
    """A file of version 4 with two extensions, one of which names its axes, and harmonics of any degree."""
    zstandard = pytest.importorskip("zstandard")
    write_frame(path, gaussians, spz_version=4)
    content, count = bytearray(path.read_bytes()), len(gaussians)
    content[14] = 2
    sizes = [content[32 + 16 * place : 48 + 16 * place] for place in range(5)]
    packed = bytes(content[32 + 16 * content[15] :])
    streams = packed[: sum(struct.unpack_from("<Q", size)[0] for size in sizes)]
    if degree:
        further = zstandard.ZstdCompressor().compress(bytes([192]) * (3 * ((degree + 1) ** 2 - 1) * count))
        sizes.append(struct.pack("<QQ", len(further), 3 * ((degree + 1) ** 2 - 1) * count))
        streams += further
    records = struct.pack("<II5x", 0x12340001, 5) + struct.pack("<III", 0xADBE0003, 4, axes)
    content[12], content[15], content[16:20] = degree, len(sizes), struct.pack("<I", 32 + len(records))
    path.write_bytes(bytes(content[:32]) + records + b"".join(sizes) + streams)


def test_axes_and_degree_of_a_fourth_spz(tmp_path: Path) -> None:
    before = partly_static(tmp_path, sh_count=4).at_frame(3)
    write_frame(tmp_path / "plain.spz", before)
    plain, _ = read(tmp_path / "plain.spz")
    fourth_spz(tmp_path / "x.spz", before, RDF, degree=4)
    found, _ = read(tmp_path / "x.spz")
    np.testing.assert_allclose(found.means, plain.means * (1, -1, -1), atol=1e-6)
    assert found.sh.shape == (40, 16, 3), "no other format has the fourth degree"
    np.testing.assert_allclose(np.square(found.sh[:, 1:]).sum(axis=1), 15 * 0.25, rtol=1e-4)


def test_mirrored_axes_are_refused(scene: ScenePlayer, tmp_path: Path) -> None:
    fourth_spz(tmp_path / "x.spz", scene.at_frame(3), LUB)
    with pytest.raises(FrogError, match=r"x\.spz: .*mirrored"):
        read(tmp_path / "x.spz")


def test_a_small_fourth_spz_cannot_ask_for_much(tmp_path: Path) -> None:
    """Zstandard packs zeros ten thousandfold: a file of less than its Gaussians' share is refused before."""
    zstandard = pytest.importorskip("zstandard")
    count = 10_000_000
    sizes = [count * width for width in (9, 1, 3, 3, 4)]
    streams = [zstandard.ZstdCompressor().compress(bytes(size)) for size in sizes]
    toc = b"".join(struct.pack("<QQ", len(stream), size) for stream, size in zip(streams, sizes, strict=True))
    head = struct.pack("<IIIBBBBI12x", 0x5053474E, 4, count, 0, 12, 0, 5, 32)
    (tmp_path / "x.spz").write_bytes(head + toc + b"".join(streams))
    assert (tmp_path / "x.spz").stat().st_size < 100_000
    with pytest.raises(FrogError, match="5 streams in"):
        read(tmp_path / "x.spz")


@pytest.mark.parametrize("beside", [None, "the buffer.bin"])
def test_gltf_text_is_read(scene: ScenePlayer, tmp_path: Path, beside: str | None) -> None:
    before = scene.at_frame(3)
    text, buffer = foreign_files.gltf(tmp_path, before, beside and beside.replace(" ", "%20"))
    if beside:
        (tmp_path / beside).write_bytes(buffer)
    after = imported(text.encode(), ".gltf", tmp_path)
    np.testing.assert_allclose(np.sort(after.means, axis=0), np.sort(before.means, axis=0), atol=2e-6)


@pytest.mark.parametrize(
    ("uri", "sentence"),
    [
        ("../up.bin", "one in the folder of the file"),
        ("octet-stream;base64," + 4000 * "A", "a name of 1,024 characters at most"),
        ("/etc/hostname", "one in the folder of the file"),
        ("http://127.0.0.1:9/x.bin", "one in the folder of the file"),
        ("%2e%2e/up.bin", "one in the folder of the file"),
        ("missing.bin", "no file"),
        ("short.bin", "10 bytes"),
        ("data:image/png;base64,AAAA", "base64"),
        ("data:application/octet-stream;base64,?", "base64 data"),
    ],
)
def test_buffers_that_cannot_be_used(scene: ScenePlayer, tmp_path: Path, uri: str, sentence: str) -> None:
    text, buffer = foreign_files.gltf(tmp_path, scene.at_frame(3), uri)
    (tmp_path.parent / "up.bin").write_bytes(buffer)
    (tmp_path / "short.bin").write_bytes(buffer[:10])
    (tmp_path / "x.gltf").write_text(text)
    with pytest.raises(FrogError, match=sentence):
        read(tmp_path / "x.gltf")


@pytest.mark.parametrize("sh_count", [1, 16])
def test_gltf_there_and_back(tmp_path: Path, sh_count: int) -> None:
    before = partly_static(tmp_path, sh_count=sh_count).at_frame(3)
    write_frame(tmp_path / "x.glb", before)
    after, left_out = read(tmp_path / "x.glb")
    assert left_out == 0 and turns_apart(after, before) < 1e-6
    for name in ("means", "scales", "opacities", "sh"):
        np.testing.assert_allclose(getattr(after, name), getattr(before, name), atol=2e-6, err_msg=name)


def test_another_program_reads_the_gltf(scene: ScenePlayer, tmp_path: Path) -> None:
    fourdgs = pytest.importorskip("fourdgs", reason="reads KHR_gaussian_splatting")
    before = scene.at_frame(3)
    write_frame(tmp_path / "x.glb", before)
    found = fourdgs.from_gltf(str(tmp_path / "x.glb"))
    assert found.metadata["color_space"] == "srgb-rec709-display"
    np.testing.assert_allclose(found.gaussians.positions, before.means[:, [0, 2, 1]] * (1, 1, -1), atol=1e-6)
    np.testing.assert_allclose(found.gaussians.scales, before.scales, rtol=1e-5)
    np.testing.assert_allclose(found.gaussians.colors[:, 3], before.opacities, atol=1e-6)


def rewritten(path: Path, **changes: object) -> None:
    """The file with another description."""
    content = path.read_bytes()
    length = struct.unpack_from("<I", content, 12)[0]
    document = json.loads(content[20 : 20 + length]) | changes
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    rest = content[20 + length :]
    size = struct.pack("<I", 20 + len(text) + len(rest))
    path.write_bytes(content[:8] + size + struct.pack("<I", len(text)) + content[16:20] + text + rest)


def test_gltf_nodes_place_it(scene: ScenePlayer, tmp_path: Path) -> None:
    before = scene.at_frame(3)
    write_frame(tmp_path / "x.glb", before)
    parent = {"children": [1], "translation": [0, 5, 0], "scale": [2, 2, 2]}
    rewritten(tmp_path / "x.glb", nodes=[parent, {"mesh": 0}])
    after, _ = read(tmp_path / "x.glb")
    expected = transform(before, np.array([[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 5], [0, 0, 0, 1.0]]))
    np.testing.assert_allclose(after.means, expected.means, atol=1e-5)
    np.testing.assert_allclose(after.scales, expected.scales, rtol=1e-5)


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"nodes": [{"mesh": 0, "scale": [1, 2, 1]}]}, "scaled unevenly"),
        ({"nodes": [{"children": [0], "mesh": 0}]}, "no Gaussians"),
        ({"nodes": [{"mesh": 7}]}, "a mesh"),
        ({"extensionsRequired": ["KHR_draco"]}, "the required extension KHR_draco"),
        ({"accessors": []}, "accessor of POSITION"),
        ({"bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 1}] * 4}, "view of"),
        (
            {"meshes": [{"primitives": [{"attributes": {}, "extensions": {EXTENSION: {"extensions": {"a": {}}}}}]}]},
            "compr",
        ),
    ],
)
def test_gltf_that_cannot_be_used(
    scene: ScenePlayer, tmp_path: Path, changes: dict[str, object], sentence: str
) -> None:
    write_frame(tmp_path / "x.glb", scene.at_frame(3))
    rewritten(tmp_path / "x.glb", **changes)
    with pytest.raises(FrogError, match=sentence):
        read(tmp_path / "x.glb")


def imported(content: bytes, suffix: str, folder: Path) -> GaussianArrays:
    (folder / f"foreign{suffix}").write_bytes(content)
    return ScenePlayer.load(import_scene(folder / f"foreign{suffix}", folder / "back.frog").path).at_frame(0)


OTHERS = {
    "splat": (".splat", foreign_files.splat, (0, 1e-5, 1e-3), None),
    "ksplat, plain": (".ksplat", partial(foreign_files.ksplat, level=0), (0, 1e-5, 1e-5), (1, 1e-6)),
    "ksplat, halved": (".ksplat", partial(foreign_files.ksplat, level=1), (1e-3, 1e-3, 1e-5), (1, 1e-3)),
    "ksplat, in bytes": (".ksplat", partial(foreign_files.ksplat, level=2), (1e-3, 1e-3, 1e-5), (1, 0.01)),
    "sog": (".sog", foreign_files.sog, (1e-3, 0.02, 1e-3), (0, 0.02)),
}
"""Ending and maker; by how much places, logarithms of sizes and turns may be off; the harmonics that are kept, from
which one on, and by how much they may be off."""


@pytest.mark.parametrize("kind", OTHERS)
def test_formats_of_others_are_read(scene: ScenePlayer, tmp_path: Path, kind: str) -> None:
    pytest.importorskip("cv2")
    suffix, made, (places, sizes, turns), harmonics = OTHERS[kind]
    before = scene.at_frame(3)
    if suffix == ".ksplat":
        before.sh = before.sh.clip(-1.4, 1.4)
    after = imported(made(before), suffix, tmp_path)
    np.testing.assert_allclose(after.means, before.means, atol=places)
    np.testing.assert_allclose(np.log(after.scales), np.log(before.scales), atol=sizes)
    np.testing.assert_allclose(after.opacities, before.opacities, atol=0.5 / 255 + 1e-5)
    assert turns_apart(after, before) < turns
    if harmonics is None:
        assert after.sh.shape == (40, 1, 3)
    else:
        np.testing.assert_allclose(after.sh[:, harmonics[0] :], before.sh[:, harmonics[0] :], atol=harmonics[1])


def test_frames_by_the_command(scene: ScenePlayer, tmp_path: Path) -> None:
    for kind in ("spz", "glb"):
        arguments = ["export", str(tmp_path / "x.frog"), f"--{kind}", "--frames", "2:4", "--out", str(tmp_path / kind)]
        assert main(arguments) == 0
        assert sorted(path.name for path in (tmp_path / kind).iterdir()) == [f"x_0002.{kind}", f"x_0003.{kind}"]
        assert main(["import", str(tmp_path / kind / f"x_0003.{kind}")]) == 0
        back = ScenePlayer.load(tmp_path / kind / "x_0003.frog")
        found = sorted_like(back.at_frame(0), scene.at_frame(3), back.at_frame(0))
        np.testing.assert_allclose(found.means, scene.at_frame(3).means, atol=1e-4)
        assert main([*arguments, "--y-down"]) == 1


@pytest.mark.parametrize("suffix", [".spz", ".glb", ".splat", ".ksplat", ".sog", ".zip", ".xyz"])
def test_what_is_none_is_one_sentence(tmp_path: Path, suffix: str) -> None:
    (tmp_path / f"x{suffix}").write_bytes(b"nothing of the kind")
    for name in ("x", "missing"):
        with pytest.raises(FrogError, match=rf"{name}\{suffix}: found"):
            import_scene(tmp_path / f"{name}{suffix}", tmp_path / "y.frog")
    assert not (tmp_path / "y.frog").exists()
