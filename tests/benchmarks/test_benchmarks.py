"""The benchmarks run, on something tiny, and their records are honest."""

import argparse
import importlib
import json
import os
import subprocess
import sys
import time
from importlib.machinery import SourceFileLoader
from importlib.util import module_from_spec, spec_from_loader
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
import torch
from support import synthetic_capture
from support.builders import REPOSITORY, printed, run_benchmark, run_python, scene_file

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


def make_scene(path: Path) -> Path:
    printed(run_python(MAKE_SCENE, path, PYTHONPATH=f"{REPOSITORY}{os.pathsep}{BENCHMARKS}"))
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
    options = ("--backend", "cpu", "--threads", "1", "--isa", "baseline", "--json")
    record = json.loads(run_benchmark("rasterizer.py", "--scene", small_scene, *options))
    assert record.keys() >= KEYS
    assert (record["scene"], record["backend"], record["threads"], record["isa"]) == ("small", "cpu", 1, "baseline")
    assert 0 < record["forward_min_s"] <= record["forward_s"] and 0 < record["backward_min_s"] <= record["backward_s"]
    assert 0 < record["gaussians"] <= 300 and record["pairs"] >= record["gaussians"]


def rehearse(out: Path, *arguments: object, **environment: str) -> tuple[int, dict, str]:
    """``gpu.py`` without a GPU: status, what it found, and the report."""
    command = [sys.executable, str(BENCHMARKS / "gpu.py"), "--device", "cpu", "--out", str(out), *map(str, arguments)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | environment, check=False)
    return done.returncode, json.loads((out / "gpu.json").read_text()), (out / "gpu.md").read_text()


def test_the_gpu_check_can_be_rehearsed(tmp_path: Path) -> None:
    status, found, report = rehearse(tmp_path / "out", "--capture", synthetic_capture.write_capture(tmp_path))
    parts = found["parts"]
    assert status == 0, report
    assert len(parts) == 10 and not any("failed" in part for part in parts.values()), report
    assert parts["rasterizer"]["runs"][0]["forward_s"] > 0
    assert {(run["images"], run["way"]) for run in parts["steps"]["runs"]} == {
        (images, way) for images in ("regions", "whole") for way in ("ours", "before")
    }
    assert all(row["before"] > 0 for row in parts["steps"]["ratios"])
    draft = parts["draft"]
    assert draft["steps"] == 3 and draft["psnr"] > 5
    assert sum(phase["s"] for phase in draft["runs"]) == pytest.approx(draft["total_s"], abs=0.1)
    assert parts["take"]["steps"] > 0 and parts["cpu and gpu"]["cpu_psnr"] > 5
    assert "was not found" in parts["memory check"]["left out"] or "no GPU" in parts["memory check"]["left out"]
    assert "not measured" in report and all(f"## {name}" in report for name in parts)


@pytest.mark.slow
def test_a_part_of_the_gpu_check_that_fails_does_not_stop_the_others(tmp_path: Path) -> None:
    nowhere = str(tmp_path / "nowhere.so")
    status, found, report = rehearse(tmp_path, "--only", "gpu tests", "steps", "take", FROG_NATIVE_LIBRARY=nowhere)
    parts = found["parts"]
    assert status == 1 and "nowhere.so" in report and len(parts) == 5
    assert "nowhere.so" in parts["native library"]["left out"]
    assert "nowhere.so" in parts["steps"]["failed"] and "nowhere.so" in parts["take"]["failed"]
    assert "native library" in parts["gpu tests"]["left out"] and "failed" not in parts["gpu tests"]


