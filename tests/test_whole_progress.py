"""One bar for work in stages: it never falls, its estimate follows what passes, and the computer is remembered."""

from collections.abc import Callable

import pytest

from frog_blender.engine.whole_progress import Standing, WholeProgress, about

Stages = tuple[tuple[str, float], ...]
PLAN: Stages = (("films", 2.0), ("features", 10.0), ("clocks", 8.0), ("features", 20.0))


class Clock:
    """Stands until it is set."""

    seconds = 0.0

    def __call__(self) -> float:
        return self.seconds


def told(took: Stages) -> list[tuple[float, Standing]]:
    """What a work tells that takes so long, ten times a stage, each with the seconds that have passed."""
    clock = Clock()
    whole, said = WholeProgress(PLAN, clock), list[tuple[float, Standing]]()
    for name, seconds in took:
        for part in range(11):
            said.append((clock.seconds, whole.tell(name, part / 10)))
            clock.seconds += seconds / 10 if part < 10 else 0.0
    return said


@pytest.mark.parametrize("times", [1.0, 4.0, 0.5], ids=["as expected", "a slow computer", "a fast one"])
def test_after_a_tenth_the_estimate_is_right(times: float) -> None:
    said = told(tuple((name, times * seconds) for name, seconds in PLAN))
    total = times * sum(seconds for _, seconds in PLAN)
    later = [(at, now) for at, now in said if 0.1 * total <= at < total]
    assert later and all(abs(at + now.seconds_left - total) <= 0.3 * total for at, now in later)
    assert [now.fraction for _, now in said] == sorted(now.fraction for _, now in said)
    assert said[0][1].fraction == 0 and 0.99 < said[-1][1].fraction < 1


TRAINING: Stages = (("decoding", 5.0), ("seeding", 2.0), ("training", 120.0), ("saving", 8.0))


def estimates(busy: Callable[[float], float], waits: float = 0.0) -> list[tuple[float, float]]:
    """The share of the whole time that has passed, and the estimated over the true whole time, once a second.

    Args:
        busy: how many times as long as expected work takes at a time, in seconds.
        waits: seconds before the first step of the training.
    """
    clock, said = Clock(), list[tuple[float, float]]()
    whole = WholeProgress(TRAINING, clock)
    for name, seconds in TRAINING:
        clock.seconds += waits if name == "training" else 0.0
        done = 0.0
        while done < seconds:
            said.append((clock.seconds, whole.tell(name, done / seconds).seconds_left))
            step = min(1 / busy(clock.seconds), seconds - done)
            clock.seconds, done = clock.seconds + step * busy(clock.seconds), done + step
        whole.tell(name, 1.0)
    return [(at / clock.seconds, (at + left) / clock.seconds) for at, left in said]


@pytest.mark.parametrize("period", [5.0, 20.0])
def test_the_estimate_is_right_on_a_computer_whose_speed_halves_and_doubles(period: float) -> None:
    said = estimates(lambda at: 2.0 if at // period % 2 else 1.0)
    assert all(abs(now - 1) <= 0.3 for at, now in said if at >= 0.1)


def test_a_slow_beginning_is_not_taken_for_the_pace_of_all() -> None:
    waited = estimates(lambda at: 10.0 if at < 40 else 1.0, waits=20.0)
    assert max(now for _, now in waited) < 2
    loaded = estimates(lambda at: 10.0 if at < 60 else 1.0)
    assert max(now for _, now in loaded) < 2.7 and all(now < 1.3 for at, now in loaded if at > 0.5)


def test_a_stage_that_comes_again_is_skipped_or_not_planned_does_not_begin_the_bar_anew() -> None:
    said = told((("films", 2.0), ("features", 10.0), ("board", 6.0), ("features", 20.0), ("clocks", 3.0)))
    fractions = [now.fraction for _, now in said]
    assert fractions == sorted(fractions) and len(set(fractions)) > 30
    assert said[-1][1].seconds_left == 0


def test_what_several_tell_at_once_counts_where_it_is_more() -> None:
    clock = Clock()
    whole = WholeProgress(PLAN, clock)
    whole.tell("features", 0.0)
    clock.seconds = 5.0
    assert whole.tell("features", 0.5).seconds_left == pytest.approx(5 + 28)
    assert whole.tell("features", 0.2).seconds_left == pytest.approx(5 + 28)


def test_the_bar_goes_on_while_nothing_is_told_and_never_ends() -> None:
    now = Standing("features", 0.4, 30.0)
    later = [now.after(seconds) for seconds in (0, 1, 10, 1000)]
    assert [each.fraction for each in later] == sorted({each.fraction for each in later}) and later[-1].fraction < 1
    assert later[1].seconds_left == pytest.approx(29, abs=0.1) and later[-1].seconds_left > 0


def test_a_resumed_work_begins_where_it_was() -> None:
    assert WholeProgress((("steps", 30.0),), Clock(), before=30.0).tell("steps", 0.0).fraction == pytest.approx(0.5)


def test_lengths_of_time_are_no_more_precise_than_they_are() -> None:
    said = [about(seconds) for seconds in (2, 48, 94, 250, 1500, 5000, 9000, 7200)]
    assert said == [
        *("10 seconds", "50 seconds", "90 seconds", "4 minutes"),
        *("25 minutes", "85 minutes", "2.5 hours", "2 hours"),
    ]
