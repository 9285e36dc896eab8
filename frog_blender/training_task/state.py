"""The state of a training for the panel, accumulated from its events."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

from ..engine.scene.compression_report import lines, summary

if TYPE_CHECKING:
    import numpy as np

    from ..engine.training.session.events import Event, Finished


@dataclass
class TrainingState:
    """What the panel shows.  Only ``pump()`` writes it, so it needs no lock."""

    running: bool = True
    stage: str = "Starting"
    stage_fraction: float = 0.0
    step: int = 0
    steps: int = 0
    seconds: float = 0.0
    seconds_left: float = 0.0
    loss: float | None = None
    gaussians: int = 0
    moving: int = 0
    capacity: list[str] = field(default_factory=list)  # what was removed from the model, one line each
    psnr: float | None = None
    psnr_split: str = ""
    preview: np.ndarray | None = None  # (H, W, 3) uint8, the latest
    warnings: list[str] = field(default_factory=list)
    result: Path | None = None  # the finished scene, or what a cancelled training left
    note: str = ""  # what happened to the result in Blender, if not as expected
    cancelled: bool = False
    error: str = ""

    @property
    def fraction(self) -> float:
        """How much of the present stage is done, 0 to 1."""
        return self.step / self.steps if self.steps and not self.stage else self.stage_fraction

    def take(self, event: Event) -> None:
        """Apply an event of the engine (``engine.training.session.events``)."""
        from ..engine.training.session import events as kinds

        match event:
            case kinds.Progress():
                self.stage = ""
                self.step, self.steps, self.loss = event.step, event.steps, event.loss
                self.seconds, self.seconds_left = event.seconds, event.seconds_left
                self.gaussians, self.moving = event.gaussians, event.num_dynamic
            case kinds.Reduced():
                self.capacity.append(event.message)
            case kinds.CompressionPreview() | kinds.Preview():
                self.preview = event.image
            case kinds.Stage():
                self.stage, self.stage_fraction = event.name.capitalize(), event.done / max(event.total, 1)
            case kinds.Started():
                self.stage, self.steps, self.gaussians = "", event.steps or 0, event.gaussians
            case kinds.Evaluated():
                self.psnr, self.psnr_split = event.psnr, event.split
            case kinds.WarningEvent():
                self.warnings.append(event.message)
            case kinds.Finished():
                self._finish(event)
            case kinds.Cancelled():
                self.cancelled = True
                self.result = Path(event.path) if event.path else None

    def _finish(self, event: Finished) -> None:
        self.result = Path(event.path)  # first: the file exists, whatever else is wrong with the event
        self.step, self.steps, self.seconds = event.steps, event.steps, event.seconds
        self.gaussians = event.gaussians
        self.psnr = event.psnr if event.psnr is not None else self.psnr
        if event.capacity:
            self.moving = event.capacity["dynamic"]
            self.capacity = [summary(event.capacity), *lines(event.capacity)]
