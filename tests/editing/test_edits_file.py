"""The file of edits: what is written is read, damage is said in a sentence, and a retiming in it is kept to."""

import json
from dataclasses import replace
from importlib.util import find_spec

import numpy as np
import pytest
from support.builders import refused, scene_file
from support.clicks import film_of_clicks, samples_of, times_of_clicks
from support.solids import CORNERS, FACES

from frog_blender.cli.main import main
from frog_blender.engine.capture.media import read_sound_file
from frog_blender.engine.editing.closed_mesh import ClosedMesh
from frog_blender.engine.editing.crops import Crop
from frog_blender.engine.editing.edited_scene import EditedScene, RetimedScene
from frog_blender.engine.editing.edits import Edits, Timing
from frog_blender.engine.editing.edits_file import load_edits, save_edits
from frog_blender.engine.editing.grades import Grade
from frog_blender.engine.editing.marks import Marks
from frog_blender.engine.interchange.ply import read_splats
from frog_blender.engine.interchange.take import encoded, scene_take, with_sound
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import render_image
from frog_blender.engine.scene.scene_file import SceneFile, write_scene
from frog_blender.engine.source_media.sound import RATE, Samples

NO_MESH = {"vertices": [0] * 12, "triangles": [0, 1, 9] * 4}
PLACE = tuple(np.diag([0.8, 0.9, 1.1, 1.0]).ravel().tolist())


@pytest.fixture
def scene():
    return ScenePlayer(scene_file(100))


@pytest.fixture
def edits(scene):
    some = np.arange(100) % 4 == 0
    return Edits(
        Marks.of(scene, some),
        (
            Crop("box", PLACE, feather=0.25),
            Crop("sphere", PLACE, False, time=0.5),
            Crop("mesh", PLACE, mesh=ClosedMesh.of(CORNERS * 3, FACES)),
        ),
        (Grade(exposure=0.7, offsets=(0.1, 0.0, -0.1)), Grade(saturation=0.1, only=Marks.of(scene, ~some))),
        Timing((None, 0.0, 0.5, 1.25, 6.0, 3.0, None), 24.0, 10),
    )


def test_what_is_written_is_read(tmp_path, edits):
    save_edits(tmp_path / "e.json", edits)
    assert load_edits(tmp_path / "e.json") == edits
    assert Edits(timing=edits.timing).are_none, "a retiming changes no frame by itself"
    save_edits(tmp_path / "none.json", Edits(grades=(Grade(),) * 101))  # which change nothing
    assert load_edits(tmp_path / "none.json") == Edits()


@pytest.mark.parametrize(
    ("edits", "said"),
    [
        (Edits(crops=(Crop("box", PLACE),) * 101), "crops"),
        (Edits(grades=(Grade(exposure=1),) * 101), "grades"),
        (Edits(crops=(Crop("box", PLACE, feather=1e10),)), "feather"),
        (Edits(Marks(8, "x" * 65, bytes(1))), "scene"),
    ],
)
def test_what_could_not_be_read_is_not_written(tmp_path, edits, said):
    refused(f"could not be read again: .*{said}", save_edits, tmp_path / "e.json", edits)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("where", "value", "said"),
    [
        ("frog_edits", 2, "frog_edits"),
        ("surprise", 1, "surprise"),
        ("crops", [{"shape": "box"}], "matrix"),
        ("crops", [{"shape": "cone", "matrix": list(PLACE)}], "shape"),
        ("crops", [{"shape": "box", "matrix": list(PLACE), "feather": -1}], "feather"),
        ("crops", [{"shape": "box", "matrix": [0] * 16}], "none of a placed object"),
        ("crops", [{"shape": "box", "matrix": [1, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1]}], "nothing along"),
        ("crops", [{"shape": "mesh", "matrix": list(PLACE), **NO_MESH}], "not there"),
        ("crops", {}, "crops"),
        ("grades", [{"exposure": "bright"}], "exposure"),
        ("grades", [{"gains": [1, 2]}], "gains"),
        ("time", {"rate": 24, "frames": []}, "a timing of 0 frames"),
        ("time", {"rate": 24, "frames": [0, None, 1]}, "shows nothing between"),
        ("time", {"rate": 0, "frames": [0]}, "at 0 frames a second"),
        ("time", {"rate": 24, "frames": ["a"]}, "frame = a"),
        ("time", {"rate": 24, "frames": {}}, "frames"),
        ("time", {"rate": 24, "frames": [0], "start": 0.5}, "start"),
        ("time", [], "a timing"),
        ("hidden", {"count": 10, "scene": "x", "bits": "!"}, "damaged"),
        ("hidden", {"count": 2**60, "scene": "x", "bits": ""}, "count"),
    ],
)
def test_what_cannot_be_is_said(tmp_path, where, value, said):
    path = tmp_path / "e.json"
    path.write_text(json.dumps({"frog_edits": 1, where: value}))
    assert str(path) in refused(said, load_edits, path)


def test_packed_marks_take_no_more_memory_than_they_say(scene):
    bomb = Marks(8 * 10**7, "x", bytes(10**7)).to_text()
    with pytest.raises(ValueError, match="from other than"):
        Marks.from_text(64, "x", bomb)


TIMING = Timing((None, 0.0, 0.5, 1.25, 6.0, 3.0, None, None), 24.0, 10)


