"""A sink for Weights & Biases: `frog train ... --sink wandb`. Its own variables say where to, as WANDB_PROJECT."""

from typing import Any

from frog_blender.engine import Cancelled, Event, Finished, FrogError, Preview

from .scalars import scalars

try:
    import wandb
except ImportError as error:
    raise FrogError("The Python package 'wandb' is missing; pip install wandb brings it.") from error


class Sink:
    """Draws figures and previews in a run of its own for each training."""

    def __init__(self) -> None:
        self._run: Any = None

    def __call__(self, event: Event) -> None:
        """See `engine.registry.SINKS`."""
        figures: dict[str, Any] = dict(scalars(event))
        if isinstance(event, Preview):
            figures["preview"] = wandb.Image(event.image)
        if figures:
            self._run = self._run or wandb.init()
            self._run.log(figures, step=event.step)
        elif isinstance(event, Finished | Cancelled) and self._run is not None:
            self._run.finish()
            self._run = None


SINK = Sink()
