"""File > Export > FRoG as Web Page: the frames of the timeline as the capture plays there."""

from __future__ import annotations

import json
import re

import bpy
import pytest

from frog_blender.scene_import.capture_objects import active_capture


@pytest.fixture
def capture(empty, static_rig):
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    return active_capture(bpy.context)


def test_the_timelines_frames_at_its_rate(empty, capture, tmp_path):
    empty.frame_set(3)
    out = tmp_path / "out.html"
    options = {"frames": "CUSTOM", "first": 2, "last": 6}
    assert bpy.ops.export_scene.frog_web_page(filepath=str(out), **options) == {"FINISHED"}
    assert empty.frame_current == 3 and [path.name for path in tmp_path.glob("*.html")] == ["out.html"]
    (found,) = re.findall(r'id="description">(.*?)</script>', out.read_text(encoding="utf-8"))
    description = json.loads(found)
    assert description["frames"] == 5 and description["dynamic"] > 0
    assert description["frames_per_second"] == empty.render.fps / empty.render.fps_base


def test_a_still(empty, capture, tmp_path):
    assert bpy.ops.export_scene.frog_web_page(filepath=str(tmp_path / "x.html"), frames="CURRENT") == {"FINISHED"}
    assert '"frames": 1' in (tmp_path / "x.html").read_text(encoding="utf-8")


def test_another_ending_is_refused(empty, capture, tmp_path):
    with pytest.raises(RuntimeError, match=r"found the ending '\.txt', expected \.html"):
        bpy.ops.export_scene.frog_web_page(filepath=str(tmp_path / "x.txt"))
    assert not list(tmp_path.glob("*.txt"))
