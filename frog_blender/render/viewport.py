"""The rendered viewport: what the FROG engine draws while one orbits and scrubs, coarse at first, sharp when still.

A viewport keeps the image it drew last. The same view of the same moment is not drawn again; another one is drawn
with as many pixels as fit the time, and once more with all of them when nothing has changed for a moment.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

import numpy as np

from ..color_spaces import into_working_space

if TYPE_CHECKING:
    from ..engine.capture.camera import Camera
    from ..engine.gaussians import GaussianArrays

MOVING_SECONDS = 0.016  # that an image may take while things move
STILL_AFTER = 0.2  # seconds without a change
COARSEST = 4  # pixels a side that one stands for at most


@dataclass
class ViewportImage:
    """What was drawn: ``pixels`` (H, W, 4) scene-linear premultiplied, rows from the bottom, ``step`` pixels a side."""

    key: Any
    step: int
    pixels: np.ndarray


@dataclass
class Viewport:
    """One viewport's memory.

    Attributes:
        image: the last one.
        changed_at: when its key became another one (of ``time.perf_counter``).
        seconds_per_pixel: of the last drawing, an estimate for the next.
        gathered: the Gaussians last seen and their background, and for which moment and captures.
        problems: a sentence for each capture that is not among them because it cannot be drawn.
        texture, shown: what lies on the graphics card, and of which image.
        moving_seconds: that an image may take while things move.
        still_after: seconds without a change until a sharp image is due.
    """

    image: ViewportImage | None = None
    changed_at: float = 0.0
    seconds_per_pixel: float = 1e-7
    gathered: tuple[Any, Any] = (None, (None, None))
    problems: list[str] = field(default_factory=list)
    texture: Any = None
    shown: ViewportImage | None = None
    moving_seconds: float = MOVING_SECONDS
    still_after: float = STILL_AFTER

    def step_for(self, key: Any, width: int, height: int, now: float) -> int:
        """Into pixels of how many a side the next image of ``key`` is to be divided; 0 when the last one will do."""
        if self.image is not None and self.image.key == key:
            sharp = self.image.step == 1
            return 0 if sharp or now - self.changed_at < self.still_after else 1
        self.changed_at = now
        fits = self.moving_seconds / max(self.seconds_per_pixel, 1e-12)
        return min(COARSEST, max(1, math.ceil(math.sqrt(width * height / fits))))

    def take(self, key: Any, step: int, pixels: np.ndarray, seconds: float) -> ViewportImage:
        """Remembers an image that took so many seconds."""
        self.image = ViewportImage(key, step, pixels)
        self.seconds_per_pixel = seconds / max(1, pixels.shape[0] * pixels.shape[1])
        return self.image

    @property
    def wants_more(self) -> bool:
        """True when a sharper image is due later."""
        return self.image is not None and self.image.step > 1


def draw_view(
    viewport: Viewport,
    key: Any,
    gaussians: GaussianArrays | None,
    camera_of: Callable[[int, int], Camera],
    size: tuple[int, int],
    background: np.ndarray | None,
) -> ViewportImage:
    """The image for ``key``, drawn if it has to be.

    Args:
        key: what decides the image: view, moment, captures, background.
        camera_of: (width, height) -> engine camera of the view at that size.
        size: the viewport's width and height in pixels.
        background: (3,) display-referred, or None for transparent.
    """
    from ..engine.playback.render import draw
    from .pixel_passes import combined_pass

    started = time.perf_counter()
    step = viewport.step_for(key, *size, started)
    if step == 0:
        assert viewport.image is not None
        return viewport.image
    width, height = (max(1, -(-length // step)) for length in size)
    drawing = draw(gaussians, camera_of(width, height)) if gaussians is not None else None
    combined = into_working_space(combined_pass(drawing, background, width, height))
    pixels = np.ascontiguousarray(combined[::-1], np.float32)
    return viewport.take(key, step, pixels, time.perf_counter() - started)
