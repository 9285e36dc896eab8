"""The sound of a capture in Blender: a strip, in time with it whatever its timing, heard by a mixdown."""

import re
import time
import wave
from base64 import b64decode
from contextlib import suppress
from importlib.util import find_spec

import bpy
import numpy as np
import pytest
from support.builders import refuses
from support.clicks import film_of_clicks, samples_of, times_of_clicks
from support.composed_scene import the_capture
from support.small_scenes import animate, imported, rig_of_three, write_scene

from frog_blender.engine.capture.media import read_sound_file
from frog_blender.engine.source_media.sound import Samples
from frog_blender.scene_import import capture_sound
from frog_blender.scene_import.capture_objects import active_capture
from frog_blender.timeline.frame_timing import frames_shown

COUNT, RATE = 48, 24
CLICKS = (3, 7, 11, 14, 20, 24, 27, 33, 38, 44)  # frames of the capture


@pytest.fixture
def capture(empty, tmp_path):
    folder = tmp_path / "films"
    folder.mkdir()
    film_of_clicks(folder / "cam00.mp4", [frame / RATE for frame in CLICKS], COUNT / RATE, RATE)
    filmed = {"capture_path": str(folder), "frames_per_second": float(RATE)}
    path = write_scene(tmp_path / "x.frog", rig_of_three(), frame_count=COUNT, **filmed)
    capture = imported(path, set_up_scene=True)
    empty.frame_start, empty.frame_end = 1, 130
    return capture


def by_a_curve(obj):
    """Slow, fast, frozen, backward: bezier curves."""
    obj.frog.use_remap = True
    animate(obj.frog, "shown_frame", (1, 0.0), (40, 12.0), (60, 36.0), (75, 36.0), (126, 1.0))


def slowly(obj):
    obj.frog.speed = 0.5


def backward(obj):
    obj.frog.speed, obj.frog.start_frame = -0.75, 90.0


def cut(obj):
    obj.frog.use_trim, obj.frog.first_frame, obj.frog.last_frame, obj.frog.repeat = True, 8, 39, "LOOP"
    obj.frog.use_range, obj.frog.range_start, obj.frog.range_end = True, 18.0, 100.0


def heard(scene, tmp_path):
    """Frames of the timeline at which Blender's own mixdown clicks."""
    if bpy.app.version[:2] == (5, 2) and bpy.app.background and not bpy.app.module:
        pytest.skip("Blender 5.2 mixes down in a job, which only the loop of a window ends")
    out = tmp_path / "mix.wav"
    options = {"container": "WAV", "codec": "PCM", "format": "S16"}
    assert bpy.ops.sound.mixdown(filepath=str(out), **options) == {"FINISHED"}
    rate = scene.render.fps / scene.render.fps_base
    sound = mixed(out, (scene.frame_end - scene.frame_start) / rate)
    return scene.frame_start + times_of_clicks(sound) * rate


def mixed(path, seconds):
    """A mixdown of so many seconds, which Blender 5.2 writes in a thread after it has said that it is finished."""
    until = time.monotonic() + 60
    while time.monotonic() < until:
        with suppress(OSError, EOFError, wave.Error, ValueError):
            sound = samples_of(path.read_bytes())
            if len(sound.values) >= seconds * sound.rate:
                return sound
        time.sleep(0.1)
    raise AssertionError(f"{path}: no {seconds:.1f} seconds of sound after a minute")


def expected(obj, scene):
    """Frames of the timeline at which the capture shows an image that was filmed at a click."""
    numbers = np.arange(scene.frame_start, scene.frame_end + 1)
    shown = [np.nan if frame is None else frame for frame in frames_shown(obj, scene, numbers.tolist())]
    frames = []
    for timeline_frame, frame, following in zip(numbers, shown, [*shown[1:], np.nan], strict=True):
        for click in CLICKS:
            is_jump = abs(following - frame) > 8
            if frame != following and not is_jump and min(frame, following) <= click < max(frame, following):
                frames.append(timeline_frame + (click - frame) / (following - frame))
    return np.array(frames)


@pytest.mark.parametrize("retimed", [slowly, by_a_curve, backward, cut])
def test_clicks_are_heard_while_their_images_are_shown(empty, capture, tmp_path, retimed):
    """Within half a frame of the timeline."""
    if retimed is by_a_curve:
        empty.render.fps, empty.render.fps_base = 30, 1.001
    retimed(capture)
    assert bpy.ops.frog.add_sound_strip() == {"FINISHED"}
    filmed, clicks = expected(capture, empty), heard(empty, tmp_path)
    assert len(filmed) >= 10 and len(clicks) == len(filmed)
    np.testing.assert_allclose(clicks, filmed, atol=0.5)
    assert active_capture(bpy.context) == capture


