"""The rasterizer benchmark: scenes that are the same every time, honest records, one sentence for each mistake."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from helpers import REPOSITORY, run_python

BENCHMARKS = REPOSITORY / "benchmarks"
KEYS = {
    *("scene", "backend", "threads", "isa", "forward_s", "backward_s", "peak_rss_mb", "pairs", "instances"),
    *("gaussians", "forward_gpairs_per_core", "backward_gpairs_per_core", "forward_share", "backward_share"),
}
MAKE_SCENE = f"""
import sys
from pathlib import Path
sys.path.insert(0, {str(BENCHMARKS)!r})
import raster_scenes
raster_scenes.save(Path(sys.argv[1]), raster_scenes.generate(raster_scenes.Recipe(300, 48, 32)))
"""


def make_scene(path: Path) -> Path:
    done = run_python(MAKE_SCENE, path)
    assert done.returncode == 0, done.stderr
    return path


@pytest.fixture(scope="module")
def small_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_scene(tmp_path_factory.mktemp("scenes") / "small.npz")


def benchmark(*arguments: object) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, str(BENCHMARKS / "rasterizer.py"), *map(str, arguments)]
    return subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)


def test_a_generated_scene_is_the_same_every_time_and_can_be_drawn(small_scene: Path, tmp_path: Path) -> None:
    with np.load(small_scene) as first, np.load(make_scene(tmp_path / "again.npz")) as second:
        assert set(first.files) == set(second.files)
        for name in first.files:
            np.testing.assert_array_equal(first[name], second[name], err_msg=name)
        assert first["means"].shape == (300, 3) and first["means"].dtype == np.float32
        assert first["v_out"].shape == (32, 48, 3) and first["v_alpha"].shape == (32, 48)
        assert (first["scales"] > 0).all() and (first["opac"] > 0).all() and (first["opac"] < 1).all()
        np.testing.assert_allclose(np.linalg.norm(first["quats"], axis=1), 1, rtol=1e-5)
        depths = first["means"] @ first["view"][2, :3] + first["view"][2, 3]
        assert depths.min() > 0.3


def test_one_run_is_one_json_object(small_scene: Path) -> None:
    done = benchmark("--scene", small_scene, "--backend", "cpu", "--threads", "1", "--isa", "baseline", "--json")
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert record.keys() >= KEYS
    assert (record["scene"], record["backend"], record["threads"], record["isa"]) == ("small", "cpu", 1, "baseline")
    assert 0 < record["forward_min_s"] <= record["forward_s"] and 0 < record["backward_min_s"] <= record["backward_s"]
    assert 0 < record["gaussians"] <= 300 and record["pairs"] >= record["gaussians"]


def test_a_file_that_is_no_scene_is_refused_in_one_sentence(tmp_path: Path) -> None:
    foreign, incomplete = tmp_path / "foreign.npz", tmp_path / "incomplete.npz"
    foreign.write_bytes(b"no archive")
    np.savez(incomplete, means=np.zeros((1, 3)))
    for path in (foreign, incomplete, tmp_path / "missing.npz", tmp_path / "scene.ply"):
        done = benchmark("--scene", path, "--json")
        assert done.returncode == 1 and done.stdout == ""
        assert done.stderr.startswith(f"{path}: found ") and done.stderr.count("\n") == 1
        assert done.stderr.endswith(".\n")
