"""One time's Gaussians in other formats: out and in again, and as other programs write them."""

import io
import json
import re
import struct
import zipfile
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support import foreign_files
from support.builders import refused
from support.foreign_takes import partly_static, sorted_like

from frog_blender.cli.main import main
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.interchange import sog
from frog_blender.engine.interchange.frame_files import write_frame
from frog_blender.engine.interchange.gltf import EXTENSION
from frog_blender.engine.interchange.imports import import_scene, open_source
from frog_blender.engine.interchange.spz import Spz
from frog_blender.engine.interchange.stills import display_referred
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.transform import rotations_of, transform
from frog_blender.engine.spherical_harmonics import SH_DC, sh_terms
from frog_blender.engine.srgb import linear_to_srgb


def read(path: Path) -> tuple[GaussianArrays, int]:
    """A file's Gaussians with z up, and how many are left out."""
    source = open_source(path)
    return source.at(0), source.left_out


def turns_apart(actual: GaussianArrays, expected: GaussianArrays) -> float:
    """The largest difference of quaternions, whatever their signs."""
    return float((1 - np.abs((actual.quaternions * expected.quaternions).sum(axis=1))).max())


@pytest.mark.parametrize(("sh_count", "version"), [(1, 2), (1, 3), (4, 4), (9, 4), (16, 2), (16, 3), (16, 4)])
def test_spz_there_and_back(tmp_path: Path, sh_count: int, version: int) -> None:
    if version == 4:
        pytest.importorskip("zstandard")
    before = partly_static(tmp_path, sh_count=sh_count).at_frame(3)
    before.sh = before.sh.clip(-0.9, 0.9)
    write_frame(tmp_path / "x.spz", before, spz=Spz(version))
    after, left_out = read(tmp_path / "x.spz")
    content = (tmp_path / "x.spz").read_bytes()
    assert (content if version == 4 else zlib.decompress(content, 31))[:5] == b"NGSP" + bytes([version])
    assert left_out == 0 and after.sh.shape == before.sh.shape
    np.testing.assert_allclose(after.means, before.means, atol=1e-5)
    np.testing.assert_allclose(np.log(after.scales), np.log(before.scales), atol=0.5 / 16 + 1e-3)
    np.testing.assert_allclose(after.opacities, before.opacities, atol=0.5 / 255 + 1e-6)
    np.testing.assert_allclose(after.sh[:, 0], before.sh[:, 0], atol=0.5 / 255 / 0.15 + 1e-4)
    axes = [rotations_of(g.quaternions) for g in (after, before)]
    worst = np.abs(np.einsum("nij,nij->nj", *axes)).min()
    assert worst > np.cos(np.radians(1.0 if version == 2 else 0.25)), "half turns about its own axes are none"


def test_a_coarse_spz_is_smaller(tmp_path: Path) -> None:
    """Places in steps of 1/4096; harmonics in 1/16 of degree 1, and 1/8 of others."""
    before = partly_static(tmp_path, sh_count=16).at_frame(3)
    before.sh = before.sh.clip(-0.9, 0.9)
    for name, spz in {"x": Spz(), "coarse": Spz(coarse=True)}.items():
        write_frame(tmp_path / f"{name}.spz", before, spz=spz)
    assert (tmp_path / "coarse.spz").stat().st_size < 0.9 * (tmp_path / "x.spz").stat().st_size
    after, _ = read(tmp_path / "coarse.spz")
    np.testing.assert_allclose(after.means, before.means, atol=0.5 / 4096 + 1e-6)
    np.testing.assert_allclose(after.sh[:, 1:4], before.sh[:, 1:4], atol=0.5 / 16 + 1e-6)
    np.testing.assert_allclose(after.sh[:, 1:4], np.rint(after.sh[:, 1:4] * 16) / 16, atol=1e-6)
    np.testing.assert_allclose(after.sh[:, 4:], before.sh[:, 4:], atol=0.15)  # a turn mixes these