@pytest.mark.skipif(torch.cuda.is_available(), reason="there is a GPU")
def test_the_gpu_check_without_a_gpu_says_so_and_stops(tmp_path: Path) -> None:
    command = [sys.executable, str(BENCHMARKS / "gpu.py"), "--out", str(tmp_path)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert list(json.loads((tmp_path / "gpu.json").read_text())["parts"]) == ["machine"]
    assert "torch sees no CUDA device" in done.stdout


@pytest.fixture
def gpu_check(monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """``gpu.py`` by another name: Blender has a module ``gpu``."""
    loader = SourceFileLoader("gpu_check", str(BENCHMARKS / "gpu.py"))
    module = module_from_spec(spec_from_loader(loader.name, loader))
    monkeypatch.setitem(sys.modules, loader.name, module)  # where dataclasses look
    loader.exec_module(module)
    return module


def test_the_gpu_check_keeps_to_its_time(tmp_path: Path, gpu_check: ModuleType) -> None:
    """No part begins when the time is over; a process that runs into its end is ended, and what it said counts."""
    _, found, _ = rehearse(tmp_path, "--seconds", 1)
    assert all("seconds were over" in part["left out"] for part in found["parts"].values())
    check = gpu_check.Check(argparse.Namespace(out=tmp_path, capture=None, device="cpu", build=False), tmp_path)
    check.deadline = time.monotonic() + 3
    run = check.run_python("-c", "import time; print('{\"a\": 1}', flush=True); time.sleep(60)")
    assert run.records == [{"a": 1}] and run.failed == "its time was over"


def test_what_the_gpu_check_asks_for(gpu_check: ModuleType) -> None:
    times = [("cuda", 1.0, 2.0, 200), ("gsplat", 1.6, 2.8, 100)]
    keys = ("backend", "forward_s", "backward_s", "peak_device_mb")
    runs = [{"scene": "100k_b"} | dict(zip(keys, one, strict=True)) for one in times]
    divided = {"forward": "forward_s", "backward": "backward_s"}
    (ratios,) = gpu_check.ratios(runs, ("scene",), "backend", divided)
    seeds = [{"device": device, "seed": 0, "psnr": psnr} for device, psnr in (("cuda", 28.0), ("cpu", 28.5))]
    results = {
        "gpu tests": {"passed": 3, "not passed": 0},
        "rasterizer": {"ratios": [ratios]},
        "cpu and gpu": gpu_check.compared(seeds),
    }
    rows = {row["what"]: (row["found"], row["met"]) for row in gpu_check.asked_and_found(results)}
    assert rows["GPU tests that fail or do not end"] == ("0", "yes")
    assert rows["gsplat's forward over ours, 100k_b"] == ("1.6", "yes")
    assert rows["gsplat's backward over ours, 100k_b"] == ("1.4", "NO")
    assert rows["GPU's quality less the CPU's"] == ("-0.5 dB", "NO")
    assert rows["draft of the capture, whole"] == ("not measured", "")


def test_the_profile_of_a_step_counts_launches_and_waits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two steps: of three waits one is over before the GPU's work is, one idles it, and one is not of the steps."""
    monkeypatch.syspath_prepend(BENCHMARKS)
    gpu_profile = importlib.import_module("gpu_profile")
    spans = [
        *[("kernel", "blend", 0, 50), ("kernel", "adam", 45, 55), ("gpu_memcpy", "copy", 100, 10)],
        *[("user_annotation", gpu_profile.STEPS, 0, 200), ("cuda_runtime", "cudaLaunchKernel", 0, 2)],
        *[("cuda_runtime", "cudaEventSynchronize", 5, 20), ("cuda_runtime", "cudaStreamSynchronize", 90, 50)],
        *[("kernel", "blend", 160, 20), ("cuda_runtime", "cudaDeviceSynchronize", 220, 10)],
    ]
    events = [{"ph": "X", "cat": c, "name": n, "ts": start, "dur": spent} for c, n, start, spent in spans]
    found = gpu_profile.summary([*events, {"ph": "M", "name": "process_name"}], steps=2, most_kernels=1)
    assert (found["kernels"], found["copies"], found["device_us"]) == (1.5, 0.5, (110 + 20) / 2)
    assert (found["waits"], found["waits_that_idle"], found["idle_after_waits_us"]) == (1, 0.5, 25)
    assert found["kernels_by_name"] == [{"kernel": "blend", "a_step": 1.0, "us": 35.0}]


def records_of(name: str, *arguments: object) -> list[dict]:
    return [json.loads(line) for line in run_benchmark(name, *arguments).splitlines()]


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
    run_benchmark("calibration.py", tmp_path, "--only", "^3 cameras, 12")
    (record,) = [json.loads(line) for line in (tmp_path / "results.jsonl").read_text().splitlines()]
    assert (record["rig"], record["cameras"], record["points"]) == ("3 cameras, 12 degrees apart", 3, 1500)
    assert record["centers"] < 0.5 and record["rotations"] < 0.2 and abs(record["focals"]) < 1 and record["k1"] == 0
