"""Clean Up and selections: what hangs alone and what no image shows goes, and surfaces that one camera sees stay."""

from dataclasses import replace
from unittest.mock import MagicMock

import numpy as np
import pytest
from support.builders import blobs, looking_at, scene_file, still_scene

from frog_blender.engine.editing import selections
from frog_blender.engine.editing.clean_up import clean_up, floaters
from frog_blender.engine.editing.clusters import clusters
from frog_blender.engine.editing.selections import seen_box, seen_by
from frog_blender.engine.graphs import components
from frog_blender.engine.io.child_process import Stopped
from frog_blender.engine.playback.importance import camera_weights
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import SceneFile

LENS = np.array([[60.0, 0, 32], [0, 60.0, 24], [0, 0, 1]])


def camera(name, x, turn=0.0):
    """Looks along y from y = -4, turned about z."""
    return looking_at(name, (x, -4.0, 0.0), (64, 48), LENS, (x + np.sin(turn), -4.0 + np.cos(turn), 0.0))


def wall(low, high, y, step):
    """Gaussians side by side."""
    points = np.mgrid[low[0] : high[0] : step, y : y + 1e-3, low[1] : high[1] : step].reshape(3, -1).T
    return points, np.full((len(points), 3), step / 2), np.full(len(points), 0.95)


@pytest.fixture(scope="module")
def room():
    """A wall that three cameras see, one beside it that the last alone sees, fog behind, and floaters."""
    parts = [
        wall((-2, -1.5), (2, 1.5), 0.0, 0.08),
        wall((6, -1), (8, 1), 3.0, 0.08),  # far beside, seen by the turned camera alone
        wall((-1, -1), (1, 1), 5.0, 0.1),  # behind the wall: no camera sees it
        (np.array([[0.2, -2.0, 1.6], [30.0, 40.0, 20.0], [-9.0, 14.0, 9.0]]), np.full((3, 3), 0.02), np.full(3, 0.27)),
    ]
    means, scales, opacities = (np.concatenate(values) for values in zip(*parts, strict=True))
    colors = np.random.default_rng(0).uniform(0.2, 0.8, (len(means), 3))
    cameras = (camera("a", -0.4), camera("b", 0.4), camera("c", 0.0, 0.75))
    return ScenePlayer(still_scene(blobs(means, scales, colors=colors, opacities=opacities), cameras))


def parts_of(room):
    """Which Gaussians are the shared wall, the wall beside, the one behind, and alone."""
    means = room.at(0.0).means
    alone = np.arange(room.count) >= room.count - 3
    return means[:, 1] < 0.1, (means[:, 0] > 5) & ~alone, np.isclose(means[:, 1], 5.0) & ~alone, alone


def test_fog_and_floaters_go_and_what_one_camera_sees_stays(room):
    actual = clean_up(room, 0.5)
    wall, beside, behind, alone = parts_of(room)
    assert not actual.hidden[wall & ~alone].any()
    assert actual.hidden[beside].mean() < 0.1  # the edge that its neighbours hide
    assert actual.hidden[behind].mean() > 0.9 and actual.hidden[alone].sum() >= 2
    assert actual.floaters + actual.unmissed == actual.hidden.sum()
    assert not clean_up(room, 0.0).hidden.any()


def test_what_single_cameras_see_is_counted(room):
    weights = camera_weights(room)
    assert weights.shape == (3, room.count)
    few, (wall, beside, behind, _) = selections.by_cameras(weights, 2), parts_of(room)
    assert (seen_by(weights)[beside] == 1).mean() > 0.9 and few[behind].all() and few[wall].mean() < 0.4
    low, high = seen_box(room, weights)
    inside = ((room.at(0.0).means >= low) & (room.at(0.0).means <= high)).all(axis=1)
    assert inside[weights.any(axis=0)].all() and inside[beside].any() and not inside.all()


def test_clusters_are_what_touches():
    many = blobs([[0.0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [5.0, 0, 0], [5.1, 0, 0], [9.0, 9, 9]], 0.05, opacities=1.0)
    actual = clusters(many)
    assert actual[0] == actual[1] == actual[2] and actual[3] == actual[4]
    assert len(set(actual)) == 3
    order = np.random.default_rng(0).permutation(6)
    other = clusters(many.part(order))
    np.testing.assert_array_equal(other[:, None] == other, (actual[:, None] == actual)[order][:, order])


def test_floaters_of_a_scene_without_cameras_are_found(room):
    bare = ScenePlayer(SceneFile(replace(room.header, cameras=(), camera_shots=()), room._arrays))
    actual = clean_up(bare, 0.5)
    np.testing.assert_array_equal(actual.hidden, floaters(bare))
    assert actual.hidden[parts_of(room)[3]].all() and actual.unmissed == 0


def test_selections_are_what_they_say():
    scene = ScenePlayer(scene_file(300, moving=100))
    states = [scene.at(time) for time in (0.0, 0.5, 1.0)]
    np.testing.assert_array_equal(
        selections.by_opacity(scene, 0.5), np.max([state.opacities for state in states], 0) <= 0.5
    )
    np.testing.assert_array_equal(
        selections.by_size(scene, 0.2), np.max([state.scales.max(1) for state in states], 0) >= 0.2
    )
    assert selections.dynamic(scene).sum() == 100
    far = selections.by_distance(scene, np.zeros(3), 3.0, 0.5)
    np.testing.assert_array_equal(far, np.linalg.norm(states[1].means, axis=1) >= 3.0)


def test_a_selection_grows_and_shrinks_by_what_is_near():
    scene = ScenePlayer(scene_file(300))
    means = scene.at(0.5).means.astype(np.float64)
    few, half = np.isin(np.arange(300), [3, 60]), means[:, 0] > np.median(means[:, 0])
    for reach in (0.0, 1e-9, 0.2, 0.7, 100.0):
        for chosen in (few, half):
            near, far = (np.linalg.norm(means[:, None] - means[some], axis=2).min(1) for some in (chosen, ~chosen))
            np.testing.assert_array_equal(selections.grown(scene, chosen, reach, 0.5), near <= reach)
            np.testing.assert_array_equal(~selections.grown(scene, ~chosen, reach, 0.5), far > reach)
    assert not selections.grown(scene, np.zeros(300, bool), 1.0).any(), "nothing is near nothing"


def test_growing_tells_how_far_it_is_and_can_be_stopped(monkeypatch):
    monkeypatch.setattr(selections, "_AT_ONCE", 50)
    scene, told = ScenePlayer(scene_file(300)), []
    chosen = np.arange(300) < 5
    grown = selections.grown(scene, chosen, 0.5, 0.0, told.append)
    assert told == [index / 6 for index in range(6)]
    np.testing.assert_array_equal(grown, selections.grown(scene, chosen, 0.5))
    with pytest.raises(Stopped):
        selections.grown(scene, chosen, 0.5, 0.0, MagicMock(side_effect=Stopped))


@pytest.mark.parametrize("pairs", [0, 150, 400, 3000])
def test_components_are_what_pairs_connect_and_no_part_of_them_takes_long(pairs, monkeypatch):
    monkeypatch.setattr("frog_blender.engine.graphs._PAIRS_AT_ONCE", 64)
    starts, ends = np.random.default_rng(pairs).integers(0, 400, (2, pairs))
    expected = np.arange(400)
    for start, end in zip(starts, ends, strict=True):
        expected[expected == expected[end]] = expected[start]
    found = components(starts, ends, 400)
    same = expected[:, None] == expected
    np.testing.assert_array_equal(found[:, None] == found, same)
    assert set(found) == set(range(len(set(expected))))
