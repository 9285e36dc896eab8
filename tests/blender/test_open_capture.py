"""Dropped videos and chosen folders become the capture to train from, or one sentence."""

from __future__ import annotations

import bpy
import pytest

from frog_blender.ui import capture_summary


@pytest.fixture
def capture(tmp_path):
    pytest.importorskip("cv2")
    return pytest.importorskip("support.synthetic_capture").write_capture(tmp_path / "capture")


def drop(folder, *names):
    return bpy.ops.frog.drop_videos(directory=f"{folder}/", files=[{"name": name} for name in names])


def test_dropped_videos_name_their_capture(empty, capture):
    assert drop(capture, "cam01.mp4", "cam02.mp4") == {"FINISHED"}
    assert empty.frog.capture_folder == str(capture) and empty.frog.output_path == f"{capture}.frog"
    summary = capture_summary.known(empty.frog.capture_folder)
    assert summary.capture is not None and len(summary.cameras) == 4


def test_videos_of_several_folders(empty, capture):
    from frog_blender.engine.errors import FrogError
    from frog_blender.operators.open_capture import capture_of

    with pytest.raises(FrogError, match="Found videos in 2 folders"):
        capture_of([capture / "cam00.mp4", capture.parent / "cam01.mp4"])


def test_dropped_raw_videos_are_chosen_to_be_calibrated(empty, capture):
    (capture / "poses_bounds.npy").unlink()
    assert drop(capture, "cam01.mp4", "cam02.mp4") == {"FINISHED"}
    assert empty.frog.capture_folder == str(capture) and empty.frog.output_path == f"{capture}.frog"
    summary = capture_summary.known(str(capture))
    assert summary.raw_footage == "4 videos" and summary.capture is None and not summary.error
    assert "4 videos without a calibration" in " ".join(summary.lines)


def test_a_calibration_that_does_not_fit_says_so(empty, capture):
    (capture / "poses_bounds.npy").write_bytes(b"no numbers")
    with pytest.raises(RuntimeError, match=r"poses_bounds\.npy"):
        drop(capture, "cam01.mp4")
    assert not empty.frog.capture_folder


def test_no_videos_at_all(empty, tmp_path):
    with pytest.raises(RuntimeError, match="Found no video"):
        drop(tmp_path)


def test_a_folder_from_the_import_menu(empty, capture, tmp_path):
    assert bpy.ops.import_scene.frog_capture(directory=f"{capture}/") == {"FINISHED"}
    assert empty.frog.capture_folder.rstrip("/") == str(capture)
    assert capture_summary.known(bpy.path.abspath(empty.frog.capture_folder)).capture is not None
    with pytest.raises(RuntimeError, match="nowhere"):
        bpy.ops.import_scene.frog_capture(directory=str(tmp_path / "nowhere"))
    assert empty.frog.capture_folder.rstrip("/") == str(capture)
