"""A sink for TensorBoard: `frog train ... --sink tensorboard`, then `tensorboard --logdir runs`.

`on_event=frog_loggers.tensorboard.Sink("runs/first")` is the same in Python, with a folder of one's own.
"""

from frog_blender.engine import Cancelled, Event, Finished, FrogError, Preview

from .scalars import scalars

try:
    from torch.utils.tensorboard import SummaryWriter
except ImportError as error:
    raise FrogError("The Python package 'tensorboard' is missing; pip install tensorboard brings it.") from error


class Sink:
    """Draws figures and previews.

    Args:
        folder: None for one below `runs`, named by date and host.
    """

    def __init__(self, folder: str | None = None) -> None:
        self._folder = folder
        self._writer: SummaryWriter | None = None

    def __call__(self, event: Event) -> None:
        """See `engine.registry.SINKS`."""
        figures = scalars(event)
        if self._writer is None and (figures or isinstance(event, Preview)):
            self._writer = SummaryWriter(self._folder)
        if self._writer is None:
            return
        for name, value in figures.items():
            self._writer.add_scalar(name, value, event.step)
        if isinstance(event, Preview):
            self._writer.add_image("preview", event.image, event.step, dataformats="HWC")
        elif isinstance(event, Finished | Cancelled):
            self._writer.close()
            self._writer = None


SINK = Sink()
