"""Settings that no panel lets one make, but a file, a driver or a curve can: said once, and the timeline goes on."""

import math

import bpy
import pytest
from support.observed_players import observed
from support.small_scenes import rig_of_three, shows, write_scene

from frog_blender import reported_once
from frog_blender.timeline import playback, prefetch, retiming


def raw(group, name, value):
    """Writes past the limits that RNA holds."""
    owner = group.id_data
    if hasattr(owner, "bl_system_properties_get"):
        owner.bl_system_properties_get(do_create=True)["frog"][name] = value
    else:
        group[name] = value


@pytest.fixture
def captures(empty, static_rig, tmp_path):
    """Two, of which the first will have absurd settings."""
    other = write_scene(tmp_path / "other.frog", rig_of_three(), seed=3)
    for path in (static_rig, other):
        bpy.ops.import_scene.frog(filepath=str(path))
    bad, good = sorted(playback.captures(empty.objects), key=lambda obj: obj.frog.filepath != str(static_rig))
    bad.frog.speed, bad.frog.speed = 2.0, 1.0  # so that all of it is stored
    return bad, good


ABSURD = [
    *(("start_frame", value) for value in (math.nan, -3e38)),
    *(("speed", value) for value in (math.inf, 0.0)),
    ("density", -(2**31)),
    ("render_density", 2**31 - 1),
    ("repeat", 77),
    ("display", 1),  # of earlier versions
    ("bake_folder", "//bakes"),
]


@pytest.mark.parametrize(("name", "value"), ABSURD, ids=lambda value: str(value)[:12])
def test_the_timeline_goes_on(empty, captures, static_rig, capfd, name, value):
    bad, good = captures
    raw(bad.frog, name, value)
    reported_once.forget()
    capfd.readouterr()
    for frame in (2, 3, 4, 5):
        empty.frame_set(frame)
        prefetch.prefetch(empty)
        shows(good, good.frog.filepath, frame - 1.0)
    err = capfd.readouterr().err
    assert "Traceback" not in err, err
    assert err.count("not a number") == (1 if not math.isfinite(value if isinstance(value, float) else 0.0) else 0), err


@pytest.mark.parametrize("how", ["remap", "curve", "start"])
def test_no_number_is_a_sentence_in_a_render(empty, captures, capfd, rendered, how):
    bad, _ = captures
    bad.frog.use_remap = how != "start"
    if how == "curve":
        bad.frog.keyframe_insert("shown_frame", frame=1)
        (curve,) = retiming.curves(bad.animation_data)
        curve.keyframe_points[0].co[1] = math.nan
    else:
        raw(bad.frog, "shown_frame" if how == "remap" else "start_frame", math.nan)
    reported_once.forget()
    for frame in (2, 3):
        empty.frame_set(frame)
    assert capfd.readouterr().err.count(bad.name) == 1
    with pytest.raises(RuntimeError, match="not a number"):
        rendered(empty)
    bpy.data.objects.remove(bad)
    assert rendered(empty).any(), "the next render is a render again"


def test_something_unforeseen_in_one_capture_holds_up_no_other(empty, captures, capfd):
    bad, good = captures

    def fails(player, time):
        if player.path == playback.file_of(bad):
            raise ZeroDivisionError("of some kind")

    reported_once.forget()
    with observed(computing=fails):
        for frame in (3, 5):
            empty.frame_set(frame)
    shows(good, good.frog.filepath, 4.0)
    assert capfd.readouterr().err.count("ZeroDivisionError: of some kind") == 1
