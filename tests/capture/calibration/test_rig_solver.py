"""The small bundle adjustment by itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from frog_blender.engine.arrays import Float64s
from frog_blender.engine.capture.calibration.rig_solver import (
    FOCAL,
    K1,
    Options,
    Rig,
    Sightings,
    rotations_about,
    solve,
)


def scattered(seed: int, cameras: int = 3, bodies: int = 12, corners: int = 6) -> tuple[Rig, Sightings]:
    """Cameras with two lenses about rigid bodies, and exactly what they see of them."""
    rng = np.random.default_rng(seed)
    turns = rotations_about(rng.normal(0, 0.3, (cameras, 3)))
    lenses = np.array([[900.0, -0.1, 0.02, 640.0, 360.0], [700.0, 0.05, 0.0, 630.0, 350.0]])
    rig = Rig(
        turns,
        np.column_stack([rng.normal(0, 0.5, (cameras, 2)), np.full(cameras, 4.0)]),
        lenses,
        np.arange(cameras) % 2,
        rotations_about(rng.normal(0, 0.8, (bodies, 3))),
        rng.uniform(-1, 1, (bodies, 3)),
    )
    places = np.column_stack([rng.uniform(-0.3, 0.3, (corners, 2)), np.zeros(corners)])
    camera, body, corner = (each.reshape(-1) for each in np.indices((cameras, bodies, corners)))
    blank = Sightings(camera, body, places[corner], np.zeros((camera.size, 2)))
    return rig, replace(blank, pixels=rig.residuals(blank))


def disturbed(rig: Rig, seed: int, size: float) -> Rig:
    rng = np.random.default_rng(seed)
    moved = rng.normal(0, size, rig.translations.shape)
    moved[0] = 0.0
    return replace(
        rig,
        translations=rig.translations + moved,
        lenses=rig.lenses * (1.05, 0.0, 1.0, 1.0, 1.0),
        body_rotations=rotations_about(rng.normal(0, size, rig.body_positions.shape)) @ rig.body_rotations,
        body_positions=rig.body_positions + rng.normal(0, size, rig.body_positions.shape),
    )


def focal_and_k1(rig: Rig) -> Options:
    free = np.zeros(rig.lenses.shape, dtype=bool)
    free[:, [FOCAL, K1]] = True
    return Options(free, turning=True, loss_scale=3.0, iterations=200)


def test_exact_sightings_give_the_exact_rig() -> None:
    truth, seen = scattered(0)
    found = solve(disturbed(truth, 1, 0.02), seen, focal_and_k1(truth))

    assert found.cost < 1e-8
    assert np.allclose(found.rig.lenses, truth.lenses, rtol=1e-5, atol=1e-5)
    assert np.allclose(found.rig.centers, truth.centers, atol=1e-4)


def test_the_first_camera_and_held_parameters_do_not_move() -> None:
    truth, seen = scattered(2)
    start = disturbed(truth, 3, 0.02)

    found = solve(start, seen, focal_and_k1(truth)).rig

    assert np.array_equal(found.rotations[0], start.rotations[0])
    assert np.array_equal(found.translations[0], start.translations[0])
    assert np.array_equal(found.lenses[:, 2:], start.lenses[:, 2:])


def test_held_cameras_only_let_bodies_move() -> None:
    truth, seen = scattered(4)
    start = replace(disturbed(truth, 5, 0.05), translations=truth.translations, lenses=truth.lenses)
    options = Options(np.zeros(truth.lenses.shape, dtype=bool), turning=True, loss_scale=3.0, holding=True)

    found = solve(start, seen, options).rig

    assert np.array_equal(found.translations, truth.translations)
    assert np.allclose(found.body_positions, truth.body_positions, atol=1e-5)


def test_a_tenth_of_false_sightings_hardly_matters() -> None:
    truth, seen = scattered(6, bodies=30)
    rng = np.random.default_rng(7)
    pixels = seen.pixels + rng.normal(0, 0.3, seen.pixels.shape)
    pixels[rng.random(len(seen)) < 0.1] += 200.0

    found = solve(disturbed(truth, 8, 0.02), replace(seen, pixels=pixels), focal_and_k1(truth))

    assert np.abs(found.rig.lenses[:, FOCAL] / truth.lenses[:, FOCAL] - 1).max() < 0.01
    assert np.abs(found.rig.centers - truth.centers).max() < 0.03


def test_sigmas_are_as_large_as_the_errors() -> None:
    errors, sigmas = [], []
    for seed in range(12):
        truth, seen = scattered(9, bodies=20)
        noise = np.random.default_rng(seed).normal(0, 0.5, seen.pixels.shape)
        options = replace(focal_and_k1(truth), loss_scale=50.0)
        found = solve(truth, replace(seen, pixels=seen.pixels + noise), options)
        errors.append(np.log(found.rig.lenses[:, FOCAL] / truth.lenses[:, FOCAL]))
        sigmas.append(found.lens_sigmas[:, FOCAL])
    ratio = np.sqrt(np.mean(np.square(errors))) / np.mean(sigmas)
    assert 0.6 < ratio < 1.6


@pytest.mark.parametrize("turning", [True, False])
def test_steps_go_down_the_slope(turning: bool) -> None:
    """A wrong derivative would stop above the least cost: points move freely, so that nothing is left."""
    truth, seen = scattered(10, corners=1)
    seen = seen if turning else replace(seen, places=np.zeros_like(seen.places))
    exact = replace(seen, pixels=seen.pixels + truth.residuals(seen))
    options = replace(focal_and_k1(truth), turning=turning)
    start = replace(truth, body_positions=truth.body_positions + 0.05)

    assert solve(start, exact, options).cost < 1e-6


def test_a_point_behind_a_camera_does_not_end_the_work() -> None:
    truth, seen = scattered(11)
    positions: Float64s = truth.body_positions.copy()
    positions[0, 2] = -40.0

    found = solve(replace(truth, body_positions=positions), seen, focal_and_k1(truth))

    assert np.isfinite(found.cost)
    assert np.isfinite(found.rig.lenses).all()
