"""Names that several rooms know: each of them covers what the list says."""

from __future__ import annotations

from frog_blender.engine.field.names import FIELD_METHODS, METHODS
from frog_blender.engine.playback.player import PLAYABLE
from frog_blender.engine.training.methods import METHODS as TRAINED


def test_every_method_is_trained_and_played() -> None:
    assert tuple(TRAINED) == METHODS
    assert {*PLAYABLE, "static"} == set(METHODS)
    assert set(FIELD_METHODS) < set(METHODS)
