"""Density: the most important Gaussians, the same at every frame, in viewports and other engines' renders alone."""

import bpy
import numpy as np
import pytest
from support.observed_players import observed
from support.small_scenes import rig_of_three, write_scene

from frog_blender import point_cloud
from frog_blender.engine.playback.importance import most_important, ranking
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.render.collect_instances import gather
from frog_blender.timeline.render_thread import rendering


@pytest.fixture
def path(tmp_path):
    return write_scene(tmp_path / "many.frog", rig_of_three(), count=400)


class CountingEngine(bpy.types.RenderEngine):
    """Renders nothing, and remembers how many points it was given."""

    bl_idname, bl_label = "FROG_TEST_COUNT", "Count"
    seen: list[int] = []

    def render(self, depsgraph):
        clouds = [i.object.data for i in depsgraph.object_instances if i.object.type == "POINTCLOUD"]
        self.seen.append(sum(len(cloud.points) for cloud in clouds))


@pytest.fixture
def counting(capture):
    bpy.utils.register_class(CountingEngine)
    CountingEngine.seen.clear()
    yield CountingEngine.seen
    bpy.utils.unregister_class(CountingEngine)


def kept_of(path, count):
    scene = ScenePlayer.load(path)
    return scene, most_important(ranking(scene), count)


def test_the_same_most_important_ones_at_every_frame(empty, capture, path):
    capture.frog.density, computed = 25, []
    scene, kept = kept_of(path, 100)
    with observed(computing=lambda player, time: computed.append(player.count)):
        empty.frame_set(2)
        computed.clear()  # to find which are important, all are
        empty.frame_set(5, subframe=0.3)
        assert computed and set(computed) == {100}, "what is left out is not computed"
    for frame in (3, 9, 1, 6):
        empty.frame_set(frame)
        shown, all_of_them = point_cloud.read(capture), scene.at_frame(frame - 1)
        np.testing.assert_allclose(shown["position"], all_of_them.means[kept], atol=1e-5)
        np.testing.assert_allclose(shown["rotation"], all_of_them.quaternions[kept], atol=1e-5)
        np.testing.assert_allclose(shown["radiance:base"][:, 3], all_of_them.opacities[kept], atol=1e-5)
        np.testing.assert_allclose(shown["radiance:sh_2"], all_of_them.sh[kept, 3], atol=1e-5)


def test_frog_draws_all_of_them(empty, capture, rendered):
    before = rendered(empty)
    capture.frog.density = capture.frog.render_density = 5
    np.testing.assert_array_equal(rendered(empty), before)
    gaussians, _ = gather(bpy.context.evaluated_depsgraph_get())
    assert len(gaussians.means) == 400


def test_renders_of_other_engines_have_their_own(empty, capture, counting):
    empty.render.engine = CountingEngine.bl_idname
    capture.frog.density, capture.frog.render_density = 10, 75
    bpy.ops.render.render()
    assert counting == [300] and point_cloud.count(capture) == 40
    empty.frame_start, empty.frame_end = 2, 4
    bpy.ops.render.render(animation=True)
    assert counting == [300] * 4 and point_cloud.count(capture) == 40
    capture.frog.render_density = 10
    bpy.ops.render.render()
    assert counting[-1] == 40 and not rendering().has_render_density


def test_a_new_version_of_the_file(empty, capture, path):
    capture.frog.density = 50
    write_scene(path, rig_of_three(), count=90, seed=5)
    empty.frame_set(3)
    scene, kept = kept_of(path, 45)
    np.testing.assert_allclose(point_cloud.read(capture)["position"], scene.at_frame(2).means[kept], atol=1e-5)
