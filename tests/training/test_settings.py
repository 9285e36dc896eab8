"""Every setting of a recipe says what it may be, and whoever makes a recipe is told in a sentence what it may not."""

import json
from dataclasses import replace
from typing import Any

import pytest
from support.builders import refused
from support.option_examples import beyond
from support.training_steps import Make

from frog_blender.engine.errors import FrogError
from frog_blender.engine.recipes import RECIPES, Recipe, recipe, stored_recipe
from frog_blender.engine.registry import METHODS
from frog_blender.engine.scene.scene_file import settings_json
from frog_blender.engine.setting import Choice, Fractions, Number, check_all, meanings_of
from frog_blender.engine.training.optimize.training import TrainingDiverged

KINDS = {name: meaning.kind for name, meaning in meanings_of(Recipe).items()}


def ends(name: str) -> list[Any]:
    """The outermost values that a setting takes."""
    kind = KINDS[name]
    if isinstance(kind, Number):
        return [kind.least, kind.most, *([0] if kind.or_zero else [])]
    if isinstance(kind, Choice):
        return list(kind.values)
    if isinstance(kind, Fractions):
        return [(0.0,) * kind.most, (1.0,) * kind.most]
    return ["", "x" * 100]


@pytest.mark.parametrize("name", KINDS)
def test_what_a_setting_may_not_be(name: str) -> None:
    for value in beyond(KINDS[name]):
        sentence = refused(".", replace, Recipe(), **{name: value})
        assert sentence.startswith(f"{name} is ") and ", expected " in sentence
        assert len(sentence) < 500
        with pytest.raises(FrogError):
            stored_recipe({**settings_json(Recipe()), name: value})
        if value is not None:  # which says that nothing is changed
            with pytest.raises(FrogError):
                recipe("draft", **{name: value})


@pytest.mark.parametrize("name", RECIPES)
def test_a_recipe_comes_back_from_a_file(name: str) -> None:
    stored = json.loads(json.dumps(settings_json(RECIPES[name])))
    assert stored_recipe(stored) == RECIPES[name]
    for method in METHODS:
        check_all(METHODS[method].adapted(RECIPES[name]))


def test_every_setting_has_to_be_in_a_file() -> None:
    stored = settings_json(RECIPES["draft"])
    refused("no setting 'speed'", stored_recipe, {**stored, "speed": 1})
    assert stored_recipe({**stored, "views_per_step": 1}) == RECIPES["draft"], "of before, with what is always so now"
    refused("no setting 'views_per_step'", stored_recipe, {**stored, "views_per_step": 2})
    del stored["split_scale"]
    refused("lacks split_scale", stored_recipe, stored)


@pytest.mark.parametrize("stored", [None, [], "draft", 5, {"speed": 1}, {"steps\n": 1}, {"opacity_ramp": [[0], [1]]}])
def test_files_without_a_recipe(stored: object) -> None:
    refused(".", stored_recipe, stored)


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"sh_degree": 2, "sh_growth": (0.1,)}, "sh_growth has 1 fractions, expected 2"),
        ({"temporal_size": 16}, "temporal_size is 16, expected at least embedding_size"),
        ({"seed_gaussians": 10**6, "max_gaussians": 10**6, "embedding_size": 512, "temporal_size": 512}, "1,000,000"),
    ],
)
def test_settings_that_do_not_go_together(changes: dict[str, Any], word: str) -> None:
    refused(word, recipe, "standard", **changes)


def test_a_network_that_could_not_tell_gaussians_apart() -> None:
    nothing = recipe("draft", embedding_size=0)
    for method in ("frog", "ed3dgs"):
        refused("embedding_size is 0", METHODS[method].adapted, nothing)
    METHODS["static"].adapted(nothing)


RISKY = ["max_gaussians", "frames_per_row", "dssim_period", "smoothness_neighbours", "region_size", "densify_every"]
OTHERS = [pytest.param(name, marks=pytest.mark.slow) for name in KINDS if name not in RISKY]


@pytest.mark.parametrize("name", RISKY + OTHERS)
def test_the_ends_of_what_a_setting_may_be_can_be_trained(make_trainer: Make, name: str) -> None:
    """A few steps with every outermost value: fine, or a sentence, such as that it became unstable."""
    early = {"densify_from": 0.0, "densify_every": 0.2, "sampling_from": 0.0, "sampling_every": 0.2}
    fitting = {"embedding_size": {"temporal_size": 1024}, "temporal_size": {"embedding_size": 1}}
    for value in ends(name):
        changes = {"capacity": "auto", **early, **fitting.get(name, {}), "steps": 6, name: value}
        try:
            trainer = make_trainer(**changes)
            for _ in range(6):
                if not trainer.finished:
                    trainer.step()
        except (FrogError, TrainingDiverged) as error:
            assert "\n" not in str(error)
