"""Edits by Gaussian: what playback hands over is what each Gaussian would be, edited one by one."""

from dataclasses import replace

import numpy as np
import pytest
from support.builders import plain_camera, scene_file
from support.played_scenes import TIMES, flickering

from frog_blender.engine.editing.crops import Crop
from frog_blender.engine.editing.edited_scene import EditedScene, edited
from frog_blender.engine.editing.edits import Edits
from frog_blender.engine.editing.grades import Grade
from frog_blender.engine.editing.marks import Marks
from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.playback.frame_delta import column_of
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.playback.render import draw
from frog_blender.engine.spherical_harmonics import SH_DC

GRADE = Grade(exposure=0.5, contrast=1.2, saturation=0.6, temperature=0.4, tint=-0.3, opacity=0.8, size=1.3)


def placed(scale, offset=(0.0, 0.0, 0.0)):
    matrix = np.diag([*np.broadcast_to(scale, 3), 1.0])
    matrix[:3, 3] = offset
    return tuple(matrix.ravel().tolist())


def middle_of(scene):
    """A matrix of the box that holds about half of a scene's Gaussians."""
    means = scene.at(0.5).means
    low, high = np.quantile(means, (0.12, 0.88), axis=0)
    return placed((high - low) / 2, (low + high) / 2)


def by_hand(scene, edits, time):
    """The Gaussians of a scene, edited one after the other in double precision; those of no opacity left out."""
    whole = scene.at(time)
    opacities, scales, sh = (getattr(whole, name).astype(np.float64) for name in ("opacities", "scales", "sh"))
    sh, scales = sh.copy(), scales.copy()
    for grade in edits.grades:
        matrix, offset = grade.colors()
        rows = np.arange(scene.count) if grade.only is None else np.flatnonzero(grade.only.chosen())
        for row in rows:
            color = 0.5 + SH_DC * sh[row, 0]
            sh[row, 0] = (matrix @ color + offset - 0.5) / SH_DC
            sh[row, 1:] = sh[row, 1:] @ matrix.T
            opacities[row] = min(1.0, opacities[row] * grade.opacity)
            scales[row] *= grade.size
    kept = np.ones(scene.count)
    inner = [crop for crop in edits.crops if crop.keep_inside]
    for crops, combine in ((inner, np.maximum), ([c for c in edits.crops if not c.keep_inside], np.multiply)):
        share = None
        for crop in crops:
            points = whole.means if crop.time is None else scene.at(crop.time).means
            share = crop.kept(points) if share is None else combine(share, crop.kept(points))
        kept = kept if share is None else kept * share
    if edits.hidden is not None:
        kept = kept * ~edits.hidden.chosen()
    actual = replace(whole, opacities=opacities * kept, scales=scales, sh=sh)
    shown = np.flatnonzero(kept > 0)
    return actual.part(shown).checked()


def every_edit(scene):
    some = np.random.default_rng(3).random(scene.count) < 0.2
    box = middle_of(scene)
    rest = Grade(exposure=-1, only=Marks.of(scene, ~some))
    return {
        "hidden": Edits(hidden=Marks.of(scene, some)),
        "box": Edits(crops=(Crop("box", box),)),
        "chosen time": Edits(crops=(Crop("sphere", box, time=0.3),)),
        "outside": Edits(crops=(Crop("sphere", box, keep_inside=False, feather=0.3),)),
        "two": Edits(crops=(Crop("box", box, time=1.0), Crop("sphere", box), Crop("box", placed(0.1), False))),
        "moves": Edits(crops=(Crop("box", box, is_still=False, feather=0.2),)),
        "grade": Edits(grades=(GRADE,)),
        "selection": Edits(grades=(replace(GRADE, only=Marks.of(scene, some)), Grade(saturation=0.0))),
        "all": Edits(Marks.of(scene, some), (Crop("box", box),), (GRADE, rest)),
    }


SCENES = {
    "moving": lambda: scene_file(200),
    "partly": lambda: scene_file(200, moving=70, sh_count=9, deformed_sh=4),
    "static colours": lambda: scene_file(120, moving=50, sh_count=16, deformed_sh=0),
    "flickering": flickering,
}


@pytest.mark.parametrize("kind", SCENES)
def test_every_edit_is_that_of_each_gaussian(kind):
    scene = ScenePlayer(SCENES[kind]())
    camera = plain_camera()
    for name, edits in every_edit(scene).items():
        played, dropped = edited(scene, edits)
        assert isinstance(played, EditedScene) and not dropped
        for time in TIMES:
            expected, actual = by_hand(scene, edits, time), played.at(time)
            images = [draw(gaussians, camera, (0.1, 0.2, 0.3)).rgb for gaussians in (expected, actual)]
            assert np.abs(images[0] - images[1]).max() < 2e-4, (name, time)
            assert images[0].std() > 0