def test_old_spz_is_read(tmp_path: Path) -> None:
    """Version 2, whose turns are three bytes: made by hand, unpacked and packed. In the file y is up."""
    head = struct.pack("<IIIBBBB", 0x5053474E, 2, 1, 0, 8, 0, 0)
    body = b"".join((256 * n).to_bytes(3, "little") for n in (1, 2, 3)) + bytes(
        [230, 85, 128, 170, 123, 123, 123, 128, 128, 128]
    )
    for content in (head + body, zlib.compress(head + body, wbits=31)):
        (tmp_path / "x.spz").write_bytes(content)
        actual, _ = read(tmp_path / "x.spz")
        np.testing.assert_allclose(actual.means, [[1, -3, 2]], atol=1e-6)
        np.testing.assert_allclose(actual.scales, np.exp(123 / 16 - 10), rtol=1e-5)
        np.testing.assert_allclose(actual.opacities, 230 / 255, rtol=1e-6)


RDF, LUB = 6, 3  # axes as an extension numbers them: those of most .ply files, and mirrored ones


def fourth_spz(path: Path, gaussians: GaussianArrays, axes: int, degree: int = 0) -> None:
    """A file of version 4 with two extensions, one of which names its axes, and harmonics of any degree."""
    zstandard = pytest.importorskip("zstandard")
    write_frame(path, gaussians, spz=Spz(4))
    content, count = bytearray(path.read_bytes()), len(gaussians)
    content[14] = 2
    sizes = [content[32 + 16 * stream : 48 + 16 * stream] for stream in range(5)]
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
    actual, _ = read(tmp_path / "x.spz")
    np.testing.assert_allclose(actual.means, plain.means * (1, -1, -1), atol=1e-6)
    assert actual.sh.shape == (40, 16, 3), "no other format has the fourth degree"
    np.testing.assert_allclose(np.square(actual.sh[:, 1:]).sum(axis=1), 15 * 0.25, rtol=1e-4)
    fourth_spz(tmp_path / "x.spz", before, LUB)
    refused(r"x\.spz: .*mirrored", read, tmp_path / "x.spz")


@pytest.mark.parametrize("beside", [None, "the buffer.bin"])
def test_gltf_text_is_read(scene: ScenePlayer, tmp_path: Path, beside: str | None) -> None:
    before = scene.at_frame(3)
    text, buffer = foreign_files.gltf(before, beside and beside.replace(" ", "%20"))
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
    text, buffer = foreign_files.gltf(scene.at_frame(3), uri)
    (tmp_path.parent / "up.bin").write_bytes(buffer)
    (tmp_path / "short.bin").write_bytes(buffer[:10])
    (tmp_path / "x.gltf").write_text(text)
    refused(sentence, read, tmp_path / "x.gltf")


def test_another_program_reads_the_gltf(scene: ScenePlayer, tmp_path: Path) -> None:
    fourdgs = pytest.importorskip("fourdgs", reason="reads KHR_gaussian_splatting")
    before = scene.at_frame(3)
    write_frame(tmp_path / "x.glb", before)
    actual = fourdgs.from_gltf(str(tmp_path / "x.glb"))
    assert actual.metadata["color_space"] == "srgb-rec709-display"
    np.testing.assert_allclose(actual.gaussians.positions, before.means[:, [0, 2, 1]] * (1, 1, -1), atol=1e-6)
    np.testing.assert_allclose(actual.gaussians.scales, before.scales, rtol=1e-5)
    np.testing.assert_allclose(actual.gaussians.colors[:, 3], before.opacities, atol=1e-6)


def described(path: Path, gaussians: GaussianArrays, **changes: object) -> Any:
    """A ``.gltf`` with another description, which is the result."""
    document = json.loads(foreign_files.gltf(gaussians)[0]) | changes
    path.write_text(json.dumps(document))
    return document


def test_gltf_nodes_place_it(scene: ScenePlayer, tmp_path: Path) -> None:
    before = scene.at_frame(3)
    parent = {"children": [1], "translation": [0, 5, 0], "scale": [2, 2, 2]}
    described(tmp_path / "x.gltf", before, nodes=[parent, {"mesh": 0}])
    after, _ = read(tmp_path / "x.gltf")
    expected = transform(before, np.array([[2, 0, 0, 0], [0, 2, 0, 0], [0, 0, 2, 5], [0, 0, 0, 1.0]]))
    np.testing.assert_allclose(after.means, expected.means, atol=1e-5)
    np.testing.assert_allclose(after.scales, expected.scales, rtol=1e-5)


