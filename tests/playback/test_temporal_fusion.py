"""The temporal embedding of a finished scene: every fusion, and files that do not fit together."""

from __future__ import annotations

import numpy as np
import pytest
from support.builders import scene_file

from frog_blender.engine.errors import FrogError
from frog_blender.engine.field import network
from frog_blender.engine.field.names import FUSIONS
from frog_blender.engine.playback.deformation import DeformationPlayer, TemporalEmbedding, fuse

COARSE, FINE = np.array([1.0, -2.0, 0.5]), np.array([3.0, 0.5, -4.0])


def test_what_each_fusion_is() -> None:
    expected = {
        "product": [COARSE * FINE],
        "add": [COARSE + FINE],
        "concat": [[1.0, -2.0, 0.5, 3.0, 0.5, -4.0]],
        "coarse": [COARSE],
        "fine": [FINE],
        "dual": [COARSE, FINE],
    }
    for form, values in expected.items():
        np.testing.assert_array_equal(fuse(form, COARSE, FINE), values)
    assert {*expected, "attention"} == set(FUSIONS)


def test_attention_weighs_both_by_their_scores() -> None:
    weight, query = np.random.default_rng(0).normal(size=(4, 3)), np.array([0.3, -1.0, 2.0, 0.7])
    scores = [query @ np.tanh(weight @ embedding) for embedding in (COARSE, FINE)]
    share = 1 / (1 + np.exp(scores[1] - scores[0]))
    fused = fuse("attention", COARSE, FINE, (weight, query))
    np.testing.assert_allclose(fused, [share * COARSE + (1 - share) * FINE], rtol=1e-12)
    np.testing.assert_allclose(
        fuse("attention", COARSE, FINE, (weight, 1e6 * query)), [[COARSE, FINE][np.argmax(scores)]]
    )


@pytest.mark.parametrize("form", FUSIONS)
def test_the_embedding_of_a_scene(form: str) -> None:
    scene = scene_file(3, fusion=form, fine_rows=5)
    table, model = scene.arrays["temporal_table"], scene.header.model
    embedding = TemporalEmbedding(scene.arrays, model)
    assert (embedding.networks, embedding.size) == (2 if form == "dual" else 1, 16 if form == "concat" else 8)
    for time in (0.0, 0.21, 0.8, 1.0):
        coarse, fine = (network.temporal_weights(time, rows, 6) @ table for rows in (model["coarse_rows"], 5))
        found = embedding.at(time)
        assert found.shape == (embedding.networks, embedding.size) and found.dtype == np.float32
        attention = scene.arrays.get("attention_weight"), scene.arrays.get("attention_query")
        np.testing.assert_allclose(found, fuse(form, coarse, fine, attention), rtol=1e-6)


@pytest.mark.parametrize("form", FUSIONS)
@pytest.mark.parametrize("head_width", [0, 5])
def test_every_array_must_have_its_shape(form: str, head_width: int) -> None:
    """The library would read beyond an array that is too small."""
    scene = scene_file(7, fusion=form, head_width=head_width)
    DeformationPlayer(scene.arrays, scene.header.model)
    wrong = [name for name in scene.arrays if name != "sh"]
    for name in wrong:
        whole = scene.arrays[name]
        # Fewer embeddings than Gaussians are legal: some are static.
        other_length = np.concatenate([whole, whole[:1]]) if name == "embeddings" else whole[:-1]
        for array in (other_length, whole[..., None], whole[:0]):
            with pytest.raises(FrogError, match="deformation network"):
                DeformationPlayer({**scene.arrays, name: array}, scene.header.model)
        with pytest.raises(FrogError, match="deformation network"):
            DeformationPlayer({k: v for k, v in scene.arrays.items() if k != name}, scene.header.model)


def test_settings_that_do_not_fit_are_one_sentence() -> None:
    scene = scene_file(7)
    wrong = [{"fusion": "dual"}, {"fusion": "concat"}, {"fusion": "attention"}, {"fusion": "none"}, {"fusion": None}]
    wrong += [{"fine_rows": 7}, {"fine_rows": -1}, {"coarse_rows": 0}, {"opacity_share": 2.0}, {"deformed_sh": 5}]
    wrong += [{"opacity_reduction": "some"}, {"hidden_width": -24}, {"head_width": 3}, {"embedding_size": "many"}]
    for change in wrong:
        with pytest.raises(FrogError, match="train it again") as caught:
            DeformationPlayer(scene.arrays, {**scene.header.model, **change})
        assert "\n" not in str(caught.value)
