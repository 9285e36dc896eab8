"""What to train: the options of one training, and those that a resumed training takes over from its checkpoint."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from ...capture.capture import Capture
from ...capture.seeds import Seeds
from ...io.plain_values import JsonObject
from ...options import OPTIONS, JobOptions, Resume, TrainingOptions
from ...recipes import Recipe, recipe
from ...scene.scene_file import settings_json
from ..compression.settings import DEFAULT, CompressionSettings
from .live_scene import LiveScene

STORED = tuple(option.name for option in fields(JobOptions) if OPTIONS[option.name].resume is not Resume.FREE)
"""Options that a checkpoint knows, besides the recipe."""
RENEWED = tuple(name for name in STORED if OPTIONS[name].resume is Resume.ANEW)
"""Of those, the ones that a resumed training may be given anew."""


@dataclass(frozen=True)
class TrainingJob(JobOptions):
    """What to train, besides its options.

    Attributes:
        capture: the capture's folder.
        output: the ``.frog`` to write; its checkpoint lies beside it.
        recipe: the settings, before the budgets of ``max_gaussians`` and ``max_bytes``.
        chosen: the options and settings that the user chose, by name, and what the user calls them (``--seed``): a
            resume names those that it ignores.
        opened: the capture itself, where it is not what ``open_capture`` makes of the folder (a protocol's own split).
        seeds: the seed points, where they are known; None finds them in the images.
        event_seconds: between progress events, at least.
        evaluated_shots: images that each evaluation during the training looks at, at most.
        preview_size: pixels of a preview's longer side, at most: rendering 512 takes less than a step.
        preview_seconds: between previews, at most; there is one at every tenth of the training besides.
        compression: thresholds, with the recipe's capacity "auto".
        sinks: names of what is told every event besides, see ``registry.SINKS``.
        live: takes snapshots of the scene while it is trained; None makes none.
    """

    capture: Path
    output: Path
    recipe: Recipe = field(default_factory=lambda: recipe("standard"))
    chosen: Mapping[str, str] = field(default_factory=dict)
    opened: Capture | None = None
    seeds: Seeds | None = None
    event_seconds: float = 0.5
    evaluated_shots: int = 6
    preview_size: int = 512
    preview_seconds: float = 10.0
    compression: CompressionSettings = DEFAULT
    sinks: tuple[str, ...] = ()
    live: LiveScene | None = None

    @classmethod
    def of_options(cls, capture: Path, output: Path, options: TrainingOptions, **more: Any) -> TrainingJob:
        """The job that options stand for.

        Args:
            more: fields of the job that are no options.
        """
        values = {option.name: getattr(options, option.name) for option in fields(JobOptions)}
        return cls(capture, output, **{"recipe": options.chosen_recipe(), **values, **more})

    def stored_settings(self) -> JsonObject:
        """JSON values for a checkpoint: the options in ``STORED``, the recipe, and whose training it is."""
        settings = {name: getattr(self, name) for name in STORED}
        return {**settings, "recipe": settings_json(self.recipe), "capture": str(Path(self.capture).resolve())}