def test_a_gltf_shows_one_of_its_scenes(scene: ScenePlayer, tmp_path: Path) -> None:
    """What is in others or in none, or hidden, is left out, with a word."""
    before, path = scene.at_frame(3), tmp_path / "x.gltf"
    nodes: list[dict[str, Any]] = [{"mesh": 0, "translation": [10 * index, 0, 0]} for index in range(3)]
    nodes.append({"children": [2], "extensions": {"KHR_node_visibility": {"visible": False}}})
    for shown in (0, 1):
        described(path, before, nodes=nodes, scenes=[{"nodes": [1, 3]}, {"nodes": [0, 3]}], scene=shown)
        source = open_source(path)
        np.testing.assert_allclose(source.at(0).means[:, 0], before.means[:, 0] + 10 * (1 - shown), atol=1e-5)
        assert len(source.notes) == 1 and "left out: they are hidden, or not in the scene" in source.notes[0]
    described(path, before, nodes=nodes, scenes=[{"nodes": [3]}, {"nodes": [0, 1]}])
    refused("no Gaussians in what it shows", open_source, path)


def test_what_a_gltf_says_of_gaussians_that_is_not_read_is_named(scene: ScenePlayer, tmp_path: Path) -> None:
    instances = {"EXT_mesh_gpu_instancing": {"attributes": {"TRANSLATION": 0}}, "KHR_xmp_json_ld": {"packet": 0}}
    document = described(tmp_path / "x.gltf", scene.at_frame(3), animations=[{}])
    assert open_source(tmp_path / "x.gltf").notes == ("Not read, and so not seen: animations.",)
    nodes = [{"mesh": 0, "skin": 0, "extensions": instances}, {"extensions": {"KHR_lights_punctual": {"light": 0}}}]
    (tmp_path / "x.gltf").write_text(json.dumps(document | {"animations": [], "nodes": nodes}))
    assert open_source(tmp_path / "x.gltf").notes == ("Not read, and so not seen: EXT_mesh_gpu_instancing, skin.",)


WORDS = ("kernel", "colorSpace", "projection", "sortingMethod")


def meant(**meaning: object) -> dict[str, Any]:
    """A mesh of one primitive with these words of the extension, and no attributes."""
    return {"primitives": [{"attributes": {}, "extensions": {EXTENSION: meaning}}]}


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"nodes": [{"mesh": 0, "scale": [1, 2, 1]}]}, "scaled unevenly"),
        ({"nodes": [{"children": [0], "mesh": 0}]}, "below two others, or itself"),
        ({"nodes": [{"mesh": 7}]}, "a mesh"),
        ({"extensionsRequired": ["KHR_draco"]}, "the required extension KHR_draco"),
        ({"accessors": []}, "accessor of POSITION"),
        ({"bufferViews": [{"buffer": 0, "byteOffset": 0, "byteLength": 1}] * 4}, "count of POSITION"),
        *(({"meshes": [meant(**{name: "another"})]}, f"found {name} = another, expected one of") for name in WORDS),
        ({"meshes": [meant(extensions={"a": {}})]}, "compr"),
    ],
)
def test_gltf_that_cannot_be_used(
    scene: ScenePlayer, tmp_path: Path, changes: dict[str, object], sentence: str
) -> None:
    described(tmp_path / "x.gltf", scene.at_frame(3), **changes)
    refused(sentence, read, tmp_path / "x.gltf")


def imported(content: bytes, suffix: str, folder: Path) -> GaussianArrays:
    (folder / f"foreign{suffix}").write_bytes(content)
    return ScenePlayer.load(import_scene(folder / f"foreign{suffix}", folder / "back.frog").path).at_frame(0)


OTHERS = {
    "splat": (".splat", foreign_files.splat, (0, 1e-5, 1e-3), None),
    "sog": (".sog", foreign_files.sog, (1e-3, 0.02, 1e-3), (0, 0.02)),
    "compressed ply": (".compressed.ply", foreign_files.compressed_ply, (3e-3, 2e-3, 1e-4), (0, 0.02)),
}
"""Ending and maker; by how much places, logarithms of sizes and turns may be off; the harmonics that are kept, from
which one on, and by how much they may be off."""


