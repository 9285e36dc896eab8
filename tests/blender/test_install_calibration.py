"""What calibration needs by its own buttons: packages, and the landmark file; whole or not at all."""

from __future__ import annotations

import sys

import bpy
from support.training_panel import finish

from frog_blender.tasks.installation import Installation, LandmarkDownload
from frog_blender.tasks.package_folders import installed
from frog_blender.tasks.packages import (
    CALIBRATION_PACKAGES,
    CPU,
    CUDA,
    has_pycolmap_wheel,
    index_needed,
    suitable_build,
)


def test_what_calibration_needs_is_installed_by_itself(tmp_path):
    """By what stands in for pip and brings what it is asked for."""
    code = """
import pathlib, sys
asked = [word for word in sys.argv if word.startswith(("pycolmap", "torch"))]
for name in asked:
    package = pathlib.Path(sys.argv[sys.argv.index("--target") + 1]) / name.split("=")[0]
    package.mkdir()
    (package / "__init__.py").touch()
"""
    folder, pip = tmp_path / "data" / "calibration", [sys.executable, "-c", code]
    done = finish(Installation(folder, packages=CALIBRATION_PACKAGES, pip=pip).start())
    assert done.result and not done.error and installed(folder) == folder
    assert (folder / "pycolmap" / "__init__.py").is_file() and not (folder / "torch").exists()
    again = finish(Installation(folder, packages=CALIBRATION_PACKAGES, pip=pip).start())
    assert installed(folder) == again.result == folder.with_name("calibration-2") and not folder.exists()


def test_pycolmap_that_did_not_come_is_named(tmp_path):
    silent = [sys.executable, "-c", "print('all is well')"]
    failed = finish(Installation(tmp_path / "data" / "calibration", pip=silent).start())
    assert failed.error == "pycolmap could not be installed: pip brought none (all is well)."


def test_computers_without_a_wheel_are_known():
    there = [("linux", "x86_64"), ("win32", "AMD64"), ("darwin", "arm64")]
    missing = [("linux", "aarch64"), ("darwin", "x86_64"), ("win32", "ARM64")]
    assert all(has_pycolmap_wheel(*computer) for computer in there)
    assert not any(has_pycolmap_wheel(*computer) for computer in missing)


def test_the_build_of_torch_that_suits_the_computer_is_named():
    assert suitable_build("linux", False) == suitable_build("win32", False) == suitable_build("darwin", True) == CPU
    assert suitable_build("linux", True) == suitable_build("win32", True) == CUDA
    assert "for the CPU comes from PyTorch's own" in index_needed(CPU, "linux") and index_needed(CUDA, "linux") == ""
    assert "with CUDA comes from PyTorch's own" in index_needed(CUDA, "win32") and index_needed(CPU, "win32") == ""
    assert index_needed(CPU, "darwin") == ""


def test_the_landmark_file_is_taken_out_of_what_pip_brings_or_nothing_is(tmp_path):
    """The real file is not at hand; another one in its place is refused, and nothing stays."""
    code = """
import sys, zipfile
folder = sys.argv[sys.argv.index("--dest") + 1]
with zipfile.ZipFile(f"{folder}/mediapipe-0.10.21-cp311-cp311-manylinux_2_28_x86_64.whl", "w") as wheel:
    wheel.writestr("mediapipe/modules/pose_landmark/pose_landmark_full.tflite", "something else")
print("Saved", folder)
"""
    download = LandmarkDownload(pip=[sys.executable, "-c", code], cache=tmp_path / "cache").start()
    failed = finish(download)
    assert failed.result is None and "checksum" in failed.error and failed.progress.stage.startswith("Saved")
    assert not list(tmp_path.rglob("*.tflite"))
    silent = LandmarkDownload(
        pip=[sys.executable, "-c", "print('ERROR: no such thing'); raise SystemExit(1)"], cache=tmp_path
    )
    assert finish(silent.start()).error == "The landmark file could not be fetched: no such thing"


def test_nothing_is_downloaded_without_online_access(empty):
    system = bpy.context.preferences.system
    allowed = system.use_online_access
    try:
        system.use_online_access = False
        for operator in (bpy.ops.frog.install_torch, bpy.ops.frog.install_calibration, bpy.ops.frog.fetch_landmarks):
            assert not operator.poll()
    finally:
        system.use_online_access = allowed
