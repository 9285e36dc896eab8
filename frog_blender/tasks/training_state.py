"""The state of a training for the panel, accumulated from its events."""

from __future__ import annotations

from contextlib import suppress
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
    report_image: np.ndarray | None = None  # (H, W, 3) uint8, what moves and what does not
    warnings: list[str] = field(default_factory=list)
    result: Path | None = None  # the finished scene, or what a cancelled training left
    result_bytes: int = 0  # of the finished scene's file
    is_cancelled: bool = False

    @property
    def sentence(self) -> str:
        """What a finished training made: ``4,100 of 33,000 splats move; file 1.1 MB; quality 33.8 dB.``"""
        splats = f"{self.moving:,} of {self.gaussians:,} splats move"
        if self.moving in (0, self.gaussians):
            splats = f"{self.gaussians:,} splats, {'none' if self.moving == 0 else 'all'} of which move"
        parts = [splats]
        if self.result_bytes:
            parts.append(f"file {_size(self.result_bytes)}")
        if self.psnr is not None:
            parts.append(f"quality {self.psnr:.1f} dB")
        return f"{'; '.join(parts)}."

    def take(self, event: Event) -> None:
        """Apply an event of the engine (``engine.training.session.events``)."""
        from ..engine.training.session import events as kinds

        match event:
            case kinds.Progress():
                self.step, self.steps, self.loss = event.step, event.steps, event.loss
                self.seconds, self.seconds_left = event.seconds, event.seconds_left
                self.gaussians, self.moving = event.gaussians, event.num_dynamic
            case kinds.Reduced():
                self.capacity.append(event.message)
            case kinds.Preview():
                self.preview = event.image
            case kinds.CompressionPreview():
                self.report_image = event.image
            case kinds.Started():
                self.steps, self.gaussians = event.steps or 0, event.gaussians
            case kinds.Evaluated():
                self.psnr, self.psnr_split = event.psnr, event.split
            case kinds.WarningEvent():
                self.warnings.append(event.message)
            case kinds.Finished():
                self._finish(event)
            case kinds.Cancelled():
                self.is_cancelled = True
                self.result = Path(event.path) if event.path else None

    def _finish(self, event: Finished) -> None:
        self.result = Path(event.path)  # first: the file exists, whatever else is wrong with the event
        self.step, self.steps = event.steps, event.steps
        self.seconds = sum(event.phases.values()) or event.seconds  # by the clock, as it was promised
        with suppress(OSError):
            self.result_bytes = self.result.stat().st_size
        self.gaussians = event.gaussians
        self.psnr = event.psnr if event.psnr is not None else self.psnr
        if event.capacity:
            self.moving = event.capacity["dynamic"]
            self.capacity = [summary(event.capacity), *lines(event.capacity)]


def _size(count: int) -> str:
    return f"{count / 1e6:,.1f} MB" if count >= 1e5 else f"{count / 1e3:,.0f} KB"
