"""The budget benchmark: the scene that it cuts down by opacity is one that plays."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from support.builders import REPOSITORY, run_python, scene_file

from frog_blender.engine.playback.groups import pack_group_bits
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import VISIBILITY, SceneFile, write_scene

CUT = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(REPOSITORY / "benchmarks")!r})
import budget
budget.without_transparent(Path(sys.argv[1]), Path(sys.argv[2]), 50)
"""


def test_the_most_opaque_stay(tmp_path: Path) -> None:
    """Also of a scene whose groups have lifetimes."""
    scene = scene_file(200, moving=120)
    lives = pack_group_bits(np.ones((scene.header.frame_count - 1, 120), bool))
    write_scene(tmp_path / "whole.frog", SceneFile(scene.header, scene.arrays | {VISIBILITY: lives}))
    done = run_python(CUT, tmp_path / "whole.frog", tmp_path / "cut.frog")
    assert done.returncode == 0, done.stderr
    whole, cut = (ScenePlayer.load(tmp_path / name) for name in ("whole.frog", "cut.frog"))
    kept = np.sort(np.argsort(-scene.arrays["opacity_logits"], kind="stable")[:50])
    assert cut.count == 50 and cut.num_dynamic == int((kept < 120).sum())
    np.testing.assert_allclose(cut.at(0.3).means, whole.at(0.3).means[kept], rtol=1e-5, atol=1e-6)