@pytest.mark.parametrize("kind", OTHERS)
def test_formats_of_others_are_read(scene: ScenePlayer, tmp_path: Path, kind: str) -> None:
    pytest.importorskip("cv2")
    suffix, made, (places, sizes, turns), harmonics = OTHERS[kind]
    before = scene.at_frame(3)
    after = imported(made(before), suffix, tmp_path)
    np.testing.assert_allclose(after.means, before.means, atol=places)
    np.testing.assert_allclose(np.log(after.scales), np.log(before.scales), atol=sizes)
    np.testing.assert_allclose(after.opacities, before.opacities, atol=0.5 / 255 + 1e-5)
    assert turns_apart(after, before) < turns
    if harmonics is None:
        assert after.sh.shape == (40, 1, 3)
    else:
        np.testing.assert_allclose(after.sh[:, harmonics[0] :], before.sh[:, harmonics[0] :], atol=harmonics[1])


@pytest.mark.parametrize("name", ["x.sog", "x.compressed.ply"])
@pytest.mark.parametrize("sh_count", [1, 4, 16])
def test_packed_stills_there_and_back(tmp_path: Path, name: str, sh_count: int) -> None:
    """Of more Gaussians than share a chunk, in another order."""
    pytest.importorskip("cv2")
    before = partly_static(tmp_path, sh_count=sh_count).at_frame(3).part(np.arange(600) % 40)
    before.means = before.means + np.linspace(0, 1, 600, dtype=np.float32)[:, None]
    before.opacities[:2] = 0, 1
    write_frame(tmp_path / name, before)
    after, left_out = read(tmp_path / name)
    assert left_out == 0 and after.sh.shape == before.sh.shape
    after = sorted_like(after, before, after)
    np.testing.assert_allclose(after.means, before.means, atol=4e-3)
    np.testing.assert_allclose(np.log(after.scales), np.log(before.scales), atol=0.01)
    np.testing.assert_allclose(after.opacities, before.opacities, atol=0.5 / 255 + 1e-5)
    shown = before.opacities > 0  # WebP keeps no colours of others
    np.testing.assert_allclose(after.sh[shown], before.sh[shown], atol=0.05)
    assert turns_apart(after, before) < (1e-4 if name == "x.sog" else 1e-5)


