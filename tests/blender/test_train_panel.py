"""What the panel says, and the image in it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from support.training_panel import Written, told

from frog_blender.engine.training.session import events
from frog_blender.training_task import runner
from frog_blender.ui import capture_summary, preview_image, train_panel


@pytest.fixture
def drawn(empty):
    """A function that draws the panel and gives what it says, label lines joined."""

    def draw():
        panel = SimpleNamespace(layout=Written())
        preferences = SimpleNamespace(system=SimpleNamespace(ui_scale=1.0))
        context = SimpleNamespace(scene=empty, region=SimpleNamespace(width=280), preferences=preferences)
        train_panel.FROG_PT_train.draw(panel, context)
        return " ".join(panel.layout.said)

    yield draw
    runner.stop()
    runner.set_current(None)


@pytest.fixture
def capture(tmp_path, monkeypatch):
    """A folder of four filmed cameras."""
    pytest.importorskip("cv2")
    film = pytest.importorskip("support.synthetic_capture")
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    return film.write_capture(tmp_path / "capture")


def test_a_capture_is_described_and_its_training_timed(empty, drawn, capture):
    assert "Roughly" not in drawn()
    empty.frog.capture_folder = str(capture)
    said = drawn()
    assert "Format: n3dv" in said and "4 cameras, 1 held out" in said
    assert "Roughly" in said and "on this processor" in said and "device" in said
    empty.frog.device = "cuda"
    assert "on the GPU: not known before a first training" in drawn()


def test_estimates_follow_what_finished_trainings_took(empty, drawn, capture):
    from frog_blender.engine.training.recipe import recipe
    from frog_blender.engine.training.session.time_estimate import Workload, about, remember

    empty.frog.capture_folder, empty.frog.device = str(capture), "cpu"
    opened = capture_summary.known(bpy.path.abspath(empty.frog.capture_folder)).capture
    work = Workload.of(opened, recipe("standard"))
    remember(work, "cpu", {phase: 7 * seconds for phase, seconds in work.seconds.items()})
    expected = about(7 * sum(work.seconds.values()))
    assert f"About {expected} on this processor, as earlier trainings went." in drawn()


def test_a_running_training(drawn):
    task = told(events.Stage("decoding frames", 3, 10))
    assert "Decoding frames" in drawn() and "frog.train" not in drawn()
    task = told(
        events.Started("frog", 100, 4, 6, 300),
        events.Reduced(30, "120 Gaussians came to rest"),
        events.Progress(40, 100, 12.0, 95.0, 0.0421, 320, 200),
        events.Evaluated(40, 27.5, "held-out"),
    )
    said = drawn()
    for part in ("Step 40 of 100", "1 min 35 s", "0.0421", "27.50 dB (held-out views)", "320 (200 dynamic)"):
        assert part in said
    assert "frog.pause_training frog.cancel_training" in said and "preview_camera" in said
    task.control.pause()
    assert "Paused: Step 40 of 100 frog.resume_training frog.cancel_training" in drawn()


def test_an_ended_training(drawn, tmp_path):
    path = tmp_path / ("a long name " * 8).strip() / "x.frog"
    capacity = {"gaussians": 300, "dynamic": 40, "heads": ["means"], "sh_degree": 1, "reductions": []}
    ended = runner.Ended("")
    told(events.Progress(9, 9, 61.0, 0.0, 0.1, 300), events.Finished(str(path), 9, 61.0, 28.0, 300, capacity), ended)
    said = drawn()
    assert "Finished in 1 min 1 s." in said and "frog.train" in said and "300 (40 dynamic)" in said
    assert f"Saved:{path}".replace(" ", "") in said.replace(" ", "")  # cut into lines, and whole
    told(events.Cancelled(0, None), ended)
    assert "Cancelled before the first step." in drawn()


def pixels():
    icon = preview_image.icons()[preview_image.NAME]
    width, height = icon.image_size
    values = np.empty(width * height, np.int32)
    icon.image_pixels.foreach_get(values)
    return values.view(np.uint8).reshape(height, width, 4)[::-1]


def test_the_image_is_what_training_drew(addon):
    image = np.random.default_rng(0).integers(0, 255, (30, 40, 3), np.uint8)
    preview_image.show(image)
    np.testing.assert_array_equal(pixels()[:, :, :3], image)
    assert (pixels()[:, :, 3] == 255).all()
    preview_image.show(None)
    assert preview_image.icon_id() == 0 and not len(preview_image.icons())


def test_many_images_leave_nothing_behind(addon):
    resource = pytest.importorskip("resource")
    images = [np.full((400, side, 3), 7, np.uint8) for side in (512, 300)]
    data_blocks = len(bpy.data.images)
    for image in images:
        preview_image.show(image)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for turn in range(300):
        preview_image.show(images[turn % 2].copy())  # 250 MB in all
    grown = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    assert grown < (50e6 if bpy.app.build_platform == b"Darwin" else 50e3)
    assert len(preview_image.icons()) == 1 and len(bpy.data.images) == data_blocks
    preview_image.show(None)


def test_switching_off_takes_the_image_away(addon):
    preview_image.show(np.zeros((8, 8, 3), np.uint8))
    addon.unregister()
    try:
        assert preview_image.icons() is None and preview_image.icon_id() == 0
        preview_image.show(np.zeros((8, 8, 3), np.uint8))  # a late one
        assert preview_image.icons() is None
    finally:
        addon.register()


def test_a_preview_reaches_the_panel_by_the_timer(addon):
    image = np.full((9, 12, 3), 200, np.uint8)
    task = runner.begin(lambda control: iter([events.Preview(1, image)]))
    assert task.join(20.0)
    while runner.tick() is not None:
        pass
    np.testing.assert_array_equal(pixels()[:, :, :3], image)
    preview_image.show(None)


def test_the_preview_camera_is_searched_among_the_captures(empty, capture):
    from frog_blender.ui.training_settings import camera_names

    empty.frog.capture_folder = str(capture)
    assert camera_names(empty.frog, None, "") == ["cam00", "cam01", "cam02", "cam03"]  # the held-out one first
    assert camera_names(empty.frog, None, "M02") == ["cam02"]
    task = told(events.Stage("decoding frames", 3, 10))
    empty.frog.preview_camera = "cam02"
    assert task.control.preview_camera == "cam02"
    runner.set_current(None)


def test_presets_keep_how_to_train_and_not_what(empty, tmp_path, monkeypatch):
    folder = tmp_path / "presets" / "frog_blender" / "training"
    monkeypatch.setenv("BLENDER_USER_SCRIPTS", str(tmp_path))
    settings = empty.frog
    settings.recipe, settings.steps, settings.device, settings.capture_folder = "draft", 1234, "cpu", str(tmp_path)
    assert bpy.ops.frog.training_preset_add(name="Quick Look") == {"FINISHED"}
    (written,) = folder.glob("*.py")
    settings.recipe, settings.steps, settings.device = "paper", 0, "auto"
    settings.capture_folder = other = str(tmp_path / "presets")
    name = "FROG_MT_training_presets"
    assert bpy.ops.script.execute_preset(filepath=str(written), menu_idname=name) == {"FINISHED"}
    assert (settings.recipe, settings.steps, settings.device) == ("draft", 1234, "cpu")
    assert Path(settings.capture_folder) == Path(other)
