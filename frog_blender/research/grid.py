"""The runs of an experiment: every training of a chart, identified by what decides its result."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine import UsageError, named, open_capture
from ..engine.registry import METHODS
from .conditions import CONDITIONS

if TYPE_CHECKING:
    from ..engine import Capture, Recipe

AUTO_ROW, AUTO_LABEL, AUTO = "frog-auto", "FRoG auto", {"capacity": "auto"}
"""FRoG with automatic capacity (see training.compression), a row beside FRoG with a fixed capacity."""
ROWS = ("frog", AUTO_ROW, "ed3dgs", "static", "d3dgs", "hexplane", "curves")
"""The rows of a chart, in the order of its tables; its ``methods`` may name others that are installed."""
FEWER_GAUSSIANS, DYNAMIC_SHARES = (8, 4, 2), (0.05, 0.1, 0.2, 0.4)
"""The capacity sweep: the recipe's number divided by these, and shares of the Gaussians that may be dynamic."""
MAIN_METHODS = ("frog", AUTO_ROW, "ed3dgs")
"""The paper's method and its baseline, which get the most seeds."""
ABLATIONS = ("fusion", "modulation", "sampling", "seeds", "loss", "opacity", "k", "capacity")
SHARPNESSES = (1.0, 5.0, 10.0, 20.0)
"""Values of k in the paper's ablation of the opacity reduction (0 is no reduction)."""


@dataclass(frozen=True)
class Run:
    """One training of a grid.

    Attributes:
        scene: the capture's name in the tables; unique in a results file.
        capture: its folder, which does not decide the result.
        method: see ``METHODS``.
        label: the row in the tables: the method's title, or what an ablation changes.
        recipe, overrides: a recipe's name, and settings that differ from it.
        seed: of all random numbers.
        steps: of training; None for the recipe's own.
        equal_time: limited not by steps but by the seconds that FRoG took for them on the same scene.
        scale, holdout_frames: see ``TrainingJob``.
        protocol: the paper's protocol that opens the capture (see ``protocols``); "" for a plain capture.
        group: "methods", "time" or an ablation's name.
        condition: the stability suite's condition (see ``conditions``); "" for the capture as it is.
    """

    scene: str = ""
    capture: str = ""
    method: str = "frog"
    label: str = ""
    recipe: str = "draft"
    overrides: tuple[tuple[str, Any], ...] = ()
    seed: int = 0
    steps: int | None = None
    equal_time: bool = False
    scale: float | None = None
    holdout_frames: int | None = None
    protocol: str = ""
    group: str = "methods"
    condition: str = ""

    @cached_property
    def key(self) -> str:
        """Identifies the training: the same on any day and machine.

        It depends on all that decides the result except the code, the capture's files and the recipes' own
        settings (see ``not_done``).
        """
        left_out = ("capture", "label", "group")
        decides = {name: value for name, value in asdict(self).items() if name not in left_out}
        decides["overrides"] = sorted(self.overrides)
        if not self.condition:
            del decides["condition"]  # the keys of plain runs are older than conditions
        return hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()[:16]

    def settings(self) -> Recipe:
        """The recipe as the method trains it."""
        return METHODS[self.method].adapted(self.plain_recipe())

    def plain_recipe(self) -> Recipe:
        """The recipe before the method adapts it."""
        from ..engine import recipe

        return recipe(self.recipe, **dict(self.overrides))

    def opened(self) -> Capture | None:
        """The capture as its condition or protocol opens it, None for a plain one."""
        if self.condition:
            return CONDITIONS[self.condition].opened(Path(self.capture))
        if not self.protocol:
            return None
        from .protocols import captures

        return captures(self.protocol, Path(self.capture), [self.scene])[0][1]

    def of(self, scene: str, folder: Path, method: str, label: str, changes: Mapping[str, Any]) -> Run:
        """The same for a method on a capture, with settings of the recipe of its own.

        Raises:
            FrogError: for a method, recipe or setting that does not exist. It is better said now than hours later.
        """
        overrides = tuple(sorted({**dict(self.overrides), **changes}.items()))
        run = replace(self, scene=scene, capture=str(folder), method=method, label=label, overrides=overrides)
        run.settings()
        return run

    def with_seeds(self, count: int) -> list[Run]:
        """The run with the seeds 0 to ``count`` - 1."""
        return [replace(self, seed=seed) for seed in range(count)]


