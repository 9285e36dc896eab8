"""The conditions of the stability suite, by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from ...engine import Alteration, Capture, FrogError, open_capture
from .alterations import Compression, Exposure, Light, Noise, Occlusion
from .cameras import faster, fewer_views, wrong_clocks, wrong_poses

BASES = {
    "clean": "any capture of several static cameras",
    "long": "a video of at least 300 frames (examples/make_long.py)",
    "dim": "a dark scene with hard moving shadows (examples/make_dim.py)",
    "appearing": "a scene with something that appears (examples/make_fast.py)",
    "still": "a scene in which nothing moves (examples/make_still.py)",
}
"""The captures that conditions are made from."""
CLEAN = "clean"
_NUM_FRAMES = 30
_LIGHTS = (1.0, 0.25, 0.0625)


@dataclass(frozen=True)
class Condition:
    """A capture, and what is wrong with it.

    Attributes:
        name: unique, such as ``"views 3"``.
        kind: what is wrong; conditions of a kind differ in severity.
        base: one of ``BASES``.
        change: makes the capture from its base.
        settings: of the recipe, for conditions that concern the training instead of the capture.
        light: of the whole scene, relative to the base. PSNR rises as images darken, so both images are brightened
            by its inverse before they are compared.
        against: the name of the condition that this one is compared with; "" for none.
    """

    name: str
    kind: str
    base: str = "clean"
    change: Callable[[Capture], Capture] = lambda capture: capture
    settings: Mapping[str, Any] = field(default_factory=dict)
    light: float = 1.0
    against: str = CLEAN

    def opened(self, folder: Path) -> Capture:
        """The capture in ``folder`` under this condition."""
        return self.change(open_capture(folder))


def _altered(make: Callable[[Capture], Alteration]) -> Callable[[Capture], Capture]:
    return lambda capture: replace(capture, alteration=make(capture))


def _points(share: float, name: str) -> Condition:
    return Condition(f"points {name}", "initial points", settings={"seed_share": share})


def _views(count: int) -> Condition:
    return Condition(f"views {count}", "views", change=lambda capture: fewer_views(capture, count))


def _poses(degrees: float) -> Condition:
    return Condition(f"poses {degrees:g} deg", "pose noise", change=lambda capture: wrong_poses(capture, degrees))


def _clocks(most: int) -> Condition:
    return Condition(f"clocks {most}", "time offsets", change=lambda capture: wrong_clocks(capture, most))


def _exposure(stops: float) -> Condition:
    return Condition(f"exposure {stops:g}", "exposure", change=_altered(lambda capture: Exposure(stops)))


def _noise(deviation: float) -> Condition:
    return Condition(f"noise {deviation:g}", "noise", change=_altered(lambda capture: Noise(deviation)))


def _jpeg(quality: int) -> Condition:
    return Condition(f"jpeg {quality}", "compression", change=_altered(lambda capture: Compression(quality)))


def _occluded(share: float) -> Condition:
    change = _altered(lambda capture: Occlusion(share, capture.frame_count))
    return Condition(f"occluded {share:.0%}", "occlusion", change=change)


def _pace(pace: int) -> Condition:
    change: Callable[[Capture], Capture] = lambda capture: faster(capture, pace, _NUM_FRAMES)  # noqa: E731
    return Condition(f"speed {pace}x", "speed", "long", change, against="" if pace == 1 else "speed 1x")


def _length(count: int) -> Condition:
    return Condition(
        f"moments {count}", "length", "long", lambda capture: capture.segment(0, count), against="speed 1x"
    )


def _light(light: float) -> Condition:
    change = _altered(lambda capture: Light(light))
    return Condition(
        f"light {light:g}", "dim light", "dim", change, light=light, against="" if light == 1 else "light 1"
    )


CONDITIONS = {
    condition.name: condition
    for condition in (
        Condition(CLEAN, "clean", against=""),
        *(_points(share, name) for share, name in ((0.1, "10%"), (0.01, "1%"), (0.0, "0%"))),
        *(_views(count) for count in (6, 3)),
        *(_poses(degrees) for degrees in (0.1, 0.4)),
        *(_clocks(most) for most in (1, 2)),
        *(_exposure(stops) for stops in (0.1, 0.3)),
        *(_noise(deviation) for deviation in (5, 15)),
        *(_jpeg(quality) for quality in (50, 15)),
        *(_occluded(share) for share in (0.1, 0.3)),
        *(_pace(pace) for pace in (1, 2, 4)),
        *(_length(count) for count in (120, 300)),
        *(_light(light) for light in _LIGHTS),
        Condition("appearing", "appearing", "appearing", against=""),
        Condition("nothing moves", "nothing moves", "still", against=""),
    )
}
"""In the order of the tables; within a kind by severity."""


def condition_named(name: str) -> Condition:
    """The condition of that name; FrogError if there is none."""
    if name not in CONDITIONS:
        raise FrogError(f"There is no condition {name!r}; there are {', '.join(CONDITIONS)}.")
    return CONDITIONS[name]
