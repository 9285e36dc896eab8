"""A value of every option of a training, for tests of what options come through; and values that none takes."""

import math
from typing import Any

from frog_blender.engine.setting import Choice, Fractions, Kind, Number

EXAMPLES: dict[str, tuple[Any, list[str]]] = {
    "recipe": ("draft", ["draft"]),
    "method": ("static", ["static"]),
    "steps": (12, ["12"]),
    "seconds": (90.5, ["90.5"]),
    "capacity": ("fixed", ["fixed"]),
    "settings": ({"network_rate": 2e-3, "sh_growth": (0.2, 0.4)}, ["network_rate=2e-3", "sh_growth=0.2,0.4"]),
    "seed": (5, ["5"]),
    "scale": (0.5, ["0.5"]),
    "holdout_frames": (0, ["0"]),
    "max_gaussians": (500, ["500"]),
    "max_bytes": (3_000_000, ["3000000"]),
    "lossless": (True, []),
    "masks": ("off", ["off"]),
    "key": ("#00b140,0.40", ["#00b140,0.40"]),
    "pixel_offsets": ({"-cam": (8.0, -1.5), "b": (1e-3, 0.0)}, ["-cam=8,-1.5", "b=0.001,0"]),
    "layout": ("moments", ["moments"]),
    "device": ("cpu", ["cpu"]),
    "save_every": (9.0, ["9"]),
    "preview_camera": ("cam02", ["cam02"]),
    "overwrite": (True, []),
    "resume": (True, []),
}
"""A value of each option that is not its default, and how the command line is told it."""

NEVER: list[Any] = [math.nan, math.inf, -math.inf, 10**400, -(10**400), None, [], {}, "", "x\ny" * 60, (0.5, "a", 1)]


def beyond(kind: Kind) -> list[Any]:
    """Values just outside of what a setting or an option takes, and of other kinds."""
    if isinstance(kind, Number):
        numbers = [kind.least - 1e-9 if not kind.whole else kind.least - 1, kind.most + 1]
        return [*numbers, True, *([1.5] if kind.whole else []), *NEVER]
    if isinstance(kind, Choice):
        return [1 if kind.values == (True, False) else "other", *NEVER]
    if isinstance(kind, Fractions):
        return [(0.5, 0.4), (0.0, 1.1), (math.nan, 0.5), (False, True), (0.1,) * 4, *NEVER]
    return [value for value in NEVER if value != ""]
