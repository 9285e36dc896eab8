"""What the panel says, and the image in it."""

import shutil
import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from support.builders import refuses
from support.option_examples import EXAMPLES
from support.system_faults import file_size_limit
from support.training_panel import finish, leave_checkpoint, panel_says, switched_off, told

from frog_blender.engine import registry
from frog_blender.engine.errors import FrogError
from frog_blender.engine.options import TrainingOptions, panel_options
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.output_paths import checkpoint_path
from frog_blender.option_properties import property_name
from frog_blender.tasks import background_task
from frog_blender.tasks.background_task import Ended
from frog_blender.tasks.training import TrainingTask
from frog_blender.tasks.training_request import TrainingRequest, request_of
from frog_blender.ui import (
    capture_panel,
    capture_summary,
    preview_image,
    torch_environment,
    train_panel,
    training_settings,
)


@pytest.fixture
def capture(empty, filmed, tmp_path, monkeypatch):
    """A folder of four filmed cameras, chosen in the panel, of which no training is known."""
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    empty.frog.output_path = str(tmp_path / "capture.frog")
    empty.frog.capture_folder = str(filmed)
    return filmed


def drawn(panel=train_panel.FROG_PT_train):
    return panel_says(panel) or ""


def test_a_capture_is_described_and_its_training_timed(empty, capture):
    empty.frog.capture_folder = ""
    assert "Roughly" not in drawn()
    empty.frog.capture_folder = str(capture)
    said = drawn(capture_panel.FROG_PT_capture)
    assert "Camera positions: poses_bounds.npy (N3DV, LLFF)" in said and "4 cameras, 1 held out" in said
    said = drawn()
    assert "Roughly" in said and "on this processor" in said
    assert said.index("frog.train") < said.index("Roughly"), "its lines, of any number, move no button"
    empty.frog.device = "cuda"
    assert "on the GPU: not known before a first training" in drawn()
    empty.frog.device, empty.frog.minutes = "cpu", 180.0
    assert "Roughly 3" in drawn() and "hours on this processor" in drawn()


def test_every_layout_says_in_words_where_its_cameras_are_from():
    assert set(capture_summary._CAMERAS) == {name for name, _ in registry._LAYOUTS}


