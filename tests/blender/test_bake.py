"""Baked playback: written whole or not at all, read back bit for bit, and never trusted blindly."""

import bpy
import numpy as np
import pytest
from support.blender_windows import in_window
from support.observed_players import observed
from support.small_scenes import imported, plays, rig_of_three, shows, write_scene

from frog_blender import point_cloud
from frog_blender.engine.errors import FrogError
from frog_blender.engine.playback.importance import most_important, ranking
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import read_scene
from frog_blender.engine.scene.scene_file import write_scene as write_file
from frog_blender.operators import bake
from frog_blender.timeline import open_scenes, playback, playback_cache


@pytest.fixture(autouse=True)
def forgotten():
    """No bake stays open."""
    yield
    open_scenes.forget()


def leftovers(folder):
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


@pytest.fixture
def computed():
    """The times that the network is asked for from now on."""
    times = []
    with observed(computing=lambda player, time: times.append(time)):
        yield times


def test_baked_frames_need_no_network_until_the_bake_is_deleted(empty, capture, static_rig, computed):
    assert bpy.ops.frog.bake() == {"FINISHED"}
    path = static_rig.with_suffix(".frogbake")
    assert path.stat().st_size > 10 * 60 * 14 * 4 and not leftovers(path.parent)
    playback_cache.clear()
    empty.frame_set(2)
    bake, problem = playback.used_bake(capture)
    assert len(bake) == 10 and problem == ""
    expected = {frame: ScenePlayer.load(static_rig).at_frame(frame - 1.0) for frame in (7, 3, 10)}
    computed.clear()
    for frame, gaussians in expected.items():
        empty.frame_set(frame)
        for name, values in gaussians.arrays.items():
            np.testing.assert_array_equal(getattr(playback.scene_time(capture, frame).gaussians(), name), values)
    assert computed == []
    plays(capture, static_rig, 4, 9)
    plays(capture, static_rig, 4.5)  # not baked, computed
    assert bpy.ops.frog.clear_bake() == {"FINISHED"}
    assert not path.exists() and playback.used_bake(capture)[0] is None
    with pytest.raises(RuntimeError, match="could not be deleted"):
        bpy.ops.frog.clear_bake()
    plays(capture, static_rig, 5)


def test_every_object_of_the_file_and_its_own_time_is_baked(empty, capture, static_rig, tmp_path):
    twin = capture.copy()
    empty.collection.objects.link(twin)
    twin.frog.speed, twin.frog.repeat = 0.5, "PING_PONG"
    capture.frog.bake_folder = twin.frog.bake_folder = str(tmp_path / "bakes")
    bpy.ops.frog.bake(object_name=capture.name)
    assert (tmp_path / "bakes" / "figure.frogbake").is_file()
    assert not list(tmp_path.glob("*.frogbake"))
    baked = playback.scene_time(twin, 2.0).bake
    assert len(baked) == 10 + 5 and baked.find(playback.scene_time(twin, 2.0).time) is not None


def test_a_bake_of_another_version_is_not_used_and_said_once(empty, capture, static_rig, capfd):
    bpy.ops.frog.bake()
    write_scene(static_rig, rig_of_three(), seed=9)  # the same size and shapes
    plays(capture, static_rig, 3, 4)
    bake, problem = playback.used_bake(capture)
    assert "another version of figure.frog" in problem and bake is None
    assert capfd.readouterr().err.count("another version") == 1
    bpy.ops.frog.bake()
    empty.frame_set(5)
    bake, problem = playback.used_bake(capture)
    assert problem == "" and bake is not None
    shows(capture, static_rig, 4.0)


@pytest.mark.parametrize("length", [None, -1], ids=["nonsense", "cut short"])
def test_a_damaged_bake_is_one_sentence_and_frames_are_computed(empty, capture, static_rig, capfd, length):
    bpy.ops.frog.bake()
    path = static_rig.with_suffix(".frogbake")
    content = path.read_bytes()
    playback_cache.clear()
    path.write_bytes(content[:length] if length else b"nonsense" * 40)
    plays(capture, static_rig, 3, 4)
    _, problem = playback.used_bake(capture)
    assert problem.startswith(str(path)) and problem.endswith(".") and len(problem) < 600
    assert capfd.readouterr().err.count(str(path)) == 1


