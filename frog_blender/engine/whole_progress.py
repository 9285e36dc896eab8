"""One bar and one estimate for work in stages: the share of it that is done by the clock, which never falls."""

import math
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

_FULL = 0.995  # of the bar, until the work has ended
_TRUSTED = 0.05  # share of the work after which what a stage took counts as much as what was known before it
_PACE = 0.1  # share of a stage over which its pace is a moving average
_OVERDUE = 0.2  # of how much longer than expected a part has taken: still to come
_UNPLANNED = 0.05  # of all that is planned: a stage that is not
_LEAST = 0.05  # times what was expected: less took a stage whose result was kept


@dataclass(frozen=True)
class Standing:
    """Where work in stages is.

    Attributes:
        stage: in words.
        fraction: of the whole by the clock, 0 to 1.
        seconds_left: to the end of the whole, an estimate; 0 for an unknown time.
    """

    stage: str
    fraction: float
    seconds_left: float

    def after(self, seconds: float) -> "Standing":
        """The same if nothing was told for so long: the bar goes on, ever more slowly, and never ends."""
        if self.seconds_left <= 0 or seconds <= 0:
            return self
        share = self.seconds_left / (self.seconds_left + seconds)
        return Standing(self.stage, 1 - (1 - self.fraction) * share, self.seconds_left * share)


@dataclass
class _Stage:
    name: str
    expected: float
    part: float = 0.0  # done
    slowness: float = 0.0  # sum over what is done of the logarithm of its pace
    rate: float = 0.0  # seconds of the whole stage, at its present pace

    def passed(self, part: float, seconds: float) -> None:
        """Counts a part that took so long."""
        self.part += part
        self.slowness += part * math.log(max(seconds / part / self.expected, 1e-6))


class WholeProgress:
    """What is left of stages that follow each other, by how long each is likely to take and how long others took.

    A stage that is skipped takes no time. One that is not planned is put in where it comes. Any thread may tell.

    Args:
        plan: the stages and the seconds that each is likely to take, in their order; names may come more than once.
        now: seconds on a clock.
        before: seconds that an earlier run took, whose part of the bar is full.
    """

    def __init__(
        self, plan: Sequence[tuple[str, float]], now: Callable[[], float] = time.perf_counter, before: float = 0.0
    ) -> None:
        self._stages = [_Stage(name, max(seconds, 1e-3)) for name, seconds in plan]
        self._now, self._began, self._told = now, now() - before, now()
        self._index, self._fraction = -1, 0.0
        self._lock = threading.Lock()

    def tell(self, name: str, part: float) -> Standing:
        """Where the work is once so much of a stage is done, 0 to 1; less than was told before changes nothing."""
        with self._lock:
            now = self._now()
            stage = self._current(name, part, now)
            since, passed = now - self._told, min(part, 1.0) - stage.part
            if passed > 0:
                stage.passed(passed, since)
                self._told = now
                stage.rate += min(1.0, passed / _PACE) * (since / passed - stage.rate)
            # Parts of a stage differ, so that the first ones say little.
            rate = stage.part * stage.rate + (1 - stage.part) * self._pace() * stage.expected
            waited, rest = now - self._told, (1 - stage.part) * rate
            left = max(rest - waited, _OVERDUE * (waited - rest), 0.0)
            left += self._pace() * sum(later.expected for later in self._stages[self._index + 1 :])
            elapsed = now - self._began
            self._fraction = max(self._fraction, min(elapsed / max(elapsed + left, 1e-9), _FULL))
            return Standing(name, self._fraction, left)

    def _current(self, name: str, part: float, now: float) -> _Stage:
        """The stage that is told of; until it begins, the one before does what was left of it."""
        if self._index >= 0 and self._stages[self._index].name == name:
            return self._stages[self._index]
        following = range(self._index + 1, len(self._stages))
        index = next((index for index in following if self._stages[index].name == name), None)
        if index is None:
            index = self._index + 1
            usual = _UNPLANNED * sum(stage.expected for stage in self._stages)
            self._stages.insert(index, _Stage(name, max(usual, 1e-3)))
        if self._index >= 0 and (left := 1 - self._stages[self._index].part) > 0:
            self._stages[self._index].passed(left, now - self._told)
        for skipped in self._stages[self._index + 1 : index]:
            skipped.expected = 0.0
        self._index, self._told, stage = index, now, self._stages[index]
        stage.part, stage.rate = max(part, 0.0), self._pace() * stage.expected
        return stage

    def _pace(self) -> float:
        """How many times what was expected the work is likely to take: a geometric mean, so that a while on a busy
        computer counts for the little that was done in it, and with most weight on the latest stage."""
        pace, all_expected = 0.0, sum(stage.expected for stage in self._stages)
        for stage in self._stages[: self._index + 1]:
            if stage.part > 0 and (own := stage.slowness / stage.part) > math.log(_LEAST):
                done = stage.part * stage.expected
                pace += done / (done + _TRUSTED * all_expected) * (own - pace)
        return math.exp(pace)


def about(seconds: float) -> str:
    """No more precisely than an estimate is: 48 -> "50 seconds", 250 -> "4 minutes", 9000 -> "2.5 hours"."""
    if seconds < 95:
        return f"{max(10, round(seconds, -1)):.0f} seconds"
    if seconds < 95 * 60:
        minutes = seconds / 60
        return f"{round(minutes) if minutes < 20 else 5 * round(minutes / 5)} minutes"
    return f"{seconds / 3600:.1f}".removesuffix(".0") + " hours"
