"""What draws frames: the native library, or a GPU where this process was given one."""

import functools
import time
from collections.abc import Callable, Mapping

from ..arrays import Array
from ..capture.camera import Camera
from ..errors import reason
from ..gaussians import NumpyGaussians
from ..native.binding import Frame
from ..native.options import RasterizeOptions

Request = tuple[NumpyGaussians, Camera, tuple[float, float, float], RasterizeOptions, Mapping[str, Array]]
"""What ``native.binding.Frame`` takes: Gaussians, camera, background, options, and the arrays to draw into."""


class Painter:
    """Draws frames, in any thread.

    Attributes:
        gpu: what draws them on a GPU; None for the native library.
    """

    def __init__(self) -> None:
        self.gpu: Callable[[*Request], object] | None = None
        self._ask: Callable[[], object] | None = None
        self._seconds = 0.0
        self._has_complained = False

    def ask_after(self, seconds: float, ask: Callable[[], object]) -> None:
        """Calls ``ask``, once, when the native library has drawn for so long: a GPU takes seconds to get ready, which
        pay off where much is drawn."""
        self._ask, self._seconds = ask, seconds

    def paint(self, *request: *Request) -> str:
        """Draws, and returns what a user is to know, "" for nothing.

        What fails on the GPU is drawn by the native library, and said the first time.
        """
        complaint = ""
        if self.gpu is not None:
            try:
                self.gpu(*request)
                return ""
            except Exception as error:  # of the driver, of its memory: whatever it is, the CPU can draw
                if not self._has_complained:
                    complaint = f"The GPU could not draw an image, and the CPU did ({reason(error)})."
                self._has_complained = True
        started = time.perf_counter()
        notice = Frame(*request).notice
        self._seconds -= time.perf_counter() - started
        ask = self._ask
        if ask is not None and self._seconds <= 0:
            self._ask = None
            ask()
        return complaint or notice


painter = functools.cache(Painter)
"""The one of this process."""