def test_a_packed_still_is_one_gaussian_as_well(scene: ScenePlayer, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    before = scene.at_frame(3).part(np.arange(1))
    for name in ("x.sog", "x.compressed.ply"):
        write_frame(tmp_path / name, before)
        np.testing.assert_allclose(read(tmp_path / name)[0].means, before.means, rtol=1e-5)


def test_a_palette_stands_for_more_harmonics_than_it_has(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Groups that are alike stay what they are, whatever of them cannot be seen."""
    pytest.importorskip("cv2")
    before = partly_static(tmp_path, sh_count=4).at_frame(3).part(np.arange(600) % 40)
    before.means = before.means + np.linspace(0, 1, 600, dtype=np.float32)[:, None]
    before.opacities[::7] = 0
    monkeypatch.setattr(sog, "_MOST_ROWS", 40)
    write_frame(tmp_path / "x.sog", before)
    after = read(tmp_path / "x.sog")[0]
    after = sorted_like(after, before, after)
    np.testing.assert_allclose(after.sh[:, 1:], before.sh[:, 1:], atol=0.03)
    monkeypatch.setattr(sog, "_MOST_ROWS", 5)
    write_frame(tmp_path / "x.sog", before)
    coarse, plain = read(tmp_path / "x.sog")[0].sh[:, 1:], before.sh[:, 1:]
    assert len(np.unique(coarse.reshape(600, -1), axis=0)) == 5
    assert abs(coarse.mean() - plain.mean()) < 0.05


def test_chunks_of_a_compressed_ply(scene: ScenePlayer, tmp_path: Path) -> None:
    """Of more Gaussians than share one, and without the harmonics and the colours' ranges, which nobody has to have."""
    before = scene.at_frame(3).part(np.arange(600) % 40)
    content = foreign_files.compressed_ply(before)
    (tmp_path / "x.compressed.ply").write_bytes(content)
    source = open_source(tmp_path / "x.compressed.ply")
    np.testing.assert_allclose(source.at(0).means, before.means, atol=3e-3)
    assert source.notes and "anti-aliasing" in source.notes[0]
    plainer = re.sub(rb"float (m.._[rgb])\n", rb"float no\1\n", content.replace(b"element sh", b"element other"))
    (tmp_path / "x.ply").write_bytes(plainer)
    assert open_source(tmp_path / "x.ply").at(0).sh.shape == (600, 1, 3)
    (tmp_path / "x.ply").write_bytes(content.replace(b"element chunk 3", b"element chunk 2"))
    refused("without its ranges", open_source, tmp_path / "x.ply")


def test_parts_of_a_sog_in_a_folder(scene: ScenePlayer, tmp_path: Path) -> None:
    pytest.importorskip("cv2")
    before = scene.at_frame(3)
    (tmp_path / "x.sog").write_bytes(foreign_files.sog(before))
    plain, packed = (import_scene(tmp_path / "x.sog", tmp_path / f"{c}.frog", compact=c) for c in (False, True))
    assert packed.path.stat().st_size < 0.7 * plain.path.stat().st_size and "anti-aliasing" in plain.warning
    folder = foreign_files.old_sog((tmp_path / "x.sog").read_bytes(), tmp_path / "parts")
    for source in (folder, folder / "meta.json"):
        back = tmp_path / f"{source.name}.frog"
        assert main(["import", str(source), "--out", str(back)]) == 0
        after = ScenePlayer.load(back).at_frame(0)
        np.testing.assert_allclose(after.means, before.means, atol=1e-3)
        np.testing.assert_allclose(np.log(after.scales), np.log(before.scales), atol=0.02)
        np.testing.assert_allclose(after.sh, before.sh, atol=0.02)
        np.testing.assert_allclose(after.opacities, 1 / (1 + np.exp(5 - 10 * before.opacities)), atol=0.01)
    (folder / "meta.json").write_text((folder / "meta.json").read_text().replace("means_l", "../means_l"))
    refused("one in the folder of the file", import_scene, folder, tmp_path / "back.frog")


def test_linear_colours_become_srgb(tmp_path: Path) -> None:
    before = partly_static(tmp_path, sh_count=4).at_frame(3)
    document = described(tmp_path / "x.gltf", before)
    document["meshes"][0]["primitives"][0]["extensions"][EXTENSION]["colorSpace"] = "lin_rec709_display"
    (tmp_path / "x.gltf").write_text(json.dumps(document))
    source = open_source(tmp_path / "x.gltf")
    assert "linear" in source.notes[0]
    for x, y, z in np.eye(3):
        basis = np.array([SH_DC, *sh_terms(4, x, y, z)])
        linear, shown = (0.5 + np.einsum("k,nkc->nc", basis, g.sh) for g in (before, source.at(0)))
        np.testing.assert_allclose(shown, linear_to_srgb(linear.clip(0)), atol=0.1)
    before.sh = before.sh[:, :1]
    np.testing.assert_allclose(
        0.5 + SH_DC * display_referred(before).sh, linear_to_srgb((0.5 + SH_DC * before.sh).clip(0)), atol=1e-6
    )


@pytest.mark.parametrize("kernel", [{"kernel": "ellipse"}, {}])
def test_spz_in_gltf(scene: ScenePlayer, tmp_path: Path, kernel: dict[str, str]) -> None:
    """In the axes that its extension names, turned about the vertical; drafts had the numbers as they are."""
    write_frame(tmp_path / "x.spz", scene.at_frame(3))
    expected, _ = read(tmp_path / "x.spz")
    packed = (tmp_path / "x.spz").read_bytes()
    meaning = {**kernel, "extensions": {f"{EXTENSION}_compression_spz_2": {"bufferView": 0}}}
    described(
        tmp_path / "x.gltf",
        scene.at_frame(3),
        extensionsRequired=[EXTENSION, f"{EXTENSION}_compression_spz_2", "KHR_materials_unlit"],
        meshes=[meant(**meaning)],
        bufferViews=[{"buffer": 0, "byteOffset": 0, "byteLength": len(packed)}],
        buffers=[{"byteLength": len(packed), "uri": "x.spz"}],
    )
    actual, _ = read(tmp_path / "x.gltf")
    np.testing.assert_allclose(actual.means, expected.means * ((-1, -1, 1) if kernel else (1, 1, 1)), atol=1e-6)


def test_whole_numbers_of_a_gltf(scene: ScenePlayer, tmp_path: Path) -> None:
    """KHR_mesh_quantization: places in steps that a node's scale makes right."""
    before = scene.at_frame(3)
    document = described(tmp_path / "x.gltf", before)
    steps = np.zeros((40, 4), "<i2")
    steps[:, :3] = np.rint(before.means[:, [0, 2, 1]] * (1000, 1000, -1000))
    document["accessors"][0] |= {"componentType": 5122, "bufferView": len(document["bufferViews"])}
    document["bufferViews"].append({"buffer": 1, "byteLength": steps.nbytes, "byteStride": 8})
    document["buffers"].append({"byteLength": steps.nbytes, "uri": "steps.bin"})
    (tmp_path / "steps.bin").write_bytes(steps.tobytes())
    document |= {"extensionsRequired": ["KHR_mesh_quantization"], "nodes": [{"mesh": 0, "scale": [0.001] * 3}]}
    (tmp_path / "x.gltf").write_text(json.dumps(document))
    np.testing.assert_allclose(read(tmp_path / "x.gltf")[0].means, before.means, atol=6e-4)


HEAD = struct.pack("<IIIBBBB", 0x5053474E, 3, 10**6, 0, 9, 0, 0)
BOMBS = {
    "x.spz": lambda: zlib.compress(HEAD + bytes(10**7), wbits=31),
    "fourth.spz": lambda: struct.pack("<IIIBBBBI12x", 0x5053474E, 4, 10**6, 0, 12, 0, 5, 32) + bytes(5 * 16),
    "many.zip": lambda: zipped("1.ply", bytes(10**6), 10),
    "announced.zip": lambda: announced(),
    "x.sog": lambda: zipped("meta.json", bytes(10**7)),
}
"""Content that is small, and becomes far more or says so; it is refused before anything is unpacked."""


def announced() -> bytes:
    """A zip whose directory says that a file is two gigabytes large."""
    content = bytearray(zipped("1.ply", b"ply\n"))
    at = content.rindex(b"PK\x01\x02")
    content[at + 24 : at + 28] = (2**31).to_bytes(4, "little")
    return bytes(content)


def zipped(name: str, content: bytes, count: int = 1) -> bytes:
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for index in range(count):
            archive.writestr(f"{index or ''}{name}", content)
    return file.getvalue()


@pytest.mark.parametrize("name", BOMBS)
def test_what_becomes_far_more_is_refused(tmp_path: Path, name: str) -> None:
    (tmp_path / name).write_bytes(BOMBS[name]())
    refused(r"that become .* expected at most 8,388,608", open_source, tmp_path / name)


def test_flags_of_an_spz(scene: ScenePlayer, tmp_path: Path) -> None:
    write_frame(tmp_path / "x.spz", scene.at_frame(3))
    content = bytearray(zlib.decompress((tmp_path / "x.spz").read_bytes(), 31))
    content[14] = 1
    (tmp_path / "x.spz").write_bytes(content)
    assert "anti-aliasing" in import_scene(tmp_path / "x.spz", tmp_path / "y.frog").warning
    content[14] = 0x80
    (tmp_path / "x.spz").write_bytes(content)
    refused("flags 0x80", read, tmp_path / "x.spz")


def test_frames_by_the_command(scene: ScenePlayer, tmp_path: Path) -> None:
    for kind in ("spz", "glb", "sog", "compressed.ply"):
        option = f"--{kind}".replace(".", "-")
        out = tmp_path / f"of {kind[:3]}"
        arguments = ["export", str(tmp_path / "x.frog"), option, "--frames", "2:4", "--out", str(out)]
        assert main(arguments) == 0
        assert sorted(path.name for path in out.iterdir()) == [f"x_0002.{kind}", f"x_0003.{kind}"]
        assert main(["import", str(out / f"x_0003.{kind}")]) == 0
        back = ScenePlayer.load((out / f"x_0003.{kind}").with_suffix(".frog"))
        actual = sorted_like(back.at_frame(0), scene.at_frame(3), back.at_frame(0))
        np.testing.assert_allclose(actual.means, scene.at_frame(3).means, atol=4e-3)
        assert main([*arguments, "--y-down"]) == (2 if kind in ("spz", "glb") else 0)


@pytest.mark.parametrize("suffix", [".spz", ".glb", ".splat", ".sog", ".zip", ".xyz"])
def test_what_is_none_is_one_sentence(tmp_path: Path, suffix: str) -> None:
    (tmp_path / f"x{suffix}").write_bytes(b"nothing of the kind")
    for name in ("x", "missing"):
        refused(rf"{name}\{suffix}: found", import_scene, tmp_path / f"{name}{suffix}", tmp_path / "y.frog")
    assert not (tmp_path / "y.frog").exists()
