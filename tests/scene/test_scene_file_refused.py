"""Files that are no scene, or a damaged one: refused in one sentence, by whoever opens them."""

from __future__ import annotations

import json
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import MODEL, scene_file

from frog_blender.engine.errors import FrogError
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene import scene_file as scene_files
from frog_blender.engine.scene.header import FORMAT_VERSION
from frog_blender.engine.scene.scene_file import read_scene, write_scene


@pytest.fixture
def path(tmp_path: Path) -> Path:
    write_scene(tmp_path / "x.frog", scene_file())
    return tmp_path / "x.frog"


def refused(path: Path) -> str:
    """The one sentence with which a file is refused, by playback too."""
    with pytest.raises(FrogError) as caught:
        ScenePlayer.load(path).at(0.3)
    sentence = str(caught.value)
    assert "\n" not in sentence and sentence.endswith(".") and len(sentence) < 600
    return sentence


def test_missing_and_folder(tmp_path: Path) -> None:
    assert "no file" in refused(tmp_path / "none.frog")
    assert "a folder" in refused(tmp_path)


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9999])
def test_truncated(path: Path, share: float) -> None:
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * share)])
    refused(path)


def test_foreign_files(path: Path) -> None:
    for content in (
        b"\x89PNG\r\n\x1a\n" + bytes(200),
        b"ply\nformat binary_little_endian 1.0\nend_header\n",
        b"\x80\x04\x95\x10\x00\x00\x00",
        struct.pack("<Q", 2**63) + b"{}",
        struct.pack("<Q", 2) + b"[]",
        np.random.default_rng(0).bytes(5000),
    ):
        path.write_bytes(content)
        assert str(path) in refused(path)


def with_header(path: Path, **changes: Any) -> None:
    """Rewrites the file's header with other values; None takes the key out."""
    scene = read_scene(path)
    data = {**json.loads(scene.header.to_json()), **changes}
    text = json.dumps({key: value for key, value in data.items() if value is not None})
    path.write_bytes(scene_files.serialize(scene.arrays, metadata={"frog": text}))


@pytest.mark.parametrize("version", [FORMAT_VERSION - 1, FORMAT_VERSION + 1])
def test_another_version_says_so(path: Path, version: int) -> None:
    with_header(path, format_version=version)
    assert f"found format version {version}, expected version {FORMAT_VERSION}" in refused(path)


@pytest.mark.parametrize(
    "changes",
    [
        {"model": {}},
        {"model": {**MODEL, "deformed_sh": 9}},
        {"model": {**MODEL, "coarse_rows": 7}},
        {"model": {**MODEL, "coarse_rows": 0}},
        {"model": {**MODEL, "hidden_width": -24}},
        {"model": {**MODEL, "head_width": "wide"}},
        {"model": {**MODEL, "opacity_reduction": "most"}},
        {"model": {**MODEL, "opacity_sharpness": None}},
        {"model": {**MODEL, "motion_unit": []}},
    ],
)
def test_models_that_cannot_be_used(path: Path, changes: dict[str, Any]) -> None:
    """Every other value of the header: test_header."""
    with_header(path, **changes)
    refused(path)


def test_a_safetensors_file_without_a_header(path: Path) -> None:
    arrays = read_scene(path).arrays
    for metadata in (None, {}, {"other": "{}"}, {"frog": "{"}, {"frog": "[]"}, {"frog": "null"}, {"frog": ""}):
        path.write_bytes(scene_files.serialize(arrays, metadata=metadata))
        refused(path)


@pytest.mark.parametrize(
    ("name", "shape"),
    [
        ("means", (40, 2)),
        ("means", ()),
        ("means", (0, 3)),
        ("quaternions", (40, 3)),
        ("opacity_logits", (40, 1)),
        ("sh", (40, 5, 3)),
        ("sh", ()),
        ("embeddings", (41, 8)),
        ("embeddings", (40, 7)),
        ("temporal_table", (5, 8)),
        ("network.bias", (16,)),
        ("network.head_weight", None),
    ],
    ids=str,
)
def test_arrays_of_the_wrong_shape(path: Path, name: str, shape: tuple[int, ...] | None) -> None:
    """Shapes are checked when a scene is opened: the native library only sees addresses."""
    scene = read_scene(path)
    header = scene.header
    if shape is None:
        header = replace(header, model={**header.model, "head_width": 16})  # but the file has no heads
    else:
        scene.arrays[name] = np.ones(shape, np.float32)
    path.write_bytes(scene_files.serialize(scene.arrays, metadata={"frog": header.to_json()}))
    with pytest.raises(FrogError) as caught:
        ScenePlayer.load(path)
    assert "\n" not in str(caught.value)


def test_a_missing_array(path: Path) -> None:
    whole = read_scene(path)
    for name in whole.arrays:
        arrays = {other: array for other, array in whole.arrays.items() if other != name}
        write_scene(path, replace(whole, arrays=arrays))
        refused(path)
