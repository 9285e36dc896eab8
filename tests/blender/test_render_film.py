"""Render Film: a film of the frame range, or a sentence and nothing changed."""

import bpy
import pytest
from support.builders import REPOSITORY, refuses
from support.small_scenes import rig_of_three, write_scene
from support.training_panel import panel_says, switched_off

from frog_blender.operators.render_film import set_output, suggested_film
from frog_blender.ui import render_panel


@pytest.fixture
def scene(empty, tmp_path):
    """A capture in a scene of three frames, 64 x 48 pixels."""
    path = write_scene(tmp_path / "x.frog", rig_of_three())
    bpy.ops.import_scene.frog(filepath=str(path), set_up_scene=True)
    scene = bpy.context.scene
    scene.frame_start, scene.frame_end = 1, 3
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 64, 48, 100
    return scene


def test_a_film_has_the_frames(scene, tmp_path):
    cv2 = pytest.importorskip("cv2")
    target = tmp_path / "films" / "take.mp4"
    target.parent.mkdir()
    assert bpy.ops.frog.render_film(filepath=str(target)) == {"FINISHED"}
    assert [path.name for path in target.parent.iterdir()] == ["take.mp4"]
    assert "take.mp4 is rendered." in panel_says(render_panel.FROG_PT_render)
    film = cv2.VideoCapture(str(target))
    images = []
    while (read := film.read())[0]:
        images.append(read[1])
    assert len(images) == 3 and images[0].shape == (48, 64, 3)
    assert scene.render.ffmpeg.audio_codec == "NONE", "nothing is heard in this scene"
    assert any(image.std() > 1 for image in images), "splats are seen"


def test_a_film_lies_beside_the_file_or_else_the_capture(scene, tmp_path):
    assert suggested_film(scene) == str(tmp_path / "x.mp4")
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "film.blend"))
    assert suggested_film(bpy.context.scene) == ""


def test_sound_goes_with_it(scene, tmp_path):
    speaker = bpy.data.objects.new("speaker", bpy.data.speakers.new("speaker"))
    scene.collection.objects.link(speaker)
    assert bpy.ops.frog.render_film(filepath=str(tmp_path / "x.mp4")) == {"FINISHED"}
    assert scene.render.ffmpeg.audio_codec == "AAC"


@pytest.mark.parametrize(
    ("settings", "name", "said"),
    [
        ({"resolution_x": 63}, "x.mp4", "63 x 48 pixels; films need even"),
        ({"resolution_x": 100, "resolution_percentage": 29}, "x.mp4", "29 x 13 pixels"),
        ({"use_border": True, "use_crop_to_border": True, "border_max_x": 0.52}, "x.mp4", "33 x 48 pixels"),
        ({}, "missing/x.mp4", "found no such folder"),
        ({}, "", "found a folder, expected the name of a film"),
        ({}, f"{'x' * 300}.mp4", "no file can have this name"),
    ],
)
def test_what_cannot_be_written_is_told(scene, tmp_path, settings, name, said):
    for setting, value in settings.items():
        setattr(scene.render, setting, value)
    before = scene.render.filepath, scene.render.image_settings.file_format
    refuses(said, bpy.ops.frog.render_film, filepath=str(tmp_path / name))
    assert (scene.render.filepath, scene.render.image_settings.file_format) == before


def test_settings_of_other_films_neither_rename_nor_discolour_it(scene, tmp_path):
    render = scene.render
    set_output(scene, tmp_path / "before.mp4")
    render.image_settings.color_mode = "BW"
    render.ffmpeg.use_autosplit = render.ffmpeg.use_lossless_output = True
    target = tmp_path / "take {1} #2.mp4"
    assert bpy.ops.frog.render_film(filepath=str(target)) == {"FINISHED"}
    assert target.is_file()
    assert render.image_settings.color_mode == "RGB" and not render.ffmpeg.use_lossless_output


def test_the_demos_film_is_of_the_capture_by_frog(empty, static_rig, tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(REPOSITORY / "examples")
    from demo import render_video

    with switched_off():
        render_video(static_rig, tmp_path / "x.blend", tmp_path / "x.mp4")
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "x.blend"))
    scene = bpy.context.scene
    assert (scene.render.engine, scene.frame_end, scene.camera.name) == ("FROG", 10, "Flight")
    assert bpy.data.movieclips.load(str(tmp_path / "x.mp4")).frame_duration == 10


def test_without_a_camera_it_is_grey(scene):
    scene.camera = None
    assert not bpy.ops.frog.render_film.poll()
