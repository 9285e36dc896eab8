"""A scene of segments plays what each segment's own scene plays, in that segment's frames."""

from __future__ import annotations

import threading
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from support import segmented
from support.builders import ATTRIBUTES

from frog_blender.engine.capture.time import frame_to_time
from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import GaussianArrays
from frog_blender.engine.playback.importance import ranking
from frog_blender.engine.playback.player import ScenePlayer, select_gaussians
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.dynamics import ONLY_FADES, STATIC, dynamics_of
from frog_blender.engine.scene.scene_file import SceneFile, read_scene, write_scene
from frog_blender.engine.scene.segment_parts import part_of
from frog_blender.engine.scene.segments import SEGMENTS, rows_of, seen_at, segments_of, share_of

FRAMES = 15


@pytest.fixture(scope="module")
def scene() -> SceneFile:
    return segmented.joined()


def seen(gaussians: GaussianArrays) -> set[bytes]:
    """The rows that are not transparent."""
    rows = np.concatenate([getattr(gaussians, name).reshape(len(gaussians), -1) for name in ATTRIBUTES], axis=1)
    return {row.tobytes() for row in rows[gaussians.opacities > 0]}


@pytest.mark.parametrize("number", range(3))
@pytest.mark.parametrize("offset", [-0.45, 0.0, 0.25, 0.45])
def test_each_segment_plays_as_its_own_scene_does(scene: SceneFile, number: int, offset: float) -> None:
    """Where no other one is seen."""
    part, whole, segments = segmented.parts()[number], ScenePlayer(scene), segments_of(scene.header.model)
    own, alone = ScenePlayer(part.scene), 0
    for frame in np.arange(part.first, part.first + part.frames) + offset:
        if not 0 <= frame <= FRAMES - 1 or len(seen_at(segments, frame)) > 1:
            continue
        alone += 1
        expected = seen(own.at_frame(float(frame) - part.trained_first))
        assert seen(whole.at_frame(float(frame))) == expected and len(expected) > segmented.SHARED
    assert alone


def test_at_a_seam_one_becomes_the_other(scene: SceneFile) -> None:
    segments = segments_of(scene.header.model)
    assert seen_at(segments, 4.5) == {1: 0.5, 0: 0.5}
    assert seen_at(segments, 2.9) == {0: 1.0} and seen_at(segments, 6.1) == {1: 1.0}
    shares = [seen_at(segments, frame) for frame in np.arange(3.05, 6, 0.1)]
    assert all(sum(share.values()) == pytest.approx(1) for share in shares)
    steps = np.diff([share[1] for share in shares])
    assert (steps > 0).all() and steps.max() < 0.04


def test_two_shares_are_as_opaque_as_the_whole() -> None:
    opacities = np.array([0.0, 0.01, 0.5, 0.99, 1.0], np.float32)
    one, other = share_of(opacities, 0.3), share_of(opacities, 0.7)
    np.testing.assert_allclose(1 - (1 - one) * (1 - other), opacities, atol=1e-6)
    assert share_of(opacities, 1.0) is opacities and share_of(opacities, 0.5).dtype == np.float32


def test_without_frames_that_both_know_there_is_a_cut(scene: SceneFile) -> None:
    own = [
        replace(each, trained_first=each.first, trained_frames=each.frames) for each in segments_of(scene.header.model)
    ]
    assert [seen_at(tuple(own), frame) for frame in (4, 4.49, 4.51, 5)] == [{0: 1.0}, {0: 1.0}, {1: 1.0}, {1: 1.0}]


def test_images_change_little_at_a_seam(scene: SceneFile) -> None:
    player, camera = ScenePlayer(scene), scene.header.cameras[1]
    images = [draw(player.at_frame(frame), camera).rgb for frame in np.arange(2, 8, 0.05)]
    steps = [float(np.abs(one - other).mean()) for one, other in pairwise(images)]
    assert max(steps) < 6 * float(np.median(steps))


def test_a_packed_file_draws_the_same(scene: SceneFile, tmp_path: Path) -> None:
    write_scene(tmp_path / "joined.frog", scene, compact=True)
    read = read_scene(tmp_path / "joined.frog")
    assert read.header.format_version == 6 and read.header.model == scene.header.model
    one, other = ScenePlayer(scene), ScenePlayer(read)
    for frame in (0, 4, 5, 12):
        images = [draw(each.at_frame(frame), scene.header.cameras[1]).rgb for each in (one, other)]
        assert np.abs(images[0] - images[1]).max() < 0.05 and images[0].any()


def test_delta_at_equals_at_in_any_order(scene: SceneFile) -> None:
    player, again = ScenePlayer(scene), ScenePlayer(scene)
    for frame in (2, 9, 0, 13, 4.4, 4.6, 10.5, 3):
        time = frame_to_time(frame, FRAMES)
        joined, direct = player.at(time, again.delta_at(time)), again.compute(time)
        for name in ATTRIBUTES:
            assert np.array_equal(getattr(joined, name), getattr(direct, name)), (frame, name)


