"""Clips behind cameras: found again, in time with the capture whatever its timing, and never in the way."""

from dataclasses import replace

import bpy
import numpy as np
import pytest
from support.blender_windows import in_window
from support.builders import refuses
from support.layouts.lists import opencv_entry, rewrite, write_opencv
from support.small_scenes import imported, moving_camera, rig_of_three, write_scene
from support.training_panel import switched_off

from frog_blender.engine.source_media.undistorted_clips import clips_folder
from frog_blender.operators.clips import FROG_OT_add_clips
from frog_blender.scene_import.camera_clips import add_clips, clip_of
from frog_blender.scene_import.capture_objects import cameras_of
from frog_blender.timeline.retiming import capture_frame

COUNT = 10


def image(path):
    image = bpy.data.images.new("image", 8, 8)
    image.filepath_raw, image.file_format = str(path), "PNG"
    path.parent.mkdir(parents=True, exist_ok=True)
    image.save()
    bpy.data.images.remove(image)


@pytest.fixture
def mono(empty, tmp_path):
    """One moving camera, its images numbered from 5 in steps of 2, and transforms.json."""
    folder = tmp_path / "film"
    cameras = [replace(camera, name=f"frame_{5 + 2 * i:03d}") for i, camera in enumerate(moving_camera(COUNT))]
    for camera in cameras:
        image(folder / "images" / f"{camera.name}.png")
    rewrite(folder, {"frames": [{"file_path": f"images/{camera.name}.png"} for camera in cameras]})
    shots = [(frame,) for frame in range(COUNT)]
    trained = {"capture_path": str(folder), "capture_format": "transforms"}
    return write_scene(tmp_path / "film.frog", cameras, camera_shots=tuple(shots), frame_count=COUNT, **trained)


@pytest.fixture
def still(empty, tmp_path):
    """Three cameras with an image each."""
    folder = tmp_path / "stills"
    for name in ("cam00", "cam01", "cam02"):
        image(folder / "images" / f"{name}.png")
    return write_scene(tmp_path / "stills.frog", rig_of_three(), frame_count=COUNT, capture_path=str(folder))


def with_clips(path, **options):
    obj = imported(path, **options)
    add_clips(obj)
    return obj


def number_shown(camera, frame):
    """The number of the image behind a camera at a frame of the timeline, as Blender evaluates it."""
    bpy.context.scene.frame_set(int(frame), subframe=frame % 1)
    evaluated = camera.evaluated_get(bpy.context.evaluated_depsgraph_get())
    return clip_of(evaluated).image_user.frame_offset + 1


def test_each_camera_has_its_own_image(still, tmp_path):
    (tmp_path / "stills" / "images" / "cam01.png").unlink()
    first, lacking, last = cameras_of(with_clips(still))
    assert clip_of(lacking) is None
    for camera in (first, last):
        background = clip_of(camera)
        assert bpy.path.abspath(background.image.filepath).endswith(f"{camera.name}.png")
        assert camera.data.show_background_images and background.alpha == 0.5
        assert not camera.data.animation_data or not camera.data.animation_data.drivers


def test_a_sequence_follows_whatever_the_timing(mono):
    obj = with_clips(mono)
    (camera,) = cameras_of(obj)
    background = clip_of(camera)
    assert background.image.source == "SEQUENCE"
    assert background.image_user.use_cyclic and background.image_user.frame_duration == 1
    (curve,) = camera.data.animation_data.drivers
    assert curve.driver.is_simple_expression, "Blender runs Python in drivers only for files it trusts"
    assert len(curve.driver.expression) < 256
    settings = [
        {},
        {"start_frame": 4.0},
        {"speed": 0.5},
        {"speed": -2.0, "repeat": "LOOP"},
        {"speed": 1.5, "repeat": "PING_PONG", "start_frame": -3.25},
        {"use_trim": True, "first_frame": 2, "last_frame": 6, "repeat": "LOOP"},
        {"use_remap": True, "shown_frame": 6.6},
    ]
    plain = {"start_frame": 1.0, "speed": 1.0, "repeat": "HOLD", "use_remap": False, "use_trim": False}
    for changed in settings:
        for name, value in (plain | changed).items():
            setattr(obj.frog, name, value)
        for frame in (-12, 1, 2, 5.3, 11, 26, 40):
            index = np.floor(np.clip(capture_frame(obj, frame, COUNT), 0, COUNT - 1) + 0.5)
            assert number_shown(camera, frame) == 5 + 2 * index, (changed, frame)


def test_an_import_says_another_rate(empty, static_rig, capfd):
    imported(static_rig)
    assert "the scene plays" not in "".join(capfd.readouterr())
    empty.render.fps = 50
    imported(static_rig, set_up_scene=False)
    assert "and the scene plays 50: use Real Time" in "".join(capfd.readouterr())