def test_a_bake_that_is_cut_while_it_is_open(empty, capture, static_rig):
    bpy.ops.frog.bake()
    empty.frame_set(2)
    playback_cache.clear()
    path = static_rig.with_suffix(".frogbake")
    baked, _ = playback.used_bake(capture)
    with path.open("r+b") as file:
        file.truncate(path.stat().st_size // 3)
    assert baked.find(1.0) is None and "was changed" in baked.problem
    plays(capture, static_rig, 10)


@pytest.fixture
def full():
    """Once something is in it, a frame that is computed finds a full disk."""
    full = []

    def computing(player, time):
        if full:
            raise OSError(28, "No space left on device")

    with observed(computing):
        yield full


@pytest.mark.parametrize("ending", ["stopped", "fails", "file changed"])
def test_a_bake_that_does_not_end_well_leaves_the_one_before(empty, capture, static_rig, full, ending):
    bpy.ops.frog.bake()
    path = static_rig.with_suffix(".frogbake")
    before = path.read_bytes()
    empty.frame_end = 5
    _, steps, total = bake.begin_bake(capture, empty)
    assert total == 5 and leftovers(path.parent) == []
    assert [next(steps), next(steps)] == [0, 1]
    assert len(leftovers(path.parent)) == 1
    if ending == "stopped":
        steps.close()
    elif ending == "fails":
        full.append(True)
        with pytest.raises(FrogError, match="No space left"):
            list(steps)
    else:
        write_scene(static_rig, rig_of_three(), seed=2)
        with pytest.raises(FrogError, match="another version"):
            list(steps)
    assert leftovers(path.parent) == [] and path.read_bytes() == before


def test_too_large_a_bake_is_refused_before_it_begins(empty, tmp_path):
    path = write_scene(tmp_path / "many.frog", rig_of_three(), count=3000)
    imported(path).frog.bake_megabytes = 1
    with pytest.raises(RuntimeError, match=r"many.frogbake: 10 frames need 2 MB, the limit is 1 MB"):
        bpy.ops.frog.bake()
    assert not path.with_suffix(".frogbake").exists()


def test_in_a_window_a_bake_is_stopped(empty, capture, static_rig):
    with in_window(bake.FROG_OT_bake) as window:
        assert bpy.ops.frog.bake() == {"RUNNING_MODAL"}
        assert window.send(times=4) == {"PASS_THROUGH"}
        assert len(leftovers(static_rig.parent)) == 1
        assert window.send("ESC", "PRESS") == {"CANCELLED"} and window.operator.timer is None
        assert not static_rig.with_suffix(".frogbake").exists() and not leftovers(static_rig.parent)
        assert window.said == [("INFO", "Baking was stopped. Nothing was written.")]


def of_which_move(path, moving):
    """A scene whose first Gaussians move and whose others stand, as training leaves them."""
    scene = read_scene(write_scene(path, rig_of_three()))
    scene.arrays["embeddings"] = scene.arrays["embeddings"][:moving]
    write_file(path, scene)
    return imported(path)


@pytest.mark.parametrize(("share", "moving"), [(100, 25), (15, 60)])
def test_a_thinned_capture_takes_its_share_of_the_bake(empty, tmp_path, computed, share, moving):
    """The most important ones of the whole frame, to the bit, without the network."""
    capture = of_which_move(tmp_path / "part.frog", moving)
    capture.frog.density = share
    whole, fewer = playback.scene_time(capture, 1.0).scene, playback.displayed(capture, 1.0).scene
    kept = most_important(ranking(whole), round(60 * share / 100))
    expected = {frame: whole.at_frame(frame - 1) for frame in (4, 9)}
    assert fewer.count == len(kept) and fewer.num_dynamic == (kept < moving).sum() > 0
    assert not np.array_equal(expected[4].means[kept], expected[9].means[kept])
    bpy.ops.frog.bake()
    playback_cache.clear()
    empty.frame_set(2)
    computed.clear()
    for frame, gaussians in expected.items():
        empty.frame_set(frame)
        shown = point_cloud.read(capture)
        np.testing.assert_array_equal(shown["position"], gaussians.means[kept])
        np.testing.assert_array_equal(shown["rotation"], gaussians.quaternions[kept])
        np.testing.assert_array_equal(shown["radiance:base"][:, 3], gaussians.opacities[kept])
    assert computed == []
    kept_frames = playback_cache.frames()
    assert kept_frames.bytes == len(kept_frames) * fewer.delta_bytes, "no more is kept than shown"
