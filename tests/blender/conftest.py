"""Fixtures for tests inside Blender: the bpy module, or a real Blender through ``run_in_blender.py``."""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).resolve().parents[2]
if str(ROOT) not in sys.path:
    sys.path.insert(0, str(ROOT))

bpy = pytest.importorskip("bpy", reason="needs Blender or the bpy module")


@pytest.fixture(scope="session")
def addon():
    """The add-on, registered once for the whole run."""
    import frog_blender

    frog_blender.register()
    yield frog_blender
    frog_blender.unregister()


@pytest.fixture(autouse=True)
def tasks_of_its_own():
    """No test finds what runs, or has ended, in another one."""
    from frog_blender.tasks import background_task

    yield
    background_task.unregister()
    background_task.register()


@pytest.fixture
def empty(addon):
    """A new file without objects; handlers of the add-on stay, since they are persistent."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    return bpy.context.scene


@pytest.fixture
def new_file(addon):
    """Blender's default scene, with its cube selected."""
    bpy.ops.wm.read_homefile(use_empty=False, use_factory_startup=True)
    return bpy.context.scene


@pytest.fixture
def relative_paths(request):
    """The preference that new paths are relative, which is on where a test says nothing of it."""
    paths = bpy.context.preferences.filepaths
    before, paths.use_relative_paths = paths.use_relative_paths, getattr(request, "param", True)
    yield paths.use_relative_paths
    paths.use_relative_paths = before


@pytest.fixture
def raw(tmp_path, monkeypatch):
    """A folder of four videos and nothing else, and a cache with nothing in it."""
    film = pytest.importorskip("support.synthetic_capture")
    monkeypatch.setenv("FROG_CACHE", str(tmp_path / "cache"))
    folder = film.write_capture(tmp_path / "raw")
    (folder / "poses_bounds.npy").unlink()
    return folder


@pytest.fixture
def static_rig(tmp_path):
    """A .frog file of three fixed cameras: an ordinary one, a portrait one off centre, one with oblong pixels."""
    from support.small_scenes import rig_of_three, write_scene

    return write_scene(tmp_path / "figure.frog", rig_of_three())


@pytest.fixture
def path(static_rig):
    """The file that ``capture`` plays; a file of tests may name another one."""
    return static_rig


@pytest.fixture
def capture(empty, path):
    """The capture of an imported file."""
    from support.small_scenes import imported

    return imported(path)


@pytest.fixture
def moving_rig(tmp_path):
    """A .frog file of one camera that moves and zooms through six images."""
    from support.small_scenes import moving_camera, write_scene

    cameras = moving_camera(6)
    return write_scene(
        tmp_path / "walk.frog", cameras, camera_shots=tuple((frame,) for frame in range(6)), frame_count=6
    )


@pytest.fixture
def rendered(tmp_path):
    """A function that renders the scene's current frame and gives its pixels (H, W, 4) uint8, rows from the top."""

    def render(scene, **settings) -> np.ndarray:
        from support.small_scenes import read_png

        for name, value in settings.items():
            setattr(scene.render, name, value)
        scene.render.image_settings.file_format = "PNG"
        scene.render.image_settings.color_mode = "RGBA"
        scene.render.filepath = str(tmp_path / "still.png")
        bpy.ops.render.render(write_still=True, scene=scene.name)
        return read_png(tmp_path / "still.png")

    return render


@pytest.fixture
def composed(empty, static_rig):
    """A scene of a capture and two cards, one of them in a collection, after the button was pressed."""
    from support.composed_scene import card, collection_in, compose
    from support.small_scenes import imported

    imported(static_rig)
    card(empty.collection, (0.4, 0.0, 0.0))
    card(collection_in(empty.collection, "props"), (-0.5, 0.1, 0.2), color=(0.1, 0.8, 0.2))
    compose(empty)
    return empty


@pytest.fixture
def in_a_window(monkeypatch):
    """A function after which renders run as they do in a window, as if in a thread that must not change the scene."""

    from frog_blender.render.compositing import renders

    def begin():
        monkeypatch.setattr(renders, "in_main_thread", lambda: False)

    return begin