def test_rendered_and_exported_frames_are_the_edited_and_retimed_ones(tmp_path, capsys):
    cv2 = pytest.importorskip("cv2")
    write_scene(tmp_path / "s.frog", scene_file(60))
    plain = ScenePlayer.load(tmp_path / "s.frog")
    inside = Crop("sphere", tuple(np.diag([0.8, 0.9, 1.1, 1.0]).ravel().tolist()), False, 0.25)
    edits = Edits(Marks.of(plain, np.arange(60) % 4 == 0), (inside,), (Grade(exposure=0.7),), TIMING)
    save_edits(tmp_path / "e.json", edits)
    scene, camera, background = EditedScene(plain, edits), plain.header.cameras[0], plain.header.background
    command = [str(tmp_path / "s.frog"), "--edits", str(tmp_path / "e.json"), "--out", str(tmp_path / "out")]
    assert main(["render", *command, "--camera", camera.name]) == 0
    images = [cv2.imread(str(path))[..., ::-1] for path in sorted((tmp_path / "out").glob("*.png"))]
    assert len(images) == 8
    for image, frame in zip(images[1:6], (0.0, 0.5, 1.25, 6.0, 3.0), strict=True):
        assert np.abs(image.astype(int) - render_image(scene.at_frame(frame), camera, background)).max() <= 1
        assert np.abs(image.astype(int) - render_image(plain.at_frame(frame), camera, background)).max() > 10
    for image in (images[0], images[7]):
        assert np.ptp(image, axis=(0, 1)).max() == 0, "nothing but the background"
    assert main(["export", *command, "--frames", "0:4"]) == 0
    first, *_, last = (read_splats(path).arrays for path in sorted((tmp_path / "out").glob("*.ply")))
    np.testing.assert_allclose(last["means"], scene.at_frame(1.25).means, atol=1e-6)
    assert len(first["means"]) == len(last["means"]) and first["opacity_logits"].max() < -20
    assert main(["export", *command, "--frames", "0:9"]) != 0 and "between 0:8" in capsys.readouterr().err
    write_scene(tmp_path / "s.frog", scene_file(60, seed=5))
    assert main(["render", *command, "--camera", camera.name]) == 0
    assert "another training" in capsys.readouterr().err


def test_takes_are_as_long_and_as_fast_as_the_retiming():
    scene = ScenePlayer(scene_file(60))
    take = scene_take(scene, "x", range(1, 8), TIMING)
    assert take.numbers == [*range(11, 18)] and take.rate == 24
    assert (take.num_dynamic, tuple(take.changing)) == (60, scene.columns), "all of it is there and then is not"
    frames = list(take.frames())
    assert [frame.time for frame in frames] == [0.0, 0.5, 1.25, 6.0, 3.0, 0.0, 0.0]
    np.testing.assert_array_equal(frames[2].gaussians.means, scene.at_frame(1.25).means)
    assert frames[4].gaussians.opacities.any() and not frames[5].gaussians.opacities.any()
    within = scene_take(scene, "x", range(1, 6), TIMING)
    assert (within.num_dynamic, tuple(within.changing)) == (scene.num_dynamic, scene.changing)
    retimed = RetimedScene(scene, TIMING)
    assert len(retimed.at_frame(0)) == 60 and not retimed.at_frame(0).opacities.any()


def test_the_sound_of_an_export_is_retimed(tmp_path, capsys):
    file = scene_file(60)
    rate, count = file.header.frames_per_second, file.header.frame_count
    header = replace(file.header, capture_path=str(tmp_path), capture_format="n3dv")
    write_scene(tmp_path / "s.frog", SceneFile(header, file.arrays))
    film_of_clicks(tmp_path / f"{header.cameras[0].name}.mp4", [3 / rate], count / rate, round(rate))
    shown = (None, None, *(0.5 * k for k in range(2 * count - 1)))
    take = scene_take(ScenePlayer.load(tmp_path / "s.frog"), "x", range(len(shown)), Timing(shown, 24.0))
    sound = with_sound(take, tmp_path / "s.frog").sound
    np.testing.assert_allclose(times_of_clicks(samples_of(sound.content)) * 24, [8], atol=0.5)
    save_edits(tmp_path / "e.json", Edits(timing=Timing(shown, 24.0)))
    command = ["export", str(tmp_path / "s.frog"), "--edits", str(tmp_path / "e.json")]
    page = tmp_path / "x.html"
    assert main([*command, "--html", "--out", str(page)]) == 0
    assert "with sound" in capsys.readouterr().out and 'id="sound">data:audio/ogg' in page.read_text("utf-16")
    again = Samples(read_sound_file(encoded(sound, len(shown) / 24), RATE, 2), RATE)
    np.testing.assert_allclose(times_of_clicks(again) * 24, [8], atol=0.5)
    assert len(again.values) / again.rate == pytest.approx(len(shown) / 24, abs=0.05)
    if find_spec("pxr") is not None:
        assert main([*command, "--usd", "--out", str(tmp_path / "x.usda")]) == 0
        assert "@x_sound.wav@" in (tmp_path / "x.usda").read_text()
        heard = times_of_clicks(samples_of((tmp_path / "x_sound.wav").read_bytes()))
        np.testing.assert_allclose(heard * 24, [8], atol=0.5)