@pytest.mark.parametrize("kind", SCENES)
def test_columns_and_parts_are_those_of_the_whole(kind):
    scene = ScenePlayer(SCENES[kind]())
    for name, edits in every_edit(scene).items():
        played = EditedScene(scene, edits)
        for time in TIMES:
            raw = played.source.delta_at(time)
            before = {column: values.copy() for column, values in raw.items()}
            part, whole = played.edited(raw), played.at(time)
            assert tuple(part) == played.changing
            for column, values in raw.items():  # which others may be shown
                np.testing.assert_array_equal(values, before[column])
            joined = played.at(time, part)
            for attribute in ATTRIBUTES:
                np.testing.assert_array_equal(getattr(joined, attribute), getattr(whole, attribute), err_msg=name)
            for column in played.columns:
                np.testing.assert_array_equal(played.column(column, part), column_of(whole, column), err_msg=name)


def test_what_is_hidden_for_good_is_not_played():
    scene = ScenePlayer(scene_file(200, moving=70))
    hidden = np.zeros(200, bool)
    hidden[[0, 5, 90, 199]] = True
    played = EditedScene(scene, Edits(hidden=Marks.of(scene, hidden)))
    assert played.count == 196 and played.num_dynamic == 68
    np.testing.assert_array_equal(played.rows, np.flatnonzero(~hidden))
    far = EditedScene(scene, Edits(crops=(Crop("box", placed(0.01, (50, 0, 0))),)))
    assert far.num_dynamic == 70 and far.count == 70  # what stays is outside at all times
    assert not far.at(0.4).opacities.any()
    nothing = EditedScene(scene, Edits(hidden=Marks.of(scene, np.ones(200, bool))))
    assert nothing.count == 1 and not nothing.at(0.2).opacities.any()
    everywhere = Crop("box", placed(100.0), is_still=False)
    nothing = EditedScene(scene, Edits(Marks.of(scene, np.ones(200, bool)), (everywhere,)))
    assert nothing.count == nothing.num_dynamic == 1 and not nothing.at(0.2).opacities.any()


def test_edits_of_a_part_are_those_of_its_gaussians():
    scene = ScenePlayer(scene_file(200, moving=70))
    edits = every_edit(scene)["all"]
    kept = np.arange(0, 200, 3)
    part, whole = EditedScene(scene.subset(kept), edits), EditedScene(scene, edits)
    both = np.isin(whole.rows, kept)
    np.testing.assert_array_equal(whole.rows[both], part.rows)
    for name in ATTRIBUTES:
        np.testing.assert_allclose(getattr(part.at(0.3), name), getattr(whole.at(0.3), name)[both], atol=1e-6)


def test_a_crop_that_moves_brings_back_what_others_do_not_keep():
    scene = ScenePlayer(scene_file(100, moving=40))
    still, moving = Crop("box", middle_of(scene)), Crop("box", placed(100.0), is_still=False)
    before = EditedScene(scene, Edits(crops=(still,)))
    after = EditedScene(scene, Edits(crops=(still, moving)), before)
    assert before.count < after.count == 100
    assert EditedScene(scene, Edits(crops=(still,)), after).count == before.count


def test_marks_of_another_scene_are_said_and_dropped():
    scene, other = ScenePlayer(scene_file(100)), ScenePlayer(scene_file(100, seed=1))
    longer = ScenePlayer(scene_file(120))
    marks = [Marks.of(player, np.ones(player.count, bool)) for player in (other, longer)]
    edits = Edits(marks[0], (), (Grade(exposure=1, only=marks[1]), Grade(exposure=0.5)))
    played, dropped = edited(scene, edits)
    assert len(dropped) == 2 and "another training" in dropped[0] and "120 Gaussians" in dropped[1]
    assert played.edits == Edits(grades=(Grade(exposure=0.5),))
    assert edited(scene, Edits(marks[0]))[0] is edited(scene, Edits(grades=(Grade(),)))[0] is scene


def test_grey_keeps_its_luma_under_white_balance_and_saturation():
    for grade in (Grade(temperature=1.0, tint=-0.7), Grade(saturation=0.2), Grade(saturation=2.0, temperature=0.5)):
        matrix, offset = grade.colors()
        assert (matrix @ np.full(3, 0.4) + offset) @ (0.2126, 0.7152, 0.0722) == pytest.approx(0.4)
    matrix, offset = Grade(contrast=1.7).colors()
    np.testing.assert_allclose(matrix @ np.full(3, 0.5) + offset, 0.5)
