"""USD out of Blender and in: by Blender's own USD library, and, from 5.3 on, played by Blender without the add-on."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import bpy
import mathutils
import numpy as np
import pytest
from support.builders import printed
from support.foreign_takes import HALF, assert_equal_within, assert_plays_alike

from frog_blender import point_cloud
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.transform import transform
from frog_blender.scene_import.capture_objects import active_capture

if not hasattr(bpy.utils, "expose_bundled_modules"):
    pytest.skip("this Blender does not lend its USD library", allow_module_level=True)
bpy.utils.expose_bundled_modules()
if find_spec("pxr") is None:
    pytest.skip("this Blender has no USD library for Python", allow_module_level=True)

draws_them = pytest.mark.skipif(not point_cloud.draws_splats(), reason="this Blender reads no splats from USD")
SCRIPT = Path(__file__).resolve().parents[1] / "support" / "stock_usd_import.py"


def test_out_and_in_again_plays_the_same(empty, capture, static_rig, tmp_path):
    """Where the root stands, in the frames of the timeline, with z up as it was."""
    turn = mathutils.Euler((0.2, -0.5, 1.1)).to_matrix().to_4x4()
    capture.parent.matrix_world = mathutils.Matrix.Translation((0.1, 0.2, 0.3)) @ turn @ mathutils.Matrix.Scale(1.5, 4)
    empty.frame_set(3)
    out = tmp_path / "out.usdc"
    options = {"frames": "CUSTOM", "first": 2, "last": 8, "full_precision": True}
    assert bpy.ops.export_scene.frog_usd(filepath=str(out), **options) == {"FINISHED"}
    assert empty.frame_current == 3 and out.is_file()
    placed = np.array(capture.matrix_world)
    assert bpy.ops.import_scene.frog_splats(filepath=str(out)) == {"FINISHED"}
    back = active_capture(bpy.context)
    assert back is not capture
    np.testing.assert_allclose(back.matrix_world, np.eye(4), atol=1e-6, err_msg="the world of the file")
    scene = ScenePlayer.load(static_rig)
    found = ScenePlayer.load(back.frog.filepath)
    assert_plays_alike(found, lambda frame: transform(scene.at_frame(frame + 1), placed), [0, 3, 6], 2e-5)
    shown = point_cloud.read(back)["position"].copy()
    empty.frame_set(5)
    assert np.abs(point_cloud.read(back)["position"] - shown).max() > 1e-2, "it plays on the timeline"


def stock_import(file: Path, frames: list[float], out: Path) -> tuple[dict[str, np.ndarray], str]:
    command = [sys.executable, str(SCRIPT), str(file), *map(str, frames), str(out)]
    said = printed(subprocess.run(command, capture_output=True, text=True, timeout=300, check=False))
    with np.load(out) as found:
        return {name: found[name] for name in found}, said


def stock_gaussians(found: dict[str, np.ndarray], prefix: str) -> GaussianArrays:
    """Of a cloud of Blender's own, in its object's space; its colours are Blender's attributes, which are ours."""
    base = found[f"{prefix}/radiance:base"]
    sh = np.stack([base[:, :3], *(found[f"{prefix}/radiance:sh_{k}"] for k in range(3))], axis=1)
    means, turns, scales = (found[f"{prefix}/{name}"] for name in ("position", "rotation", "scale"))
    return GaussianArrays(means, turns, scales, base[:, 3], sh)


@draws_them
@pytest.mark.parametrize("full", [False, True])
def test_blender_plays_it_without_the_addon(empty, capture, static_rig, tmp_path, full):
    """Every frame within the precision that was written, and half way between two of them the mean of both."""
    from dataclasses import replace

    from frog_blender.engine.scene.scene_file import read_scene, write_scene

    still = read_scene(static_rig)
    arrays = still.arrays | {"embeddings": still.arrays["embeddings"][:45]}  # the last 15 are static
    write_scene(tmp_path / "part.frog", replace(still, arrays=arrays))
    bpy.ops.import_scene.frog(filepath=str(tmp_path / "part.frog"))
    out = tmp_path / "part.usdc"
    empty.frame_start, empty.frame_end = 1, 10
    bpy.ops.export_scene.frog_usd(filepath=str(out), full_precision=full)
    frames = [*range(1, 11), 3.5]
    found, said = stock_import(out, frames, tmp_path / "found.npz")
    assert "{'GAUSSIAN_SPLAT'}" in said and "'cam00', 'cam01', 'cam02'" in said and said.rstrip().endswith("1 10")
    scene = ScenePlayer.load(tmp_path / "part.frog")
    relative = 1e-5 if full else HALF
    for frame in frames[:-1]:
        expected = scene.at_frame(frame - 1)
        for name, rows in (("Dynamic", slice(0, 45)), ("Static", slice(45, 60))):
            np.testing.assert_allclose(found[f"{frame}/{name}/place"], np.eye(4), atol=1e-6)
            stock = stock_gaussians(found, f"{frame}/{name}")
            assert_equal_within(stock, expected.part(rows), relative, 1e-5 if full else 2.0**-13)
    for name in ("position", "scale", "radiance:base"):
        before, after, between = (found[f"{frame}/Dynamic/{name}"] for frame in (3, 4, 3.5))
        np.testing.assert_allclose(between, (before + after) / 2, atol=2e-3 if not full else 1e-5, err_msg=name)
