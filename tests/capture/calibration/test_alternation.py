"""Calibration and synchronisation taking turns: what is believed where they contradict each other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import pytest

from frog_blender.engine.capture.calibration.model import Calibration
from frog_blender.engine.capture.calibration.pipeline import TIMES, Source, alternated
from frog_blender.engine.capture.synchronization.films import CalibrationRefused, Film
from frog_blender.engine.capture.synchronization.synchronization import Synchronization

from .test_report_lines import synchronization
from .walls import films


def clocks(offset: float, refusal: str | None = None) -> Synchronization:
    answer = synchronization(["a", "b"]).with_clocks({"a": (0.0, 1.0), "b": (offset, 1.0)})
    return replace(answer, refusal=refusal)


TOGETHER, LATER = clocks(0.0), clocks(0.5)
CONTRADICTION = clocks(0.5, "The films' lags contradict each other.")


class Solver:
    """Says from what its cameras come; refuses the background alone where it is told to."""

    def __init__(self, *, has_background: bool) -> None:
        self.has_background = has_background

    def __call__(self, films: Sequence[Film], count: int) -> Calibration:
        if count == 0 and not self.has_background:
            raise CalibrationRefused("The background shares too few points.")
        assert count in (0, TIMES)
        offsets = ", ".join(f"{film.offset:g}" for film in films)
        return Calibration((), source=f"what moves at {offsets}" if count else "the background")


def turns(*found: Synchronization, has_background: bool) -> tuple[Calibration, list[Film], Synchronization]:
    answers = iter(found)
    source = Source("features", Solver(has_background=has_background), needs_step=False)
    return alternated(source, films(*"ab"), lambda *_: next(answers))


def test_clocks_that_are_confirmed_are_used() -> None:
    calibration, timed, found = turns(LATER, LATER, has_background=True)
    assert calibration.source == "what moves at 0, 0.5"
    assert [film.offset for film in timed] == [0.0, 0.5] and found.clocks == LATER.clocks


@pytest.mark.parametrize("found", [[CONTRADICTION], [LATER, CONTRADICTION]])
def test_clocks_that_contradict_each_other_do_not_touch_the_cameras(found: list[Synchronization]) -> None:
    calibration, timed, kept = turns(*found, has_background=True)
    assert calibration.source == "the background"
    assert [film.offset for film in timed] == [0.0, 0.0] and kept.warnings == (CONTRADICTION.refusal,)


def test_films_taken_to_be_in_step_need_clocks_that_agree() -> None:
    calibration, _, _ = turns(TOGETHER, has_background=False)
    assert calibration.source == "what moves at 0, 0"
    with pytest.raises(CalibrationRefused) as refused:
        turns(CONTRADICTION, has_background=False)
    assert "shares too few points" in str(refused.value) and "contradict each other" in str(refused.value)
