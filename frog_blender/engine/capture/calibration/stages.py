"""A calibration as one bar: what its stages are called, and how long each is likely to take beside the others."""

import os
from collections.abc import Callable

from ...whole_progress import Standing, WholeProgress

_STAGES = {
    "films": ("Looking at the films", 0.5, 0.0),
    "images": ("Reading images", 0.3, 0.3),
    "features": ("Finding features", 0.8, 3.8),
    "matches": ("Matching images", 0.3, 0.5),
    "poses": ("Placing the cameras", 1.1, 0.8),
    "bundle adjustment": ("Refining the cameras", 0.7, 1.3),
    "sound": ("Listening to the films", 0.2, 0.0),
    "motion": ("Finding what moves", 1.2, 0.0),
    "moving points": ("Following what moves", 2.0, 0.0),
    "coarse offsets": ("Synchronizing", 0.9, 0.0),
    "offsets": ("Refining the synchronization", 1.2, 0.0),
    "report": ("Writing the report", 0.2, 0.0),
    "board": ("Finding the board", 0.0, 0.0),
}
"""What a stage is called, by the name that is told, and its seconds for a small film on two cores: by the background
alone, and with what moves. They are right beside each other; the pace of a calibration shows as it goes.
"""
_LOOKED = "images", "features", "matches", "poses", "bundle adjustment"
_TIMED = "sound", "motion", "moving points", "coarse offsets", "offsets"


class CalibrationProgress:
    """Tells where a calibration is, from what its stages tell of themselves.

    Args:
        told: is called from any thread.
    """

    def __init__(self, told: Callable[[Standing], None]) -> None:
        self._told, self._whole = told, WholeProgress(())

    def plan(self, films: int, *, in_step: bool) -> None:
        """Expects the stages of so many standing cameras' films: those that are not ``in_step`` get their clocks
        between two looks at them; the others are looked at once, with what moves.
        """
        again = [(name, _STAGES[name][2]) for name in _LOOKED]
        names = ("films",) if in_step else ("films", *_LOOKED, *_TIMED)
        plan = [*((name, _STAGES[name][1]) for name in names), *again, ("report", _STAGES["report"][1])]
        usual = films * (2 / (os.cpu_count() or 2)) ** 0.7
        self._whole = WholeProgress([(name, usual * seconds) for name, seconds in plan])

    def __call__(self, stage: str, done: int, total: int) -> None:
        """So much of a stage is done."""
        standing = self._whole.tell(stage, done / max(total, 1))
        words, *_ = _STAGES.get(stage, (stage,))
        self._told(Standing(words, standing.fraction, standing.seconds_left))
