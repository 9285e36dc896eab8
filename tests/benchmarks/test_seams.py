"""The benchmark of seams finds one that was made."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from support import segmented
from support import synthetic_capture as film
from support.builders import run_benchmark

from frog_blender.engine.arrays import SceneArrays
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.scene.header import SceneHeader
from frog_blender.engine.scene.joined import TrainedSegment, join
from frog_blender.engine.scene.scene_file import SceneFile, write_scene


def still_segment(header: SceneHeader, arrays: SceneArrays, first: int, brightness: float) -> TrainedSegment:
    own = {name: array.astype(np.float32) for name, array in arrays.items()}
    own["sh"] = own["sh"] + np.float32(brightness)
    return TrainedSegment(first, 10, first, SceneFile(replace(header, model={}, frame_count=10), own))


def test_a_seam_shows_in_the_figures(tmp_path: Path) -> None:
    folder = film.write_capture(tmp_path / "film", [0] * 20)
    capture, drawn = open_capture(folder), film.gaussians_at(0)
    arrays = {"means": drawn.means, "log_scales": np.log(drawn.scales), "quaternions": drawn.quaternions}
    arrays |= {"opacity_logits": np.log(drawn.opacities / (1 - drawn.opacities)), "sh": drawn.sh}
    header = replace(segmented.joined().header, frame_count=20, cameras=capture.cameras, background=(0.0, 0.0, 0.0))
    header = replace(header, camera_shots=(tuple(range(20)),) * 4)
    parts = [still_segment(header, arrays, first, bright) for first, bright in ((0, 0.0), (10, 0.3))]
    write_scene(tmp_path / "x.frog", join(header, {}, parts))
    picture = tmp_path / "strip.png"
    done = run_benchmark("seams.py", tmp_path / "x.frog", folder, "--every", 3, "--strip", picture)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found["seams"] == [10]
    before, after = found["psnr before and after"][1:3]
    assert before > after + 5
    name = "where nothing moves"
    assert found["change at seams"][name] > 10 > 1 > found["change elsewhere"][name]
    assert cv2.imread(str(picture)).shape == (2 * film.HEIGHT, 5 * film.WIDTH, 3)
