"""What a comparison runs: every training of a chart, named by what decides its result."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..engine.errors import FrogError
from .corruptions.catalogue import condition_named

if TYPE_CHECKING:
    from ..engine.capture.capture import Capture
    from ..engine.training.recipe import Recipe

METHODS = ("frog", "ed3dgs", "static", "d3dgs", "hexplane", "curves")
"""In the order of the tables."""
AUTO_ROW, AUTO_LABEL, AUTO = "frog-auto", "FRoG auto", {"capacity": "auto"}
"""FRoG with no more than a scene needs (see training.parsimony), a row beside FRoG of a fixed capacity."""
ROWS = ("frog", AUTO_ROW, *METHODS[1:])
"""What a chart's ``methods`` may name."""
FEWER_GAUSSIANS, DYNAMIC_SHARES = (8, 4, 2), (0.05, 0.1, 0.2, 0.4)
"""Of the capacity sweep: parts of the recipe's number, and shares of the Gaussians that may move."""
MAIN_METHODS = ("frog", AUTO_ROW, "ed3dgs")
"""The paper's method and its base: they get the most seeds."""
ABLATIONS = ("fusion", "modulation", "sampling", "opacity", "k", "capacity")
SHARPNESSES = (1.0, 5.0, 10.0, 20.0)
"""Of the opacity reduction: the paper's values of k (its ablation table; 0 is no reduction)."""


@dataclass(frozen=True)
class Run:
    """One training of a grid.

    Attributes:
        scene: the capture's name in the tables; unique in a results file.
        capture: its folder; where the data lies decides nothing.
        method: see ``METHODS``.
        label: the row in the tables: the method's title, or what an ablation changes.
        recipe, overrides: a recipe's name, and settings that differ from it.
        seed: of everything random.
        steps: of training; None for the recipe's own.
        equal_time: limited to the seconds that FRoG took for those steps on the same scene, instead of the steps.
        scale, holdout_frames: see ``TrainingJob``.
        protocol: a paper's protocol that opens the capture, see comparison.protocols; "" for a plain capture.
        group: "methods", "time" or an ablation's name.
        condition: under which the capture is filmed, see conditions.catalogue; "" for as it is.
    """

    scene: str
    capture: str
    method: str
    label: str
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
        """The same for the same training on any day and machine; changes with everything that decides the result but
        the code and the recipes' own settings (see ``runs.is_done`` for those)."""
        left_out = ("capture", "label", "group")
        decides = {name: value for name, value in asdict(self).items() if name not in left_out}
        decides["overrides"] = sorted(self.overrides)
        if not self.condition:
            del decides["condition"]  # as before there were any
        return hashlib.sha256(json.dumps(decides, sort_keys=True).encode()).hexdigest()[:16]

    def settings(self) -> Recipe:
        """The recipe as the method trains it."""
        from ..engine.training.methods import method_named

        return method_named(self.method).adapt(self.plain_recipe())

    def plain_recipe(self) -> Recipe:
        """The recipe before the method adapts it."""
        from ..engine.training.recipe import recipe

        return recipe(self.recipe, **dict(self.overrides))

    def opened(self) -> Capture | None:
        """The capture as its condition or protocol opens it, None for a plain one."""
        if self.condition:
            return condition_named(self.condition).opened(Path(self.capture))
        if not self.protocol:
            return None
        from .protocols import captures

        return captures(self.protocol, Path(self.capture), [self.scene])[0][1]

    def to_json(self) -> str:
        return json.dumps(asdict(self))

    @classmethod
    def from_json(cls, text: str) -> Run:
        values = json.loads(text)
        values["overrides"] = tuple((name, _hashable(value)) for name, value in values["overrides"])
        return cls(**values)


def _hashable(value: Any) -> Any:
    return tuple(value) if isinstance(value, list) else value


def ablation_variants(base: Recipe, kinds: Sequence[str]) -> dict[str, dict[str, dict[str, Any]]]:
    """Settings by label by ablation: every choice but the one that ``base`` makes itself.

    Raises:
        FrogError: for an ablation that does not exist.
    """
    from ..engine.field.names import FORMS, FUSIONS
    from ..engine.training.recipe import SAMPLINGS

    reduced = base.opacity_reduction if base.opacity_reduction != "off" else "unit"
    sampled = base.sampling if base.sampling != "off" else "anchors"
    forms = {f"opacity: {form}": {"opacity_reduction": form} for form in FORMS if form != base.opacity_reduction}
    sampling = {f"sampling: {kind}": {"sampling": kind} for kind in SAMPLINGS if kind != base.sampling}
    depth = "mean" if base.sampling_depth == "median" else "median"
    everything: dict[str, dict[str, dict[str, Any]]] = {
        "fusion": {f"fusion: {fusion}": {"fusion": fusion} for fusion in FUSIONS if fusion != base.fusion},
        "modulation": {f"modulation: {'off' if base.modulation else 'on'}": {"modulation": not base.modulation}},
        "sampling": {**sampling, f"sampling: {depth} depth": {"sampling": sampled, "sampling_depth": depth}},
        "opacity": forms,
        "k": {
            f"k = {k:g}": {"opacity_sharpness": k, "opacity_reduction": reduced}
            for k in SHARPNESSES
            if k != base.opacity_sharpness
        },
        "capacity": {
            **{f"{base.max_gaussians // part:,} Gaussians": _smaller(base, part) for part in FEWER_GAUSSIANS},
            **{f"{share:.0%} move": {**AUTO, "dynamic_share": share} for share in DYNAMIC_SHARES},
        },
    }
    for kind in kinds:
        if kind not in everything:
            raise FrogError(f"There is no ablation {kind!r}; there are {', '.join(everything)}.")
    return {kind: everything[kind] for kind in kinds}


