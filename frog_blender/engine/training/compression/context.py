"""What compression passes share: the training, the validation images, the views that they measure on, and the log."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ...gaussians import TorchGaussians
from ...io.plain_values import JsonObject
from ...scene.compression_report import StepKind, reduction_line
from ..optimize.gaussian_state import Reindexing
from ..optimize.stateful import Tensors, Values, expect
from ..optimize.training import Hook, Training
from .sensitivity import Motion, SampledView, Sensitivity, canonical_state, measure, ranges_of, sample_views
from .settings import DEFAULT, CompressionSettings
from .validation import ValidationEvaluator, largest_count_within, validation_shots


@dataclass(frozen=True)
class CompressionStep:
    """What one pass did.

    Attributes:
        what: the kind of step.
        progress: of the training, 0 to 1.
        before, after: see compression_report for what they count.
        loss: dB that it cost on the validation images before training went on; None where nothing was measured.
        bytes: that it saves, of numbers as training has them.
        is_forced: a limit made it cost more than is allowed otherwise.
    """

    what: StepKind
    progress: float
    before: int
    after: int
    loss: float | None = None
    bytes: int = 0
    is_forced: bool = False

    @classmethod
    def from_json(cls, values: JsonObject) -> CompressionStep:
        """What ``to_json`` gave; TypeError or ValueError for other values."""
        reduction_line(values)  # said to people at the end
        return cls(**{**values, "what": StepKind(values["what"])})

    def to_json(self) -> JsonObject:
        """Plain values."""
        return {**asdict(self), "what": self.what.value}


@dataclass(frozen=True)
class Proposal:
    """Something that can be taken from a model, in an order in which it is missed least first.

    Attributes:
        kind: for the log.
        apply: takes the first so many.
        loss: dB that taking the first so many costs.
        allowed: dB.
        expected: (candidates,) about that loss for the first one, the first two and so on, ascending.
        forced: so many are taken whatever they cost.
    """

    kind: StepKind
    apply: Callable[[int], None]
    loss: Callable[[int], float]
    allowed: float
    expected: NDArray[np.float64]
    forced: int = 0


class Compression(Hook):
    """What passes need of one training, and what it remembers of them: it measures by sampled views, is evaluated on
    validation images, and logs.

    Args:
        settings: thresholds, and how many images stand in for validation images.

    Attributes:
        settings: the same.
        training: as it stands.
        seed: the training's; a resumed training finds the same images and views.
        validation: validation shots, which are not learned from for a while; none where there are few.
        evaluated, learned: shots that proposals are evaluated on, and that views are sampled from.
        log: steps so far.
        motion: of the dynamic Gaussians, as measured when pruning: what moves least then does so at the end, too. None
            where it was not measured.
        mean_state: how the dynamic Gaussians look on average (see ``Sensitivity.state``), during a milestone.
    """

    training: Training

    def __init__(self, settings: CompressionSettings = DEFAULT) -> None:
        self.settings = settings
        self.log: list[CompressionStep] = []
        self._told = 0
        self.motion: Motion | None = None
        self.mean_state: Tensors = {}

    def begin(self, training: Training) -> None:
        """See Hook."""
        self.training = training
        self._seed_with(training.options.seed)
        training.gaussians.register(self._reindex)

    def _seed_with(self, seed: int) -> None:
        self.seed = seed
        self.validation = validation_shots(self.training.capture, seed)
        training = self.training.capture.train_indices
        step = max(1, len(training) // self.settings.num_training_views)
        self.evaluated = self.validation or tuple(training[::step])
        self.learned = [i for i in training if i not in self.validation]

    def _reindex(self, change: Reindexing) -> None:
        """What was measured is void where static Gaussians become dynamic."""
        known = bool((change.dynamic < change.num_dynamic).all())
        self.motion = self.motion.select(change.dynamic) if self.motion and known else None
        self.mean_state = {name: values[change.dynamic] for name, values in self.mean_state.items()} if known else {}

    def state(self) -> tuple[Tensors, Values]:
        """See Stateful."""
        motion = vars(self.motion) if self.motion else {}
        tensors = {f"motion.{name}": values for name, values in motion.items()}
        return tensors, {"parsimony": {"seed": self.seed, "reductions": [step.to_json() for step in self.log]}}

    def load_state(self, tensors: Tensors, values: Values) -> None:
        """See Stateful."""
        stored = values["parsimony"]
        log = [CompressionStep.from_json(step) for step in stored["reductions"]]
        torch.Generator("cpu").manual_seed(1000 * stored["seed"])  # as every milestone will
        self._seed_with(stored["seed"])
        self.motion = None
        if "motion.score" in tensors:
            device = self.training.gaussians.device
            arrays = [expect(name, tensors[f"motion.{name}"], (self.num_dynamic,)) for name in ("score", "rest_energy")]
            self.motion = Motion(*(array.to(device) for array in arrays))
        self.log, self._told = log, len(log)

    def new_steps(self) -> list[CompressionStep]:
        """The steps since this was called last."""
        new, self._told = self.log[self._told :], len(self.log)
        return new

    @property
    def num_dynamic(self) -> int:
        """Dynamic Gaussians."""
        return self.training.gaussians.num_dynamic

    def generator(self, milestone: int) -> torch.Generator:
        """A milestone's own, so that a resumed training draws what an undisturbed one does."""
        return torch.Generator("cpu").manual_seed(1000 * self.seed + milestone)

    @torch.no_grad()
    def gaussians_at(self, time: float) -> TorchGaussians:
        """All Gaussians at a time in [0, 1]; what is done with them leaves the model no gradient."""
        return self.training.deform(time)[0].mapped(torch.Tensor.detach)

    def sample_views(self, generator: torch.Generator, count: int | None = None) -> list[SampledView]:
        """Views near the images that are learned from."""
        count = self.settings.num_sensitivity_views if count is None else count
        return sample_views(self.training.capture, self.learned, count, generator)

    def measure(self, views: Sequence[SampledView], generator: torch.Generator) -> Sensitivity:
        """Of the Gaussians as they stand."""
        training = self.training
        return measure(self.gaussians_at, self.num_dynamic, training.capture, views, generator, training.mattes)

    def mean_dynamic_state(self, views: Sequence[SampledView]) -> Tensors:
        """How the dynamic Gaussians look on average over the views, see ``Sensitivity.state``."""
        ranges = ranges_of(self.gaussians_at, views, self.num_dynamic)
        return canonical_state({name: values.mean for name, values in ranges.items()})

    def evaluator(self, played: Callable[[float], TorchGaussians] | None = None) -> ValidationEvaluator:
        """Of the Gaussians as they stand, or as they are ``played`` at a time."""
        training = self.training
        return ValidationEvaluator(training.capture, training.mattes, self.evaluated, played or self.gaussians_at)

    def compress(self, evaluator: ValidationEvaluator, proposal: Proposal | None) -> None:
        """Takes as much of a proposal as the validation images allow, or as is forced, and logs it."""
        if proposal is None:
            return
        taken, loss = largest_count_within(proposal.loss, proposal.expected, proposal.allowed)
        if proposal.forced > taken:
            taken, loss = proposal.forced, proposal.loss(proposal.forced)
        if not taken:
            return
        before, size = self._count(proposal.kind), self._size()
        proposal.apply(taken)
        self.add_step(proposal.kind, before, loss, size - self._size(), is_forced=loss > proposal.allowed)
        evaluator.accept(loss)

    def add_step(
        self, kind: StepKind, before: int, loss: float | None = None, saved: int = 0, is_forced: bool = False
    ) -> None:
        """Adds a step that was just done to the log; ``saved`` bytes."""
        after = self._count(kind)
        self.log.append(CompressionStep(kind, self.training.progress, before, after, loss, saved, is_forced))

    def _count(self, kind: StepKind) -> int:
        """What ``kind.unit`` says, as the model stands."""
        return self.num_dynamic if kind is StepKind.FREEZE else self.training.gaussians.count

    def _size(self) -> int:
        return sum(parameter.nbytes for parameter in self.training.gaussians.model.parameters())


def compression_of(training: Training) -> Compression | None:
    """What compresses a training, if anything does."""
    return next((hook for hook in training.hooks if isinstance(hook, Compression)), None)