def test_frames_do_not_depend_on_what_was_played_before(scene: SceneFile) -> None:
    fresh = {frame: ScenePlayer(scene).compute(frame_to_time(frame, FRAMES)) for frame in range(FRAMES)}
    player, wrong = ScenePlayer(scene), []

    def play(seed: int) -> None:
        for frame in np.random.default_rng(seed).integers(0, FRAMES, 60).tolist():
            found = player.compute(frame_to_time(frame, FRAMES))
            wrong.extend(n for n in ATTRIBUTES if not np.array_equal(getattr(found, n), getattr(fresh[frame], n)))

    threads = [threading.Thread(target=play, args=(seed,)) for seed in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert not wrong


def test_others_are_unseen(scene: SceneFile) -> None:
    player, rows = ScenePlayer(scene), rows_of(segments_of(scene.header.model))
    early, late = (player.at_frame(frame).opacities for frame in (2, 8))
    assert early[rows[0].deformed].any() and early[rows[0].still].all() and not early[rows[1].deformed].any()
    assert late[rows[1].deformed].any() and not late[rows[0].deformed].any() and not late[rows[0].still].any()


@pytest.mark.parametrize("which", ["every other", "one segment", "still", "shared"])
def test_a_part_of_its_gaussians_plays_as_in_the_whole(scene: SceneFile, which: str) -> None:
    rows, count = rows_of(segments_of(scene.header.model)), len(scene.arrays["means"])
    kept = {
        "every other": np.arange(0, count, 2),
        "one segment": np.arange(rows[1].deformed.start, rows[1].deformed.stop),
        "still": np.arange(rows[0].still.start, rows[2].still.stop),
        "shared": np.arange(rows[2].still.stop, count),
    }[which]
    part, whole = ScenePlayer(scene).subset(kept), ScenePlayer(scene)
    for frame in (1, 7, 13):
        for name in ATTRIBUTES:
            one, other = getattr(part.at_frame(frame), name), getattr(whole.at_frame(frame), name)[kept]
            assert np.array_equal(one, other), (frame, name)
    assert bool(part.num_dynamic) == (which != "shared")


def test_each_segment_is_a_scene_of_its_own(scene: SceneFile) -> None:
    for number, part in enumerate(segmented.parts()):
        taken = ScenePlayer(part_of(scene, number))
        for frame in range(part.scene.header.frame_count):
            assert seen(taken.at_frame(frame)) == seen(ScenePlayer(part.scene).at_frame(frame))


def test_what_changes_of_each_gaussian(scene: SceneFile) -> None:
    flags = dynamics_of(scene)
    assert (flags == ONLY_FADES).sum() == 7 + 0 + 9 and (flags == STATIC).sum() == segmented.SHARED
    assert (np.diff(flags.astype(int)) <= 0).all()


def test_a_ranking_looks_at_every_segment(scene: SceneFile) -> None:
    order, rows = ranking(ScenePlayer(scene)), rows_of(segments_of(scene.header.model))
    first = set(order[: len(order) // 2].tolist())
    for each in (rows[0].deformed, rows[1].deformed, rows[2].still):
        assert first & set(range(each.start, each.stop))


def changed(scene: SceneFile, number: int, **values: object) -> SceneFile:
    segments = [dict(each) for each in scene.header.model[SEGMENTS]]
    segments[number] |= values
    return SceneFile(replace(scene.header, model={SEGMENTS: segments}), scene.arrays)


@pytest.mark.parametrize(
    ("number", "values", "found"),
    [
        (1, {"first": 6}, "begins at frame"),
        (1, {"first": -1}, "first of a segment"),
        (0, {"frames": 0}, "frames that it was trained on"),
        (0, {"trained_frames": 3}, "frames that it was trained on"),
        (0, {"frames": True}, "frames of a segment"),
        (2, {"frames": 3}, "segments of 14 frames"),
        (0, {"deformed": 2**40}, "deformed of a segment"),
        (0, {"model": {}}, "without a model"),
        (0, {"model": [1]}, "model of a segment"),
        (0, {"model": {"temporal_rows": "6"}}, "temporal_rows"),
    ],
)
def test_a_header_that_cannot_be_is_refused(
    scene: SceneFile, tmp_path: Path, number: int, values: dict[str, object], found: str
) -> None:
    write_scene(tmp_path / "damaged.frog", changed(scene, number, **values))
    with pytest.raises(FrogError, match=found):
        read_scene(tmp_path / "damaged.frog")


@pytest.mark.parametrize("model", [{SEGMENTS: []}, {SEGMENTS: {}}, {SEGMENTS: [[]]}])
def test_a_list_of_segments_that_is_none_is_refused(scene: SceneFile, tmp_path: Path, model: dict) -> None:
    write_scene(tmp_path / "damaged.frog", SceneFile(replace(scene.header, model=model), scene.arrays))
    with pytest.raises(FrogError, match="segment"):
        read_scene(tmp_path / "damaged.frog")


@pytest.mark.parametrize(
    ("number", "values"),
    [(0, {"deformed": 19}), (0, {"deformed": 500}), (2, {"still": 500}), (0, {"model": {"temporal_rows": 6}})],
)
def test_arrays_that_are_not_the_headers_are_refused(scene: SceneFile, number: int, values: dict[str, object]) -> None:
    with pytest.raises(FrogError, match="train it again"):
        ScenePlayer(changed(scene, number, **values))


@pytest.mark.parametrize("name", ["temporal_table", "embeddings", "network.1.output_bias"])
def test_a_missing_array_is_refused(scene: SceneFile, name: str) -> None:
    arrays = {key: array for key, array in scene.arrays.items() if key != name}
    with pytest.raises(FrogError, match="cannot be used"):
        ScenePlayer(SceneFile(scene.header, arrays))


def test_segments_with_other_shared_gaussians_are_not_joined(scene: SceneFile) -> None:
    from frog_blender.engine.scene.joined import join

    with pytest.raises(FrogError, match="shared Gaussians"):
        join(scene.header, segmented.shared_gaussians(seed=98), segmented.parts())


def test_selecting_keeps_frames_whole(scene: SceneFile) -> None:
    kept = select_gaussians(scene, np.arange(0, len(scene.arrays["means"]), 3))
    segments = segments_of(kept.header.model)
    assert [one.first + one.frames for one, _ in pairwise(segments)] == [two.first for two in segments[1:]]
    assert sum(each.deformed for each in segments) == len(kept.arrays["embeddings"])