def _smaller(base: Recipe, part: int) -> dict[str, Any]:
    return {"max_gaussians": base.max_gaussians // part, "seed_gaussians": base.seed_gaussians // part}


def row_named(row: str) -> tuple[str, str, dict[str, Any]]:
    """The method, the label and the settings of its own of a name among ROWS; FrogError for another name."""
    from ..engine.training.methods import method_named

    return ("frog", AUTO_LABEL, AUTO) if row == AUTO_ROW else (row, method_named(row).title, {})


def chart_grid(
    captures: Mapping[str, Path],
    *,
    methods: Sequence[str] = ROWS,
    recipe: str = "draft",
    overrides: Mapping[str, Any] | None = None,
    seeds: int = 3,
    other_seeds: int = 1,
    steps: int | None = None,
    scale: float | None = None,
    holdout_frames: int | None = None,
    ablation: Sequence[str] = (),
    ablation_seeds: int | None = None,
    equal_time: bool = False,
    protocol: str = "",
) -> list[Run]:
    """The runs of a chart, ``in_order``.

    Args:
        captures: folders by scene name.
        methods: which of ``ROWS``.
        recipe, overrides, steps, scale, holdout_frames: the same for all.
        seeds, other_seeds: for FRoG and E-D3DGS, and for the others.
        ablation: which of ``ABLATIONS`` of FRoG.
        ablation_seeds: for each of their rows; ``seeds`` if not given.
        equal_time: every method but FRoG a second time, for as long as FRoG took.
        protocol: see ``Run``.

    Raises:
        FrogError: for a method, recipe or ablation that does not exist.
    """
    common = tuple(sorted((overrides or {}).items()))
    runs: list[Run] = []
    for scene, folder in captures.items():
        for method in methods:
            name, label, settings = row_named(method)
            changed = tuple(sorted({**dict(common), **settings}.items()))
            start = Run(
                scene, str(folder), name, label, recipe, changed, 0, steps, False, scale, holdout_frames, protocol
            )
            start.settings()  # says what is mistaken now, not hours later
            count = seeds if method in MAIN_METHODS else min(seeds, other_seeds)
            runs += [replace(start, seed=seed) for seed in range(count)]
            if equal_time and name != "frog" and "frog" in methods:
                timed = replace(start, equal_time=True, group="time")
                runs += [replace(timed, seed=seed) for seed in range(count)]
        start = Run(scene, str(folder), "frog", "", recipe, common, 0, steps, False, scale, holdout_frames, protocol)
        for kind, variants in ablation_variants(start.plain_recipe(), ablation).items():
            for label, changes in variants.items():
                changed = tuple(sorted({**dict(common), **changes}.items()))
                row = replace(start, label=label, overrides=changed, group=kind)
                runs += [replace(row, seed=seed) for seed in range(ablation_seeds or seeds)]
    return in_order(runs)


def in_order(runs: Sequence[Run]) -> list[Run]:
    """A first seed of everything, the main tables' rows before the ablations', then the next seed; those at equal time
    last, as they need to know how long FRoG took."""
    return sorted(runs, key=lambda run: (run.equal_time, run.seed, run.group != "methods"))


def extra_rows(
    captures: Mapping[str, Path],
    rows: Sequence[tuple[str, str, Mapping[str, Any]]],
    *,
    recipe: str = "draft",
    overrides: Mapping[str, Any] | None = None,
    seeds: int = 1,
    steps: int | None = None,
    scale: float | None = None,
    holdout_frames: int | None = None,
    protocol: str = "",
) -> list[Run]:
    """Runs of further rows in the main table: (label, method, settings of its own) on every scene.

    Raises:
        FrogError: for a method or setting that does not exist.
    """
    runs = []
    for label, method, changes in rows:
        for scene, folder in captures.items():
            settings = tuple(sorted({**(overrides or {}), **changes}.items()))
            run = Run(
                scene, str(folder), method, label, recipe, settings, 0, steps, False, scale, holdout_frames, protocol
            )
            run.settings()  # says what is mistaken now, not hours later
            runs += [replace(run, seed=seed) for seed in range(seeds)]
    return runs


def named_captures(folders: Sequence[Path]) -> dict[str, Path]:
    """Folders by their own names; FrogError when two have the same."""
    named: dict[str, Path] = {}
    for folder in folders:
        name = folder.resolve().name
        if name in named:
            raise FrogError(f"{folder}: another capture is called {name!r} too, expected folders of different names.")
        named[name] = folder
    return named