def ablation_variants(base: Recipe, kinds: Sequence[str]) -> dict[str, dict[str, dict[str, Any]]]:
    """Settings by label by ablation: every choice except that of ``base``.

    Raises:
        FrogError: for an ablation that does not exist.
    """
    from ..engine import FORMS, FUSIONS, SAMPLINGS

    def others(name: str, choices: Sequence[str]) -> dict[str, dict[str, Any]]:
        own = getattr(base, name)
        return {f"{name.split('_')[0]}: {choice}": {name: choice} for choice in choices if choice != own}

    reduced = base.opacity_reduction if base.opacity_reduction != "off" else "unit"
    sampled = base.sampling if base.sampling != "off" else "anchors"
    depth = "mean" if base.sampling_depth == "median" else "median"
    moments = replace(base, moment_seeds=not base.moment_seeds)
    seeds = {
        f"seeds: at {'many times' if moments.moment_seeds else 'one time'}": {"moment_seeds": moments.moment_seeds}
    }
    everything: dict[str, dict[str, dict[str, Any]]] = {
        "fusion": others("fusion", FUSIONS),
        "modulation": {f"modulation: {'off' if base.modulation else 'on'}": {"modulation": not base.modulation}},
        "sampling": {
            **others("sampling", SAMPLINGS),
            f"sampling: {depth} depth": {"sampling": sampled, "sampling_depth": depth},
        },
        # Nothing where a scene of ``base`` cannot have such seeds.
        "seeds": seeds if moments.moments_for(30, 300) != base.moments_for(30, 300) else {},
        "loss": {"loss: without squares": {"square_weight": 0.0}} if base.square_weight else {},
        "opacity": others("opacity_reduction", FORMS),
        "k": {
            f"k = {k:g}": {"opacity_sharpness": k, "opacity_reduction": reduced}
            for k in SHARPNESSES
            if k != base.opacity_sharpness
        },
        "capacity": {
            **{
                f"{base.max_gaussians // part:,} Gaussians": {
                    "max_gaussians": base.max_gaussians // part,
                    "seed_gaussians": base.seed_gaussians // part,
                }
                for part in FEWER_GAUSSIANS
            },
            **{f"{share:.0%} move": {**AUTO, "dynamic_share": share} for share in DYNAMIC_SHARES},
        },
    }
    return {kind: named("ablation", kind, everything) for kind in kinds}


OwnRow = tuple[str, str, Mapping[str, Any]]
"""The label and method of a row of a table, and settings of its own."""


def row_named(row: str) -> OwnRow:
    """A row among ``ROWS``; FrogError for another name."""
    return (AUTO_LABEL, "frog", AUTO) if row == AUTO_ROW else (METHODS[row].title, row, {})


def chart_grid(
    captures: Mapping[str, Path],
    common: Run | None = None,
    *,
    seeds: tuple[int, int] = (3, 1),
    rows: Sequence[str | OwnRow] = ROWS,
    ablation: Sequence[str] = (),
    equal_time: bool = False,
) -> list[Run]:
    """The runs of a chart: the first seed of everything, rows of the main tables before those of ablations, then the
    next seed. Runs at equal time come last, as they need to know how long FRoG took.

    Args:
        captures: folders by scene name.
        common: what all runs share.
        seeds: how often ``MAIN_METHODS`` and the rows of ablations are trained, and all others (not more often).
        rows: of the main table: which of ``ROWS``, and others.
        ablation: which of ``ABLATIONS`` of FRoG.
        equal_time: every method but FRoG a second time, for as long as FRoG took; rows of ``ROWS`` alone.

    Raises:
        FrogError: for a method, recipe, setting or ablation that does not exist.
    """
    common, other_seeds = common or Run(), min(seeds)
    runs: list[Run] = []
    for scene, folder in captures.items():
        for row in rows:
            label, method, changes = row_named(row) if isinstance(row, str) else row
            first = common.of(scene, folder, method, label, changes)
            count = seeds[0] if row in MAIN_METHODS else other_seeds
            runs += first.with_seeds(count)
            if equal_time and isinstance(row, str) and method != "frog" and "frog" in rows:
                runs += replace(first, equal_time=True, group="time").with_seeds(count)
        base = common.of(scene, folder, "frog", "", {}).plain_recipe()
        for kind, variants in ablation_variants(base, ablation).items():
            for label, own in variants.items():
                first = replace(common.of(scene, folder, "frog", label, own), group=kind)
                runs += first.with_seeds(seeds[0])
    return sorted(runs, key=lambda run: (run.equal_time, run.seed, run.group != "methods"))


def named_captures(folders: Sequence[Path]) -> dict[str, Path]:
    """Folders by their names; UsageError if two have the same."""
    named: dict[str, Path] = {}
    for folder in folders:
        name = folder.resolve().name
        if name in named:
            raise UsageError(f"{folder}: another capture is called {name!r} too, expected folders of different names.")
        open_capture(folder)  # what is none is refused before the first run
        named[name] = folder
    return named
