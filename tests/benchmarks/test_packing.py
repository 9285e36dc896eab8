"""The packing benchmark: far Gaussians ruin images in their blocks, and do no harm where they stand apart."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

from support.builders import run_benchmark, scene_file

from frog_blender.engine.scene.scene_file import write_scene


def test_a_record_for_each_share(tmp_path: Path) -> None:
    write_scene(tmp_path / "x.frog", scene_file(600, moving=300))
    done = run_benchmark("packing.py", tmp_path / "x.frog", "--shares", 0, 0.02, "--seeds", 2)
    assert done.returncode == 0, done.stderr
    none, some = (json.loads(line) for line in done.stdout.splitlines())
    assert (none["scene"], none["share"], some["share"]) == ("x.frog", 0, 0.02)
    assert none["apart kB"] == none["together kB"] and none["apart PSNR"] == none["together PSNR"] > 30
    assert some["apart PSNR"] > some["together PSNR"] + 5 and some["apart % off"] < some["together % off"]


def test_a_scene_without_cameras_is_refused(tmp_path: Path) -> None:
    scene = scene_file(20)
    write_scene(tmp_path / "x.frog", replace(scene, header=replace(scene.header, cameras=(), camera_shots=())))
    done = run_benchmark("packing.py", tmp_path / "x.frog")
    assert done.returncode == 2 and "expected a scene with cameras" in done.stderr
