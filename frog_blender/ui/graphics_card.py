"""Rendering on an NVIDIA card, where there is one with torch: what FROG draws with F12 and in rendered viewports.

Torch and the card's kernels take seconds to load. That is done beside Blender's threads, when frames have taken the
processor for a while; until then, and where anything is missing, the processor draws.
"""

from .. import addon_state, reported_once
from ..app_handlers import guarded
from ..engine.playback.painter import painter
from ..engine.training.session.time_estimate import has_nvidia_gpu
from ..worker import Worker
from .torch_environment import add_environment, torch_needed

_AFTER = 4.0  # seconds of drawing, about as many as loading takes


class _Card:
    def __init__(self) -> None:
        self.worker = Worker("FRoG graphics card", "the graphics card does not draw")


def _load() -> None:
    """Called in the thread that draws, which goes on."""
    if has_nvidia_gpu():
        add_environment()
        if not torch_needed():
            addon_state.get(_Card).worker.ask({"load": _hand_over})


def _hand_over() -> None:
    from ..engine.training.optimize.device import draw_frames_on  # torch

    if warning := draw_frames_on("auto"):
        reported_once.message(warning)


def register() -> None:
    painter().ask_after(_AFTER, guarded(_load))


def unregister() -> None:
    addon_state.get(_Card).worker.stop()
    painter.cache_clear()