def test_what_reads_films_can_be_installed_where_torch_is(capture, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.setattr(torch_environment, "torch_needed", lambda: "")
    refuses("PyAV", bpy.ops.frog.inspect_capture)
    said = drawn(capture_panel.FROG_PT_capture)
    assert "Films and sound need PyAV" in said and "frog.install_calibration" in said
    monkeypatch.undo()
    bpy.ops.frog.inspect_capture()
    assert "frog.install_calibration" not in drawn(capture_panel.FROG_PT_capture)


def test_a_running_training(empty):
    task = told(events.Stage("decoding frames", 3, 10, 0.1, 200.0))
    assert "Decoding frames About 3 minutes left" in drawn() and "frog.train" not in drawn()
    task = told(
        events.Started("frog", 100, 4, 6, 300),
        events.Reduced(30, "120 Gaussians came to rest"),
        events.Progress(40, 100, 12.0, 125.0, 0.0421, 320, 200, 0.4),
        events.Evaluated(40, 27.5, "held-out"),
    )
    said = drawn()
    assert "Step 40 of 100 About 2 minutes left" in said and "frog.train" not in said
    report = drawn(train_panel.FROG_PT_train_report)
    for part in ("0.0421", "27.50 dB (held-out views)", "320 (200 dynamic)"):
        assert part in report and part not in said
    assert "frog.pause_training frog.cancel_training" in said and "preview_camera" in said
    task.control.pause()
    assert "Paused: Step 40 of 100 About 2 minutes left frog.resume_training frog.cancel" in drawn()


def test_an_ended_training(empty, tmp_path):
    path = tmp_path / ("a long name " * 8).strip() / "x.frog"
    capacity = {"gaussians": 300, "dynamic": 40, "sh_degree": 1, "reductions": []}
    ended = Ended("")
    path.parent.mkdir()
    path.write_bytes(bytes(1_100_000))
    phases = {"decoding": 20.0, "seeding": 3.0, "training": 61.0, "finishing": 7.0}
    finished = events.Finished(str(path), 9, 61.0, 33.84, 300, capacity, phases)
    told(events.Progress(9, 9, 61.0, 0.0, 0.1, 300), finished, ended)
    said = drawn()
    assert "Finished in 1 min 31 s." in said and "frog.train" in said and "frog.dismiss_training" in said
    assert "x.frog: 40 of 300 Gaussians move; file 1.1 MB; quality 33.8 dB." in said
    assert not any(word in said for word in ("heads", "SH degree", "PSNR", "Loss")), "for the report alone"
    report = drawn(train_panel.FROG_PT_train_report)
    assert f"Saved:{path}".replace(" ", "") in report.replace(" ", "")  # cut into lines, and whole
    assert "300 (40 dynamic)" in report and "SH degree 1" in report
    assert "DEFAULT_CLOSED" in train_panel.FROG_PT_train_report.bl_options
    told(events.Cancelled(0, None), ended)
    assert "Cancelled before the first step." in drawn()
    told(Ended("It stopped."))
    assert "It stopped." in drawn()


def pixels():
    icon = preview_image.icons()[preview_image.NAME]
    width, height = icon.image_size
    values = np.empty(width * height, np.int32)
    icon.image_pixels.foreach_get(values)
    return values.view(np.uint8).reshape(height, width, 4)[::-1]


def test_a_preview_reaches_the_panel_by_the_timer_and_goes_with_the_add_on(addon):
    image = np.random.default_rng(0).integers(0, 255, (30, 40, 3), np.uint8)
    task = TrainingTask(lambda control: iter([events.Preview(1, image)])).begin()
    assert task.join(20.0)
    while background_task.tick() is not None:
        pass
    np.testing.assert_array_equal(pixels()[:, :, :3], image)
    assert (pixels()[:, :, 3] == 255).all()
    with switched_off():
        assert preview_image.icons() is None and preview_image.icon_id() == 0
        preview_image.show(image)  # a late one
        assert preview_image.icons() is None
    preview_image.show(image)
    preview_image.show(None)
    assert preview_image.icon_id() == 0 and not set(preview_image.icons())


def test_the_preview_camera_is_searched_among_the_captures(empty, capture):
    from frog_blender.ui.training_settings import camera_names

    assert camera_names(empty.frog, None, "") == ["cam00", "cam01", "cam02", "cam03"]  # the held-out one first
    assert camera_names(empty.frog, None, "M02") == ["cam02"]
    assert capture_summary.of(empty.frog).previewed == "cam00 (held out)"
    task = told(events.Stage("decoding frames", 3, 10))
    empty.frog.preview_camera = "cam02"
    assert task.control.preview_camera == "cam02"


def test_a_report_stays_with_the_file_that_shows_the_scene(empty, static_rig):
    ended = events.Finished(str(static_rig), 9, 61.0, 28.0, 60), Ended("")
    task = told(*ended)
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert TrainingTask.current() is task, "it was not imported yet"
    bpy.ops.import_scene.frog(filepath=str(static_rig))
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    assert TrainingTask.current() is None


def test_a_grey_button_says_why(empty, capture, tmp_path, monkeypatch):
    monkeypatch.setattr(torch_environment, "torch_needed", lambda: "")
    (tmp_path / "nothing").mkdir()
    shutil.copytree(capture, tmp_path / "raw", ignore=shutil.ignore_patterns("*.npy"))
    for folder, why in (("", "No capture is selected"), ("nothing", "found"), ("raw", "have to be calibrated")):
        empty.frog.capture_folder = folder and str(tmp_path / folder)
        assert not bpy.ops.frog.train.poll()
        refuses(why, bpy.ops.frog.train)
    empty.frog.capture_folder = str(capture)
    assert bpy.ops.frog.train.poll()
    told(events.Stage("decoding frames", 3, 10))
    assert not bpy.ops.frog.train.poll()


def test_no_value_stands_for_something_else(empty, capture):
    settings, advanced = empty.frog, train_panel.FROG_PT_train_advanced
    settings.recipe = "draft"
    said = drawn(advanced)
    for resolved in ("3,000 steps", "1.00 of their size", "25,000 at most", "cam00"):
        assert resolved in said
    words = said.split()
    assert not {"steps", "minutes", "image_scale", "max_gaussians", "holdout_frames"} & set(words) - {"steps"}
    settings.length, settings.holdout = "STEPS", "FRAMES"
    settings.has_image_scale = settings.has_max_gaussians = True
    said = drawn(advanced)
    assert "length steps" in said and "3,000 steps" not in said
    for name in ("image_scale", "max_gaussians", "holdout_frames", "pixel_offsets"):
        assert name in said
    assert (settings.steps, settings.image_scale, settings.holdout_frames) == (3000, 1.0, 8)
    settings.length, settings.holdout = "TIME", "NONE"
    assert (settings.steps, settings.minutes, settings.holdout_frames) == (0, 10.0, 0)
    settings.length, settings.holdout = "RECIPE", "CAPTURE"
    settings.has_image_scale = settings.has_max_gaussians = False
    stored = settings.steps, settings.minutes, settings.image_scale, settings.holdout_frames, settings.max_gaussians
    assert stored == (0, 0.0, 0.0, -1, 0), "as scripts know them"
    assert training_settings.usual_steps(settings) == 3000


def test_resume_is_offered_where_it_does_something(empty, capture, monkeypatch):
    monkeypatch.setattr(torch_environment, "torch_needed", lambda: "")
    scene = Path(empty.frog.output_path)
    assert "frog.train_longer" not in drawn() and drawn().count("frog.train") == 1
    leave_checkpoint(scene, capture, 0.4, 1200)
    assert drawn().count("frog.train") == 2 and "frog.train_longer" not in drawn(), "Resume"
    sentence = f"The training of {scene.name} was interrupted at step 1,200."
    assert sentence in drawn()
    told(events.Progress(9, 9, 61.0, 0.0, 0.1, 300), events.Finished("other.frog", 9, 61.0, 33.84, 300), Ended(""))
    assert sentence in drawn(), "another has finished since"
    assert not bpy.ops.frog.train_longer.poll()
    leave_checkpoint(scene, capture, 1.0, 3000)
    assert drawn().split().count("frog.train") == 1 and "frog.train_longer" in drawn()
    assert "interrupted" not in drawn()
    refuses("has had 3,000 steps already", bpy.ops.frog.train_longer, steps=3000)


def test_training_longer_keeps_the_finished_scene(empty, capture, quick_seeds):
    """A training of a few steps, and more of them, by the engine itself."""
    pytest.importorskip("torch")
    settings = empty.frog
    settings.recipe, settings.device, settings.steps, settings.image_scale = "draft", "cpu", 4, 0.5
    settings.capacity, settings.import_when_done = "fixed", False
    scene = Path(settings.output_path)
    assert bpy.ops.frog.train() == {"FINISHED"}
    task = finish(TrainingTask.current())
    assert not task.error and task.state.step == 4
    before = scene.read_bytes()
    assert bpy.ops.frog.train_longer(steps=8) == {"FINISHED"}
    task = finish(TrainingTask.current())
    assert not task.error and task.state.step == 8
    assert task.state.result == scene.with_name("capture_2.frog") == Path(settings.output_path)
    assert scene.read_bytes() == before


def test_a_full_disk_leaves_no_half_checkpoint(tmp_path):
    done, output = tmp_path / "done.frog", tmp_path / "longer.frog"
    checkpoint_path(done).write_bytes(bytes(2000))
    with file_size_limit(1000), pytest.raises(FrogError, match="the checkpoint could not be copied"):
        TrainingRequest(tmp_path, output, continued=done).copy_checkpoint()
    assert [path.name for path in tmp_path.iterdir()] == [checkpoint_path(done).name]


PANEL = {
    "minutes": 1.5,
    "image_scale": 0.5,
    "max_megabytes": 3.0,
    "key_color": (0, 177 / 255, 64 / 255),
    "pixel_offsets": "-cam=8,-1.5 b=0.001,0",
    "settings": "network_rate=2e-3 sh_growth=0.2,0.4",
}
"""Properties that say in another way what the examples say of their options."""


def test_every_option_is_in_the_panel(empty, capture):
    settings, panels = empty.frog, (train_panel.FROG_PT_train_advanced, train_panel.FROG_PT_train_more)
    said = " ".join(map(drawn, panels)).split()
    assert {"seed", "max_megabytes", "lossless", "save_every", "settings", "device"} <= set(said)
    assert request_of(settings).options == TrainingOptions()
    for option in panel_options():
        name, (value, _) = property_name(option), EXAMPLES[option.name]
        before = getattr(settings, name)
        value = 90.0 if option.name == "seconds" else value
        if option.name == "key":
            settings.masks = "key"
        else:
            setattr(settings, name, PANEL.get(name, value))
        assert request_of(settings).options == TrainingOptions(**{option.name: value}), name
        setattr(settings, name, before)
        settings.masks = "auto"
    settings.pixel_offsets = "cam01"
    refuses("expected CAMERA=DX,DY", bpy.ops.frog.train)
    settings.pixel_offsets, settings.settings = "", "hiden_width=3"
    refuses("the nearest is 'hidden_width'", bpy.ops.frog.train)
