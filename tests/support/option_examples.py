"""A value of every option of a training, for tests of what options come through."""

from __future__ import annotations

from typing import Any

EXAMPLES: dict[str, tuple[Any, list[str]]] = {
    "recipe": ("draft", ["draft"]),
    "method": ("static", ["static"]),
    "steps": (12, ["12"]),
    "seconds": (90.5, ["90.5"]),
    "capacity": ("fixed", ["fixed"]),
    "views_per_step": (3, ["3"]),
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
    "device": ("cpu", ["cpu"]),
    "save_every": (9.0, ["9"]),
    "preview_camera": ("cam02", ["cam02"]),
    "overwrite": (True, []),
    "resume": (True, []),
}
"""A value of each option that is not its default, and how the command line is told it."""
