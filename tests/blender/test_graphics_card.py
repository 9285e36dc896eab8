"""F12 by an NVIDIA card with torch, found while the processor draws. The card is pretended: there is none here."""

from functools import partial
from pathlib import Path

import bpy
import numpy as np
import pytest
from support.exr import render_channels

from frog_blender import addon_state
from frog_blender.engine.cuda import launch
from frog_blender.engine.native.binding import Frame
from frog_blender.engine.playback.painter import painter
from frog_blender.ui import graphics_card

devices = pytest.importorskip("frog_blender.engine.training.optimize.device", reason="needs torch")
cuda_frame = pytest.importorskip("frog_blender.engine.rasterizer.cuda_frame", reason="needs torch")


@pytest.fixture
def found(addon, monkeypatch):
    """What is told of the search for a card, which begins with the first frame; of the painter that is used after."""
    told = []
    monkeypatch.setattr(graphics_card, "_AFTER", 0.0)
    monkeypatch.setattr(graphics_card, "has_nvidia_gpu", lambda: told.append("looked") or True)
    graphics_card.unregister()
    graphics_card.register()
    yield told
    monkeypatch.undo()
    graphics_card.unregister()
    graphics_card.register()


def ready():
    return addon_state.get(graphics_card._Card).worker.wait(20.0)


def test_frames_are_drawn_by_the_card_once_it_is_ready(empty, capture, rendered, found, monkeypatch):
    def hand_over(name):
        painter().gpu = lambda *drawing: found.append("drawn") or Frame(*drawing)
        return ""

    monkeypatch.setattr(devices, "draw_frames_on", hand_over)
    first = rendered(empty)
    assert ready() and found == ["looked"]
    np.testing.assert_array_equal(rendered(empty), first)
    assert found == ["looked", "drawn"] and first.std() > 10.0


def test_what_is_wrong_with_a_card_is_told_and_the_processor_goes_on(
    empty, capture, rendered, found, monkeypatch, capfd
):
    def refuse(device):
        raise RuntimeError("no kernel image is available")

    monkeypatch.setattr(devices, "first_gpu", lambda: devices.torch.device("cuda", 0))
    monkeypatch.setattr(devices, "try_frames", refuse)
    first = rendered(empty)
    assert ready() and painter().gpu is None
    np.testing.assert_array_equal(rendered(empty), first)
    assert capfd.readouterr().err.count("left aside for the CPU: no kernel image is available") == 1


def fail():
    raise OSError("the file system is gone")


@pytest.mark.parametrize(
    ("name", "found_out"),
    [("torch_needed", lambda: "Training needs torch."), ("has_nvidia_gpu", lambda: False), ("has_nvidia_gpu", fail)],
    ids=["no torch", "no card", "an error"],
)
def test_where_something_lacks_nothing_is_loaded(empty, capture, rendered, found, monkeypatch, name, found_out):
    monkeypatch.setattr(graphics_card, name, found_out)
    monkeypatch.setattr(devices, "draw_frames_on", lambda name: found.append("loaded"))
    rendered(empty)
    assert ready() and "loaded" not in found and painter().gpu is None


def test_every_pass_of_f12_is_what_the_processor_draws(empty, capture, found, monkeypatch, tmp_path):
    """By the CUDA kernels, emulated: objects before splats, a lens, and all passes."""
    monkeypatch.syspath_prepend(Path(__file__).parents[1] / "cuda" / "emulator")
    import emulated

    if emulated.COMPILER is None:
        pytest.skip("the emulator compiles the kernels with g++ on Linux; there is none here")
    emulator = emulated.Emulator(tmp_path)
    monkeypatch.setattr(launch, "launcher_for", lambda device: emulator)
    layer, lens = bpy.context.view_layer, empty.camera.data.dof
    layer.use_pass_z = layer.use_pass_vector = layer.use_pass_object_index = True
    bpy.ops.mesh.primitive_cube_add(size=0.6)
    capture.pass_index, lens.use_dof, lens.aperture_fstop = 7, True, 0.05
    empty.frog.hold_out, empty.frog.lens_samples = True, 3
    empty.frame_set(4)
    expected = render_channels(empty, tmp_path / "processor.exr")
    assert not emulator.launched
    painter().gpu = partial(cuda_frame.fill, devices.torch.device("cpu"))
    drawn = render_channels(empty, tmp_path / "card.exr")
    assert len(emulator.launched) > 20 and drawn.keys() == expected.keys()
    for name, values in expected.items():
        assert values.std() > 0.01 or name.endswith(".A"), name
        assert np.isclose(drawn[name], values, rtol=1e-4, atol=1e-4).mean() > 0.999, name
