"""Files of earlier format versions, written by the code of their time: see fixtures/old_formats/README.md."""

from __future__ import annotations

import hashlib
import json
import platform
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from support.builders import run_python

from frog_blender.cli.main import main
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.scene_file import read_scene, write_scene

FOLDER = Path(__file__).parent / "fixtures" / "old_formats"
EXPECTED: dict[str, Any] = json.loads((FOLDER / "expected.json").read_text())
SCENES = sorted(EXPECTED["scenes"])
TIMES = (0.0, 0.3, 1.0)
ATTRIBUTES = ("means", "quaternions", "scales", "opacities", "sh")
EVERY = 10
"""Of the Gaussians that a scene plays, one of so many is kept in expected.npz."""

PLAY = """
import hashlib, json, sys
import numpy as np
from frog_blender.engine.playback.player import ScenePlayer

values = np.linspace(-5, 5, 256, dtype=np.float32)
rounding = hashlib.sha256(np.exp(values).tobytes() + (values.reshape(16, 16) @ values.reshape(16, 16).T).tobytes())
found = {}
for path in sys.argv[1:]:
    scene = ScenePlayer.load(path)
    for time in (0.0, 0.3, 1.0):
        gaussians = scene.at(time)
        arrays = [getattr(gaussians, name) for name in ("means", "quaternions", "scales", "opacities", "sh")]
        content = b"".join(np.ascontiguousarray(array).tobytes() for array in arrays)
        found.setdefault(path.rpartition("/")[2], []).append(hashlib.sha256(content).hexdigest())
print(json.dumps({"rounding": rounding.hexdigest(), "bits": found}))
"""


def digest(arrays: dict[str, np.ndarray]) -> str:
    whole = hashlib.sha256()
    for name, array in sorted(arrays.items()):
        whole.update(f"{name} {array.dtype} {array.shape}".encode() + np.ascontiguousarray(array).tobytes())
    return whole.hexdigest()


def assert_plays_as_then(scene: ScenePlayer, name: str, tolerance: float = 1e-5) -> None:
    """Rounding of processors and of later versions is allowed for."""
    with np.load(FOLDER / "expected.npz") as then:
        for time in TIMES:
            for attribute in ATTRIBUTES:
                found = getattr(scene.at(time), attribute)[::EVERY]
                expected = then[f"{name}/{time}/{attribute}"]
                np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance, err_msg=attribute)


def test_every_version_and_kind_is_there() -> None:
    headers = {name: read_scene(FOLDER / name) for name in SCENES}
    assert {scene.header.format_version for scene in headers.values()} == {1, 2, 3, 4, 5, 6}
    kinds = {kind for scene in headers.values() for kind in ("lifetimes", "fades") if kind in scene.arrays}
    assert kinds == {"lifetimes", "fades"}
    assert any(scene.header.model.get("reshaped") for scene in headers.values())
    assert any(scene.header.model.get("segments") for scene in headers.values())


@pytest.mark.parametrize("name", SCENES)
def test_arrays_are_read_as_they_were_then(name: str) -> None:
    """Bit by bit on any machine: unpacking only adds and multiplies."""
    scene, expected = read_scene(FOLDER / name), EXPECTED["scenes"][name]
    assert scene.header.format_version == expected["format_version"]
    assert digest(scene.arrays) == expected["arrays"]


@pytest.mark.parametrize("name", SCENES)
def test_an_old_scene_plays_as_it_did_then(name: str) -> None:
    assert_plays_as_then(ScenePlayer.load(FOLDER / name), name)


def test_old_scenes_play_the_same_bits() -> None:
    """With the kernels that every x86-64 processor has, where numpy rounds as on the machine of expected.json."""
    if platform.machine().lower() not in ("x86_64", "amd64"):
        pytest.skip("other processors round differently")
    run = run_python(PLAY, *(FOLDER / name for name in SCENES), FROG_INSTRUCTION_SET="baseline")
    assert run.returncode == 0, run.stderr
    found = json.loads(run.stdout)
    if found["rounding"] != EXPECTED["rounding"]:
        pytest.skip("numpy rounds differently on this processor")
    assert found["bits"] == {name: EXPECTED["scenes"][name]["bits"] for name in SCENES}


@pytest.mark.parametrize("name", SCENES)
def test_an_old_scene_is_drawn(name: str) -> None:
    scene = ScenePlayer.load(FOLDER / name)
    camera = scene.header.cameras[0]
    rgb = draw(scene.at(0.3), camera, scene.header.background).rgb
    assert rgb.shape == (camera.height, camera.width, 3) and np.isfinite(rgb).all()
    assert rgb.mean() == pytest.approx(EXPECTED["scenes"][name]["brightness"], abs=1e-3)


@pytest.mark.parametrize("name", SCENES)
def test_an_old_scene_is_written_again(tmp_path: Path, name: str) -> None:
    old = read_scene(FOLDER / name)
    write_scene(tmp_path / "whole.frog", old)
    whole = read_scene(tmp_path / "whole.frog")
    assert digest(whole.arrays) == digest(old.arrays)
    assert whole.header.to_json() == old.header.to_json()
    write_scene(tmp_path / "packed.frog", old, compact=True)
    assert (tmp_path / "packed.frog").stat().st_size < (tmp_path / "whole.frog").stat().st_size
    assert_plays_as_then(ScenePlayer.load(tmp_path / "packed.frog"), name, tolerance=0.02)


def put_down(tmp_path: Path, version: int) -> Path:
    """A checkpoint beside the name of its scene, which is given back."""
    shutil.copy(FOLDER / f"checkpoint_{version}.frog.checkpoint", tmp_path / "old.frog.checkpoint")
    return tmp_path / "old.frog"


@pytest.mark.parametrize("version", [4, 11])
def test_a_checkpoint_of_another_version_is_refused_in_a_sentence(
    tmp_path: Path, filmed: Path, own_cache: Path, capsys: pytest.CaptureFixture[str], version: int
) -> None:
    scene = put_down(tmp_path, version)
    checkpoint = tmp_path / "old.frog.checkpoint"
    before = checkpoint.read_bytes()
    assert main(["train", str(filmed), "--out", str(scene), "--resume", "--device", "cpu"]) == 1
    said = capsys.readouterr().err.strip()
    assert f"{checkpoint}: found checkpoint version {version}, expected " in said
    assert "\n" not in said and "Traceback" not in said
    assert checkpoint.read_bytes() == before and not scene.exists()


def test_a_checkpoint_of_an_older_scene_format_is_resumed(tmp_path: Path, filmed: Path, own_cache: Path) -> None:
    """Written when scenes had format version 4, by code that knew this version of checkpoints already."""
    scene = put_down(tmp_path, 12)
    assert main(["train", str(filmed), "--out", str(scene), "--resume", "--steps", "44", "--device", "cpu"]) == 0
    header = read_scene(scene).header
    assert header.steps == 44 and header.recipe["embedding_size"] == 8  # as the training began
