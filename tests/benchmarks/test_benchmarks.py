"""The benchmarks run, on something tiny, and their records are honest."""

import json
import os
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
import torch
from support.builders import REPOSITORY, run_benchmark, run_python, scene_file

from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import write_scene

BENCHMARKS = REPOSITORY / "benchmarks"
KEYS = {
    *("scene", "backend", "threads", "isa", "forward_s", "backward_s", "peak_rss_mb", "pairs", "instances"),
    *("gaussians", "forward_gpairs_per_core", "backward_gpairs_per_core", "forward_share", "backward_share"),
}
MAKE_SCENE = """
import sys, pathlib, raster_scenes
raster_scenes.save(pathlib.Path(sys.argv[1]), raster_scenes.generate(raster_scenes.Recipe(300, 48, 32)))
"""


def run_beside_benchmarks(code: str, *arguments: object) -> None:
    done = run_python(code, *arguments, PYTHONPATH=f"{REPOSITORY}{os.pathsep}{BENCHMARKS}")
    assert done.returncode == 0, done.stderr


def make_scene(path: Path) -> Path:
    run_beside_benchmarks(MAKE_SCENE, path)
    return path


@pytest.fixture(scope="module")
def small_scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return make_scene(tmp_path_factory.mktemp("scenes") / "small.npz")


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
    done = run_benchmark(
        "rasterizer.py", "--scene", small_scene, "--backend", "cpu", "--threads", "1", "--isa", "baseline", "--json"
    )
    assert done.returncode == 0, done.stderr
    record = json.loads(done.stdout)
    assert record.keys() >= KEYS
    assert (record["scene"], record["backend"], record["threads"], record["isa"]) == ("small", "cpu", 1, "baseline")
    assert 0 < record["forward_min_s"] <= record["forward_s"] and 0 < record["backward_min_s"] <= record["backward_s"]
    assert 0 < record["gaussians"] <= 300 and record["pairs"] >= record["gaussians"]


def rehearse(out: Path, *arguments: object, **environment: str) -> tuple[int, dict, str]:
    """``gpu.py`` without a GPU: status, figures by part, and the report."""
    command = [sys.executable, str(BENCHMARKS / "gpu.py"), "--device", "cpu", "--out", str(out), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | environment, check=False)
    return done.returncode, json.loads((out / "gpu.json").read_text()), (out / "gpu.md").read_text()


def test_the_gpu_check_can_be_rehearsed(tmp_path: Path) -> None:
    status, parts, report = rehearse(tmp_path)
    assert status == 0, report
    assert list(parts) == ["machine", "rasterizer tests", "rasterizer", "training step", "draft training"]
    assert not any("failed" in part for part in parts.values())
    assert parts["rasterizer"]["runs"][0]["forward_s"] > 0
    assert [run["images"] for run in parts["training step"]["runs"]] == ["regions", "whole"]
    assert all(run["median_ms"] > 0 for run in parts["training step"]["runs"])
    assert "capture" in parts["draft training"]["left out"]
    assert all(f"## {name}" in report for name in parts)


@pytest.mark.slow
def test_a_part_of_the_gpu_check_that_fails_does_not_stop_the_others(tmp_path: Path) -> None:
    status, parts, report = rehearse(tmp_path, FROG_NATIVE_LIBRARY=str(tmp_path / "nowhere.so"))
    assert status == 1
    assert parts["machine"]["native library"].startswith("none")
    assert "nowhere.so" in parts["rasterizer"]["failed"] and "nowhere.so" in parts["training step"]["failed"]
    assert "native library" in parts["rasterizer tests"]["left out"] and "failed" not in parts["rasterizer tests"]
    assert len(parts) == 5 and "nowhere.so" in report


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_the_gpu_check_without_a_gpu_says_so_and_stops(tmp_path: Path) -> None:
    command = [sys.executable, str(BENCHMARKS / "gpu.py"), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert list(json.loads((tmp_path / "gpu.json").read_text())) == ["machine"]
    assert "torch sees no CUDA device" in done.stdout


def records_of(name: str, *arguments: object) -> list[dict]:
    done = run_benchmark(name, *arguments)
    assert done.returncode == 0, done.stderr
    return [json.loads(line) for line in done.stdout.splitlines()]


def test_deformation_of_all_networks_and_paths() -> None:
    records = records_of("deformation.py", "--counts", 300, "--threads", 1, "--repeats", 1, "--cold")
    paths = ("training, forward", "training, forward and backward", "inference")
    networks = ("shared 64", "shared 64, modulated", "five heads of 128")
    expected = {(name, count, path) for name in networks for count in (1, 2) for path in paths}
    assert {(record["network"], record["networks"], record["path"]) for record in records} == expected
    for record in records:
        assert record["seconds"] >= record["best"] > 0 and record["memory_bound"] > 0 and record["gflop"] > 0


def test_playback_of_each_scene(tmp_path: Path) -> None:
    write_scene(tmp_path / "all.frog", scene_file(200))
    write_scene(tmp_path / "some.frog", scene_file(200, moving=30, hidden_width=16))
    first, second = records_of("playback.py", tmp_path / "all.frog", tmp_path / "some.frog", "--repeats", 3)
    assert (first["scene"], first["gaussians"], first["moving"], first["units"]) == ("all.frog", 200, 200, 24)
    assert (second["scene"], second["gaussians"], second["moving"], second["units"]) == ("some.frog", 200, 30, 16)
    assert first["first over this"] == 1.0 and first["milliseconds"] > 0 and second["first over this"] > 0


def test_a_budget_keeps_the_most_opaque(tmp_path: Path) -> None:
    scene = scene_file(200, moving=120)
    write_scene(tmp_path / "whole.frog", scene)
    records_of("budget.py", tmp_path / "whole.frog", tmp_path / "cut.frog", "--budget", 50)
    whole, cut = (ScenePlayer.load(tmp_path / name) for name in ("whole.frog", "cut.frog"))
    kept = np.sort(np.argsort(-scene.arrays["opacity_logits"], kind="stable")[:50])
    assert cut.count == 50 and cut.num_dynamic == int((kept < 120).sum())
    np.testing.assert_allclose(cut.at(0.3).means, whole.at(0.3).means[kept], rtol=1e-5, atol=1e-6)


def test_a_rig_is_found_by_the_points_that_it_would_see(tmp_path: Path) -> None:
    pytest.importorskip("pycolmap")
    done = run_benchmark("calibration.py", tmp_path, "--only", "^3 cameras, 12")
    assert done.returncode == 0, done.stderr
    (record,) = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert (record["rig"], record["cameras"], record["points"]) == ("3 cameras, 12 degrees apart", 3, 1500)
    assert record["centers"] < 0.5 and record["rotations"] < 0.2 and abs(record["focals"]) < 1 and record["k1"] == 0
