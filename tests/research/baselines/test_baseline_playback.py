"""Scenes of the baselines, written to a file and played, are the scenes that training ended with."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from support.random_models import COUNT, built, perturbed, scene_of

from frog_blender.engine.errors import FrogError
from frog_blender.engine.gaussians import ATTRIBUTES
from frog_blender.engine.playback.player import ScenePlayer
from frog_blender.engine.scene.scene_file import SceneFile, write_scene

TIMES = (0.0, 0.013, 0.25, 0.5, 0.9, 1.0)
SHAPES = [
    ("d3dgs", {}),
    ("d3dgs", {"hidden_width": 128}),
    ("hexplane", {}),
    ("hexplane", {"head_width": 24, "deformed_sh": 4}),
    ("hexplane", {"deformed_opacity": False, "deformed_sh": 0}),
    ("curves", {}),
]


@pytest.mark.parametrize(("method", "settings"), SHAPES, ids=str)
def test_gaussians_at_many_times(tmp_path: Path, method: str, settings: dict) -> None:
    model = perturbed(built(method, **settings))
    write_scene(tmp_path / "x.frog", scene_of(method, model))
    played = ScenePlayer.load(tmp_path / "x.frog")
    still = set(played.columns) - set(played.changing)
    assert ("scales" in still) == (method == "curves") and "sh_3" in played.columns
    for time in TIMES:
        gaussians, part = played.at(time), played.delta_at(time)
        with torch.no_grad():
            expected = model.deform(time)[0]
        assert float((expected.means - model.canonical.means).detach().abs().max()) > 1e-3  # it does move
        expected.quaternions = torch.nn.functional.normalize(expected.quaternions, dim=1)
        kept = ScenePlayer.load(tmp_path / "x.frog").at(time, part)
        for name in ATTRIBUTES:
            values = getattr(gaussians, name)
            assert values.dtype == np.float32 and values.flags.c_contiguous
            np.testing.assert_allclose(
                values, getattr(expected, name).detach().numpy(), rtol=1e-5, atol=1e-5, err_msg=name
            )
            np.testing.assert_array_equal(values, getattr(kept, name), err_msg=name)


HOSTILE = [
    ("d3dgs", "network.layers.1.weight", None),
    ("d3dgs", "network.layers.0.weight", (64, 3)),
    ("d3dgs", "network.extent", "zero"),
    ("d3dgs", "network.layers.2.bias", "nan"),
    ("d3dgs", "depth", 10**9),
    ("d3dgs", "space_frequencies", "many"),
    ("d3dgs", "motion_unit", float("nan")),
    ("hexplane", "network.space_planes.0", (3, 16, 32, 31)),
    ("hexplane", "network.extent", "zero"),
    ("hexplane", "time_rows", 1),
    ("hexplane", "resolutions", (1, 64)),
    ("hexplane", "resolutions", 32),
    ("hexplane", "head_width", 10**6),
    ("curves", "embeddings", (COUNT, 14)),
    ("curves", "motion_units", (1.0, 2.0)),
    ("curves", "first_width", None),
]


@pytest.mark.parametrize(("method", "name", "instead"), HOSTILE, ids=lambda value: str(value))
def test_what_does_not_fit_is_refused_in_a_sentence(method: str, name: str, instead: object) -> None:
    scene = scene_of(method, perturbed(built(method)))
    arrays, model = dict(scene.arrays), dict(scene.header.model)
    if name not in arrays and name in model:
        model[name] = instead
        if instead is None:
            del model[name]
    elif instead is None:
        del arrays[name]
    elif isinstance(instead, tuple):
        arrays[name] = np.ones(instead, np.float32)
    else:
        arrays[name] = np.full_like(arrays[name], 0 if instead == "zero" else np.nan)
    with pytest.raises(FrogError, match=r"^The method \S+ cannot play what a training of it wrote \(.*\)\.$"):
        ScenePlayer(SceneFile(replace(scene.header, model=model), arrays))
