"""How a training stands, as the panel shows it: what its events say, put together."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..engine.scene.compression_report import lines, summary


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
    capacity: list[str] = field(default_factory=list)  # what was taken out of the model, a line each
    psnr: float | None = None
    psnr_split: str = ""
    preview: Any = None  # (H, W, 3) uint8, the latest
    warnings: list[str] = field(default_factory=list)
    result: Path | None = None  # the finished scene, or what a cancelled training left
    note: str = ""  # what became of the result in Blender, where that is not what one expects
    cancelled: bool = False
    error: str = ""

    @property
    def fraction(self) -> float:
        """How much of the present stage is done, 0 to 1."""
        return self.step / self.steps if self.steps and not self.stage else self.stage_fraction

    def take(self, event: Any) -> None:
        """Take in an event of the engine's (``engine.training.session.events``)."""
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

    def _finish(self, event: Any) -> None:
        self.result = Path(event.path)  # first: whatever else is wrong with the event, the file is there
        self.step, self.steps, self.seconds = event.steps, event.steps, event.seconds
        self.gaussians = event.gaussians
        self.psnr = event.psnr if event.psnr is not None else self.psnr
        if event.capacity:
            self.moving = event.capacity["dynamic"]
            self.capacity = [summary(event.capacity), *lines(event.capacity)]
