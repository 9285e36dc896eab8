"""Two segments trained, joined and played: what is shared is the same in both, and a stopped training goes on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from support import synthetic_capture as film
from support.builders import scene_file

from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.errors import FrogError
from frog_blender.engine.field.names import CANONICAL
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.playback.player import ScenePlayer, select_gaussians
from frog_blender.engine.playback.render import draw
from frog_blender.engine.scene.scene_file import SceneFile, read_scene
from frog_blender.engine.scene.segments import rows_of, seen_at, segments_of
from frog_blender.engine.training.segments.stages import BASE, Stages
from frog_blender.engine.training.segments.steady import read_rows, steady_rows, write_rows
from frog_blender.engine.training.session import events
from frog_blender.engine.training.session.cancel_token import CancelToken


def finish(stages: Stages) -> SceneFile:
    for number in (BASE, *range(len(stages.cuts))):
        if number != BASE:
            stages.choose_shared()
        if not stages.is_done(number):
            *_, last = stages.train(number)
            assert isinstance(last, events.Finished)
    stages.join()
    return read_scene(stages.plan.job.output)


def static_rows(scene: SceneFile, first: int) -> set[bytes]:
    arrays = [scene.arrays[name][first:].reshape(len(scene.arrays["means"]) - first, -1) for name in sorted(CANONICAL)]
    return {row.tobytes() for row in np.concatenate(arrays, axis=1)}


def test_what_is_shared_is_in_every_segment_and_once_in_the_scene(stages: Callable[..., Stages]) -> None:
    made = stages()
    scene = finish(made)
    base = read_scene(made.scene_path(BASE))
    chosen = read_rows(made.plan.folder / "shared.rows", len(base.arrays["means"]))
    shared = static_rows(base, 0)
    shared &= static_rows(select_gaussians(base, chosen), 0)
    assert len(shared) == len(chosen) > 20 and chosen[0] >= len(base.arrays["embeddings"])
    for number in range(2):
        part = read_scene(made.scene_path(number))
        assert shared < static_rows(part, 0)
    segments = segments_of(scene.header.model)
    assert static_rows(scene, rows_of(segments)[-1].still.stop) == shared
    assert [(each.first, each.frames) for each in segments] == [(0, 10), (10, 10)]
    assert all(each.deformed + each.still for each in segments), "both have learned something of their own"

    header = scene.header
    assert header.frame_count == 20 and len(header.cameras) == 4 and header.scale == 1.0
    assert header.steps == 180 and header.metrics["split"] == "held-out" and header.metrics["psnr"] > 15
    assert header.camera_shots == (tuple(range(20)),) * 4 and header.test_cameras == ("cam00",)

    player = ScenePlayer(scene)
    for number, cut in enumerate(made.cuts):
        own = ScenePlayer.load(made.scene_path(number))
        alone = [frame for frame in range(cut.first, cut.first + cut.frames) if seen_at(segments, frame) == {number: 1}]
        assert len(alone) > 4
        for frame in alone:
            images = [
                draw(each, header.cameras[1], header.background).rgb
                for each in (player.at_frame(frame), own.at_frame(frame - cut.trained_first))
            ]
            np.testing.assert_allclose(images[0], images[1], atol=2e-3)  # only the order of equal depths differs


@pytest.mark.parametrize("stopped", [pytest.param(BASE, marks=pytest.mark.slow), 1])
def test_a_stopped_training_goes_on_to_the_same_scene(stages: Callable[..., Stages], stopped: int) -> None:
    straight, broken = stages("straight"), stages("broken")
    expected = finish(straight)
    for number in range(BASE, stopped):
        list(broken.train(number))
        broken.choose_shared()
    cancel = CancelToken()
    for event in broken.train(stopped, cancel):
        if isinstance(event, events.Progress) and event.step >= 25:
            cancel.cancel()
    assert isinstance(event, events.Cancelled) and not broken.is_done(stopped)
    found = finish(stages("broken"))
    assert found.arrays.keys() == expected.arrays.keys()
    for name, array in expected.arrays.items():
        assert np.array_equal(found.arrays[name], array), name


def test_seeds_are_where_the_shared_gaussians_do_not_explain_the_images(stages: Callable[..., Stages]) -> None:
    made = stages()
    list(made.train(BASE))
    made.choose_shared()
    job = made.job_of(0)
    assert job.shared is not None and job.recipe.pose_reach == 0 and job.opened is not None
    (started,) = [event for event in made.train(0) if isinstance(event, events.Started)]
    shared = len(job.shared["means"])
    assert shared < started.gaussians <= shared + 300


def test_what_does_not_fit_the_images_is_not_shared(long_film: Path, own_cache: Path) -> None:
    """The film's own wall is; the ball, where it is at one of the frames, and never moves, is not."""
    capture = open_capture(long_film)
    still = film.gaussians_at(0)
    arrays = {"means": still.means, "log_scales": np.log(still.scales), "quaternions": still.quaternions}
    arrays |= {"opacity_logits": np.log(still.opacities / (1 - still.opacities)), "sh": still.sh}
    header = replace(scene_file().header, model={}, method="static", frame_count=20, cameras=capture.cameras)
    scene = SceneFile(header, {name: array.astype(np.float32) for name, array in arrays.items()})
    rows = steady_rows(scene, capture, FrameStore.open(capture))
    wall = len(still.means) - 12
    assert (rows < wall).all() and len(rows) > wall / 2


@pytest.mark.parametrize("rows", [[3, 2], [-1, 2], [0, 10]])
def test_rows_that_are_none_are_refused(tmp_path: Path, rows: list[int]) -> None:
    write_rows(tmp_path / "shared.rows", np.array(rows))
    with pytest.raises(FrogError, match="shared"):
        read_rows(tmp_path / "shared.rows", 10)