def test_a_changed_timing_is_told_and_one_click_mends_it(empty, capture, tmp_path):
    assert not bpy.ops.frog.update_sound.poll()
    bpy.ops.frog.add_sound_strip()
    bpy.ops.frog.add_sound_strip()
    (strip,) = empty.sequence_editor.strips
    assert len(bpy.data.sounds) == 1 and strip.sound.packed_file is not None
    strip.volume, strip.channel = 0.5, 3
    assert capture_sound.is_outdated(capture, empty) is False
    for change in (by_a_curve, lambda _obj: setattr(empty.render, "fps", 25)):
        change(capture)
        assert capture_sound.is_outdated(capture, empty) is True
        assert bpy.ops.frog.update_sound() == {"FINISHED"}
        assert capture_sound.is_outdated(capture, empty) is False
        filmed, clicks = expected(capture, empty), heard(empty, tmp_path)
        np.testing.assert_allclose(clicks, filmed, atol=0.5)
    (strip,) = empty.sequence_editor.strips
    assert (strip.volume, strip.channel) == (0.5, 3)
    assert len(bpy.data.sounds) == 1, "what nothing plays any more is gone"
    capture.frog.driver_add("speed").driver.expression = "0.5"
    assert capture_sound.is_outdated(capture, empty) is None


def refused(what):
    refuses(f"found a strip {what}.*Delete it in the sequencer first", bpy.ops.frog.update_sound)


def test_what_was_done_to_a_strip_is_not_undone(empty, capture):
    bpy.ops.frog.add_sound_strip()
    (strip,) = empty.sequence_editor.strips
    slowly(capture)
    strip.volume = 0.25
    strip.keyframe_insert("volume", frame=10)
    refused("with animated settings")
    assert empty.sequence_editor.strips[0] == strip and strip.volume == 0.25
    empty.animation_data_clear()
    meta = empty.sequence_editor.strips.new_meta("meta", 5, 1)
    strip.move_to_meta(meta)
    refused("in a meta strip")
    empty.sequence_editor.strips.remove(meta)
    assert not bpy.ops.frog.update_sound.poll() and capture_sound.sound_of(capture) is None
    assert bpy.ops.frog.add_sound_strip() == {"FINISHED"} and len(bpy.data.sounds) == 1
    editor = empty.sequence_editor
    editor.strips.new_sound("piece", bpy.data.filepath, 4, 1).sound = editor.strips[0].sound
    refused("that was cut or copied")


def test_sound_is_in_the_blend(empty, capture, tmp_path):
    slowly(capture)
    bpy.ops.frog.add_sound_strip()
    filmed = expected(capture, empty)
    (tmp_path / "films" / "cam00.mp4").unlink()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "x.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "x.blend"))
    np.testing.assert_allclose(heard(bpy.context.scene, tmp_path), filmed, atol=0.5)
    assert capture_sound.is_outdated(the_capture(), bpy.context.scene) is False
    refuses("found no film of its capture with sound", bpy.ops.frog.update_sound)


def test_blenders_own_library_reads_films(empty, capture, tmp_path, monkeypatch):
    monkeypatch.setattr(capture_sound, "_has_pyav", lambda: False)
    slowly(capture)
    assert bpy.ops.frog.add_sound_strip() == {"FINISHED"}
    np.testing.assert_allclose(heard(empty, tmp_path), expected(capture, empty), atol=0.5)


@pytest.mark.skipif(find_spec("av") is None, reason="needs PyAV")
def test_exports_have_the_same_sound(empty, capture, tmp_path):
    by_a_curve(capture)
    filmed = expected(capture, empty)
    page = tmp_path / "x.html"
    assert bpy.ops.export_scene.frog_web_page(filepath=str(page)) == {"FINISHED"}
    (encoded,) = re.findall(r'id="sound">data:audio/ogg;base64,([^<]+)<', page.read_text(encoding="utf-16"))
    sound = Samples(read_sound_file(b64decode(encoded), 48_000, 2), 48_000)
    heard_there = 1 + times_of_clicks(sound) * RATE
    np.testing.assert_allclose(heard_there, filmed, atol=0.5)


def test_what_cannot_be_heard_is_said(empty, capture):
    capture.frog.speed = 0.0
    refuses("found nothing to hear in frames 1 to 130", bpy.ops.frog.add_sound_strip)
    assert not bpy.data.sounds