def test_another_folder_is_named_and_clips_are_hidden_again(mono, tmp_path):
    (tmp_path / "film").rename(tmp_path / "elsewhere")
    obj = with_clips(mono)
    camera = cameras_of(obj)[0]
    assert clip_of(camera) is None
    refuses(r"elsewhere/transforms\.json: found no focal length", bpy.ops.frog.add_clips, directory=str(tmp_path))
    refuses("found no clip", bpy.ops.frog.add_clips, directory=str(tmp_path / "film"))
    for _ in range(2):  # a second time replaces the first
        assert bpy.ops.frog.add_clips(directory=str(tmp_path / "elsewhere")) == {"FINISHED"}
    assert len(camera.data.background_images) == len(camera.data.animation_data.drivers) == 1
    assert clip_of(camera).alpha == pytest.approx(0.5) and clip_of(camera).display_depth == "BACK"
    assert bpy.ops.frog.hide_clips() == {"FINISHED"}
    assert clip_of(camera) is None and not camera.data.animation_data.drivers


def test_renamed_cameras_keep_their_clips_and_a_user_s_own_image_stays(mono):
    obj = imported(mono)
    assert clip_of(cameras_of(obj)[0]) is None, "a film would show again what a crop hides"
    camera = cameras_of(obj)[0]
    camera.name = camera.data.name = "tracking shot"
    own = camera.data.background_images.new()
    own.image = bpy.data.images.new("storyboard", 4, 4)
    assert bpy.ops.frog.add_clips() == {"FINISHED"}
    assert number_shown(camera, 3) == 9
    assert bpy.ops.frog.hide_clips() == {"FINISHED"}
    assert [background.image.name for background in camera.data.background_images] == ["storyboard"]


def test_clips_are_in_time_after_the_addon_was_away(mono):
    name = with_clips(mono).name
    with switched_off():
        bpy.context.scene.frame_set(5)
        bpy.context.view_layer.update()
    assert number_shown(cameras_of(bpy.data.objects[name])[0], 4) == 11


@pytest.fixture
def bent(empty, tmp_path):
    """A scene of three cameras whose lenses distort, and their videos."""
    films = pytest.importorskip("support.small_captures")
    folder = tmp_path / "bent"
    folder.mkdir()
    cameras = rig_of_three()
    listed = []
    for camera in cameras:
        films.write_video(folder / f"{camera.name}.mp4", COUNT, camera.width, camera.height)
        listed.append(opencv_entry(camera, dist=[-0.2, 0.0, 0.0, 0.0]))
    write_opencv(folder, listed)
    trained = {"capture_path": str(folder), "capture_format": "calibrated_videos"}
    return write_scene(tmp_path / "bent.frog", cameras, frame_count=COUNT, **trained)


def shown_files(obj):
    return {clip_of(camera).image.filepath for camera in cameras_of(obj) if clip_of(camera)}


def test_bent_clips_are_straightened(bent, tmp_path):
    obj = with_clips(bent)
    assert shown_files(obj) == {str(tmp_path / "bent" / f"cam0{i}.mp4") for i in range(3)}, "as they were filmed"
    assert not clips_folder(bent).exists()
    assert bpy.ops.frog.add_clips() == {"FINISHED"}
    straight = {str(clips_folder(bent) / f"cam0{i}.mp4") for i in range(3)}
    assert shown_files(obj) == straight
    first = cameras_of(obj)[0]
    assert len(first.data.background_images) == 1 and clip_of(first).image.frame_duration == COUNT
    obj.frog.start_frame = 3.0
    assert [number_shown(first, frame) for frame in (1, 3, 4, 12, 20)] == [1, 1, 2, 10, 10]
    assert shown_files(with_clips(bent)) == straight, "they are there from now on"


def test_clips_are_shown_although_films_cannot_be_written(bent, tmp_path, capfd):
    obj = imported(bent)
    clips_folder(bent).write_text("in the way")
    assert bpy.ops.frog.add_clips() == {"FINISHED"}
    assert len(shown_files(obj)) == 3
    assert "found files of others" in "".join(capfd.readouterr())
    clips_folder(bent).unlink()
    (clips_folder(bent) / "cam01.mp4").mkdir(parents=True)
    (clips_folder(bent) / "clips.json").write_text("{}")  # as a Blender that was killed leaves it
    refuses(r"The original clips are shown: .*cam01\.mp4", bpy.ops.frog.add_clips)
    assert len(shown_files(obj)) == 3
    assert [path.name for path in clips_folder(bent).iterdir()] == ["cam01.mp4"]


def test_in_a_window_straightening_can_be_stopped(bent):
    with in_window(FROG_OT_add_clips) as window:
        obj = with_clips(bent)
        before = shown_files(obj)
        assert bpy.ops.frog.add_clips() == {"RUNNING_MODAL"}
        assert window.send() == {"PASS_THROUGH"} and window.send("ESC", "PRESS") == {"CANCELLED"}
        assert shown_files(obj) == before
    assert {path.name for path in bent.parent.iterdir()} == {"bent", "bent.frog"}
