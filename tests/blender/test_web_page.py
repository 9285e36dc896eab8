"""File > Export > FRoG as Web Page: the frames of the timeline as the capture plays there."""

from __future__ import annotations

import json
import re

import bpy
import pytest


def described(path):
    (found,) = re.findall(r'id="description">(.*?)</script>', path.read_text(encoding="utf-8"))
    return json.loads(found)


def test_the_timelines_frames_at_its_rate(empty, capture, tmp_path):
    empty.frame_set(3)
    out = tmp_path / "out.html"
    options = {"frames": "CUSTOM", "first": 2, "last": 6}
    assert bpy.ops.export_scene.frog_web_page(filepath=str(out), **options) == {"FINISHED"}
    assert empty.frame_current == 3 and [path.name for path in tmp_path.glob("*.html")] == ["out.html"]
    description = described(out)
    assert description["frames"] == 5 and description["dynamic"] > 0
    assert description["frames_per_second"] == empty.render.fps / empty.render.fps_base


def test_edits_are_exported_and_animated_ones_at_every_frame(empty, capture, tmp_path):
    out, options = tmp_path / "out.html", {"frames": "CUSTOM", "first": 1, "last": 3}
    bpy.ops.export_scene.frog_web_page(filepath=str(out), **options)
    whole = described(out)
    bpy.ops.frog.select_gaussians(by="OPACITY", opacity=0.6)
    bpy.ops.frog.hide_gaussians()
    bpy.ops.export_scene.frog_web_page(filepath=str(out), **options)
    left = described(out)
    assert 0 < left["count"] < whole["count"] and left["dynamic"] <= whole["dynamic"]
    grade = capture.frog_edits.grade
    for frame, exposure in ((1, 0.0), (3, 1.0)):
        grade.exposure = exposure
        grade.keyframe_insert("exposure", frame=frame)
    bpy.ops.export_scene.frog_web_page(filepath=str(out), **options)
    graded = described(out)
    assert graded["dynamic"] == graded["count"] == left["count"]  # light changes what rests as well


def test_a_still(empty, capture, tmp_path):
    assert bpy.ops.export_scene.frog_web_page(filepath=str(tmp_path / "x.html"), frames="CURRENT") == {"FINISHED"}
    assert '"frames": 1' in (tmp_path / "x.html").read_text(encoding="utf-8")


def test_another_ending_is_refused(empty, capture, tmp_path):
    with pytest.raises(RuntimeError, match=r"found the ending '\.txt', expected \.html"):
        bpy.ops.export_scene.frog_web_page(filepath=str(tmp_path / "x.txt"))
    assert not list(tmp_path.glob("*.txt"))
