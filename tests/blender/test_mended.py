"""An error that a panel shows goes when its cause does, without anybody pressing a button."""

import os

import bpy
import pytest
from support.small_scenes import shows
from support.training_panel import panel_says

from frog_blender.ui import capture_panel, capture_summary, captures_panel, refreshing, render_panel


@pytest.fixture
def said(empty):
    """A function that draws a panel, does what Blender does when it is drawn, and gives what it says."""

    def draw(panel):
        lines = panel_says(panel, object=None) or ""
        if bpy.app.timers.is_registered(refreshing.tick):
            bpy.app.timers.unregister(refreshing.tick)
            refreshing.tick()  # no timer runs without a window
        return lines

    return draw


def test_a_scene_file_that_is_there_again(empty, capture, static_rig, said, tmp_path):
    content = static_rig.read_bytes()
    for damage in (b"nonsense", None):
        static_rig.write_bytes(damage) if damage else static_rig.unlink()
        empty.frame_set(empty.frame_current + 1)
        assert static_rig.name in said(captures_panel.FROG_PT_captures)
        static_rig.write_bytes(content)
        said(captures_panel.FROG_PT_captures)  # which sees that the file is another one
        assert "60 Gaussians" in said(captures_panel.FROG_PT_captures)
        shows(capture, static_rig, empty.frame_current - 1.0)


def test_what_holds_points_still_is_said_for_other_engines(empty, capture, said):
    for engine, locked, expected in (("FROG", False, False), ("CYCLES", True, False), ("CYCLES", False, True)):
        empty.render.engine, empty.render.use_lock_interface = engine, locked
        assert ("unless Lock Interface is on" in said(render_panel.FROG_PT_render)) == expected


def test_a_calibration_that_is_mended(empty, said, tmp_path):
    pytest.importorskip("cv2")
    folder = pytest.importorskip("support.synthetic_capture").write_capture(tmp_path / "capture")
    poses = folder / "poses_bounds.npy"
    content = poses.read_bytes()
    poses.write_bytes(b"no numbers")
    empty.frog.capture_folder = str(folder)
    panel = capture_panel.FROG_PT_capture
    assert "poses_bounds.npy" in said(panel) and capture_summary.known(str(folder)).error
    poses.write_bytes(content)
    said(panel)
    assert "4 cameras" in said(panel)
    os.utime(poses, (1, 1))
    assert not capture_summary.is_outdated(str(folder)), "what can be used is not looked at again at every redraw"
