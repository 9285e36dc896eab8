"""How a capture was filmed decides what of it is learned."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support import synthetic_capture as film
from support import turning_object
from support.training_steps import train

from frog_blender.engine.capture.capture import Capture
from frog_blender.engine.capture.readers import open_capture
from frog_blender.engine.evaluation.evaluate import TrueImages, evaluate_images
from frog_blender.engine.frames.store import FrameStore
from frog_blender.engine.options import JobOptions
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.recipes import RECIPES, Recipe, recipe
from frog_blender.engine.training.methods import fit_to, turn_between_images, views_per_moment
from frog_blender.engine.training.optimize.trainer import Trainer
from frog_blender.engine.training.session.job import TrainingJob
from frog_blender.engine.training.session.run import run_training


def one_a_moment(capture: Capture) -> Capture:
    """Of each camera one image, each at a moment of its own."""
    cameras = capture.train_cameras
    shots = [shot for shot in capture.shots if shot.camera in cameras and shot.frame == cameras.index(shot.camera)]
    return replace(capture, shots=tuple(shots), test_cameras=frozenset())


def together(capture: Capture) -> Capture:
    """The same cameras, all of which move: three images of one moment and three of another."""
    first = [shot for shot in capture.train_shots if shot.frame == 0]
    assert len(first) == 3
    again = [replace(shot, camera=shot.camera + len(capture.cameras), frame=1) for shot in first]
    cameras = capture.cameras + tuple(replace(camera, name=f"{camera.name}-1") for camera in capture.cameras)
    return replace(capture, cameras=cameras, distortions=capture.distortions * 2, shots=(*first, *again), frame_count=2)


def as_filmed(settings: Recipe) -> Recipe:
    """Where images show what changes: colours and opacities follow time, and no Gaussian is kept small."""
    return replace(settings, size_weight=0.0)


def test_views_are_counted_at_the_moments_that_have_any(capture: Capture) -> None:
    assert views_per_moment(capture) == len(capture.train_cameras) == 3
    assert views_per_moment(one_a_moment(capture)) == 1
    assert views_per_moment(replace(capture, shots=())) == 0


def test_one_view_a_moment_fixes_what_things_look_like(capture: Capture) -> None:
    single = fit_to(Recipe(), one_a_moment(capture))
    assert (single.deformed_sh, single.deformed_opacity) == (0, False)
    assert single.size_weight == Recipe().size_weight > 0 and single.square_weight == 0 < Recipe().square_weight
    assert (single.sh_degree, single.alpha_weight) == (Recipe().sides_sh_degree, Recipe().sides_alpha_weight) == (2, 1)
    assert single.smoothness_weight == Recipe().sides_smoothness > Recipe().smoothness_weight > 0
    assert fit_to(Recipe(smoothness_weight=0.0), one_a_moment(capture)).smoothness_weight == 0
    more = Recipe(sh_degree=3, alpha_weight=2.0)
    assert fit_to(more, one_a_moment(capture)).sh_degree == 3 and fit_to(more, one_a_moment(capture)).alpha_weight == 2
    assert fit_to(Recipe(sh_growth=(0.1,)), one_a_moment(capture)).sh_degree == 1  # as many as may begin
    assert fit_to(single, one_a_moment(capture)) == single  # as a resumed training asks again
    never = Recipe(appearance_views=0.0)
    assert fit_to(never, one_a_moment(capture)) == as_filmed(never)


def test_a_camera_that_moves_on_slowly_sees_colours_change(capture: Capture) -> None:
    """Neighbouring images of a film show the same side; those of ``one_a_moment`` are twenty degrees apart."""
    single = one_a_moment(capture)
    assert turn_between_images(single) == pytest.approx(math.degrees(0.35), abs=1e-6)
    first = single.cameras[single.shots[0].camera]
    turns = [(0.0, 0.02 * index, 0.0) for index in range(len(single.cameras))]
    film_like = single.with_cameras(
        replace(first.moved(np.array(turn), np.zeros(3)), name=camera.name)
        for turn, camera in zip(turns, single.cameras, strict=True)
    )
    assert film_like.has_moving_cameras and turn_between_images(film_like) < 2
    assert fit_to(Recipe(), film_like) == as_filmed(Recipe())
    assert turn_between_images(replace(single, shots=single.shots[:1])) == 0


def test_rigs_and_standing_cameras_see_colours_change(capture: Capture) -> None:
    assert fit_to(Recipe(), capture) == as_filmed(Recipe())
    several = together(capture)
    assert several.has_moving_cameras and fit_to(Recipe(), several) == as_filmed(Recipe())
    standing = capture.without_cameras([camera.name for camera in capture.cameras if camera.name != "cam01"])
    assert views_per_moment(standing) == 1 and fit_to(Recipe(), standing) == as_filmed(Recipe())


@pytest.mark.parametrize("name", RECIPES)
def test_the_papers_recipes_follow_no_capture(capture: Capture, name: str) -> None:
    settings = recipe(name)
    follows = fit_to(settings, one_a_moment(capture)) != as_filmed(settings)
    assert follows == (name in ("draft", "standard"))


@pytest.mark.parametrize("method", ["frog", "ed3dgs", "hexplane"])
def test_every_method_follows_the_capture(
    capture: Capture, store: FrameStore, lively: Callable[..., Recipe], method: str
) -> None:
    """Baselines too have what is better for one view a moment."""
    settings = lively(8, warm_up=0.0)
    single = one_a_moment(capture)
    images = FrameStore.open(single, cache_folder=store.folder.parent)
    trainer = Trainer(single, images, film.seeds(), settings, JobOptions(method=method, steps=8))
    train(trainer)
    with torch.no_grad():
        opacities = [trainer.deform(time)[0].opacities for time in (0.0, 1.0)]
    assert torch.equal(*opacities)


_MOST_LOST = 3.0  # dB between images that are learned from and others


@pytest.mark.slow
def test_one_image_a_camera_generalises(tmp_path: Path, own_cache: Path) -> None:
    folder = turning_object.write_capture(tmp_path / "object")
    capture = open_capture(folder)
    assert capture.has_moving_cameras and len(capture.train_shots) == turning_object.IMAGES
    settings = recipe("standard", capacity="auto", max_gaussians=3000, seed_gaussians=2500)
    output = tmp_path / "object.frog"
    list(run_training(TrainingJob(folder, output, recipe=settings, steps=800, device="cpu")))
    store, scene = FrameStore.open(capture), ScenePlayer.load(output)
    learned = evaluate_images(scene, TrueImages(capture, store), split="training")["psnr"]
    other = evaluate_images(scene, TrueImages(capture, store), split="held-out")["psnr"]
    assert learned > 30.0  # far above an image of the background, which has 14
    assert other > learned - _MOST_LOST
