"""Scenes of segments in other programs' formats: every frame is what its segment shows."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from support import segmented

from frog_blender.cli.main import main
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.scene_file import write_scene


@pytest.mark.parametrize("ending", ["usdc", "ply"])
def test_out_and_in_again(tmp_path: Path, ending: str) -> None:
    pytest.importorskip({"usdc": "pxr", "ply": "numpy"}[ending])
    path, back = tmp_path / "joined.frog", tmp_path / "back.frog"
    write_scene(path, segmented.joined())
    kind = {"usdc": ["--usd", "--float"], "ply": ["--frames", "3:8"]}[ending]
    out = tmp_path / ("frames" if ending == "ply" else f"take.{ending}")
    assert main(["export", str(path), "--out", str(out), *kind]) == 0
    assert main(["import", str(out), "--out", str(back)]) == 0
    one, other = ScenePlayer.load(path), ScenePlayer.load(back)
    camera, first = one.header.cameras[1], 3 if ending == "ply" else 0
    for frame in (3, 4, 5, 7):
        images = [draw(each, camera).rgb for each in (one.at_frame(frame), other.at_frame(frame - first))]
        assert images[0].any() and np.abs(images[0] - images[1]).max() < 0.03, frame


@pytest.mark.parametrize("kind", ["--html", "--spz", "--glb"])
def test_out(tmp_path: Path, kind: str) -> None:
    path, out = tmp_path / "joined.frog", tmp_path / ("page.html" if kind == "--html" else "frames")
    write_scene(path, segmented.joined())
    assert main(["export", str(path), "--out", str(out), kind]) == 0
    assert out.stat().st_size > 0
