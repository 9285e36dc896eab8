"""Model no more than a scene needs: rounds that leave Gaussians out, put them to rest or wake them, judged on images.

With ``capacity="auto"`` a training withholds a few of its images for a while (training.validation). Rounds measure
what each Gaussian adds to images and how much of its motion can be seen (training.motion), and take away as much as
those images allow (training.reductions, training.narrowing): Gaussians while steps can make up for them, motion and
the network's units mostly at the end.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

import numpy as np
import torch

from ...capture.time import frame_to_time
from ...model.frog import Frog
from ...model.interface import SceneModel
from ...rasterizer import GaussianArrays
from ...scene.compression_report import reduction_line
from ..optimize.gaussian_order import arrange, gaussians_at, mean_dynamic_state
from .network_pruning import narrow
from .passes import (
    ALLOWED_LOSS_AT_END,
    freeze_static_regions,
    prune,
    reduce_sh_degree,
    rest,
    silence_heads,
    unfreeze_high_error,
)
from .sensitivity import Motion, SampledView, Sensitivity, measure, sample_views
from .static_regions import is_static_capture
from .validation import ValidationEvaluator, validation_shots

if TYPE_CHECKING:
    from ..optimize.trainer import Trainer

PRUNE_AT = 0.8
MILESTONES = {0.1: "rest", 0.3: "wake", 0.6: "wake", PRUNE_AT: "prune", 1.0: "finish"}
"""What happens at which fraction of the training. What lies where images do not change rests early, if it is much,
and costs no step any more; then the rest of what hardly moves does so at the fourth. Elsewhere motion is learned to the
end: what was put to rest before it, however little it moved, cost others 0.1 dB (docs/experiments/compression.md)."""
WITHHELD = (0.75, PRUNE_AT)
"""Fractions of the training between which the withheld images are not learned from: long enough that they lose what
test images lose when Gaussians are left out, and no longer, since what is at rest then cannot learn them any more. By
what the last round takes, images that were learned from lose no less."""
_LOOKS, _JUDGED = 24, 8  # views that Gaussians are measured on; images that judge where none was withheld
NUM_BUDGET_VIEWS = 72
"""Where what images need has to be weighed, few moments and sides must be overlooked."""


@dataclass(frozen=True)
class CompressionStep:
    """What one round did in one respect.

    Attributes:
        what: "pruned", "put to rest", "woken", "SH degree", "network width", "head ...", "only fade",
            "keep their shape", "packed" or "unseen left out".
        progress: of the training, 0 to 1.
        before, after: Gaussians, those that move (of "put to rest" and "woken"), the degree, hidden units, heads,
            Gaussians that are deformed at all, that turn and grow, or that are deformed for a frame, or bytes.
        loss: dB that it cost on the withheld images before training went on; None where nothing was measured.
        milliseconds: that it saves a frame: of drawing, or of deformation.
        bytes: that it saves, of numbers as training has them.
    """

    what: str
    progress: float
    before: int
    after: int
    loss: float | None = None
    milliseconds: float = 0.0
    bytes: int = 0


class CompressionFailed(Exception):
    """A round ended in an error, which is its cause: what it left is of no use."""

    @property
    def error(self) -> Exception:
        """The cause."""
        assert isinstance(self.__cause__, Exception)
        return self.__cause__


class CompressionSchedule:
    """The rounds of one training.

    Args:
        seed: the training's; a resumed training finds the same images and looks.

    Attributes:
        seed: the same.
        withheld: shots that training leaves alone for a while, see ``withheld_at``.
        judged, looked_at: shots that reductions are judged on, and that Gaussians are measured on.
        reductions: so far.
        removed: (n, 3) canonical means of what was pruned.
        motion: of those that move, as of the round that leaves out: what moves least then does so at the end, too, and
            measuring takes as long as everything else of a round. None where it was not measured.
    """

    def __init__(self, trainer: Trainer, seed: int) -> None:
        self._capture = trainer.capture
        self._seed_with(seed)
        self.reductions: list[CompressionStep] = []
        self._told = 0
        self.removed = np.empty((0, 3), np.float32)
        self.motion: Motion | None = None

    def withheld_at(self, progress: float) -> tuple[int, ...]:
        """The shots that are not to be learned from at ``progress``."""
        return self.withheld if WITHHELD[0] <= progress < WITHHELD[1] else ()

    @staticmethod
    def settled(progress: float) -> bool:
        """True when nothing is to be added any more: what came now would have no time to learn, in places that were
        just cleared (the papers' recipes grow until 95 %)."""
        return progress >= PRUNE_AT

    def _seed_with(self, seed: int) -> None:
        self.seed = seed
        self.withheld = validation_shots(self._capture, seed)
        training = self._capture.train_indices
        self.judged = self.withheld or tuple(training[:: max(1, len(training) // _JUDGED)])
        self.looked_at = [i for i in training if i not in self.withheld]

    def resume(self, seed: int, reductions: list[CompressionStep], removed: np.ndarray, motion: Motion | None) -> None:
        """Takes over a checkpoint's training; TypeError or ValueError for what does not fit."""
        for reduction in reductions:
            reduction_line(asdict(reduction))  # said to people at the end
        if removed.dtype != np.float32 or removed.shape[1:] != (3,):
            raise ValueError(f"removed is {removed.dtype} of {removed.shape} instead of float32 of (n, 3)")
        torch.Generator("cpu").manual_seed(1000 * seed)  # as every round will
        self._seed_with(seed)
        self.removed, self.motion = removed, motion
        self.reductions, self._told = reductions, len(reductions)

    def news(self) -> list[CompressionStep]:
        """The reductions since this was called last."""
        new, self._told = self.reductions[self._told :], len(self.reductions)
        return new

    def psnr_with(
        self, trainer: Trainer, change: Callable[[str, torch.Tensor], torch.Tensor], most: int | None = None
    ) -> float:
        """On the withheld images, ``most`` of them at most, with ``change(name, value)`` in place of the model's
        tensors."""
        kept = {name: value.clone() for name, value in trainer.model.state_dict().items()}
        trainer.model.load_state_dict({name: change(name, value) for name, value in kept.items()})
        changed = self.judge(trainer, most).now
        trainer.model.load_state_dict(kept)
        return changed

    def begin(self, trainer: Trainer) -> None:
        """Lets everything rest from the start where the images show no motion."""
        if is_static_capture(trainer.capture, trainer.store):
            everyone = torch.arange(trainer.count, device=trainer.device)
            arrange(trainer, everyone, everyone[:0])
            self.note("put to rest", trainer, trainer.count, 0)

    def after_step(self, trainer: Trainer, before: float, now: float) -> None:
        """Holds the rounds that lie in (before, now]; CompressionFailed where one cannot be held."""
        if not self.settled(now):
            self.motion = None  # of a training that was resumed for more steps: Gaussians come and go again
        for number, (at, kind) in enumerate(MILESTONES.items()):
            if before < at <= now:
                trainer.before_round()
                try:
                    self._round(trainer, kind, self.generator(number))
                except Exception as error:
                    raise CompressionFailed(kind) from error

    def generator(self, number: int = len(MILESTONES)) -> torch.Generator:
        """A round's own, or the end's, so that a resumed training draws what an undisturbed one does."""
        return torch.Generator("cpu").manual_seed(1000 * self.seed + number)

    def _round(self, trainer: Trainer, kind: str, generator: torch.Generator) -> None:
        match kind:
            case "rest":
                freeze_static_regions(self, trainer, generator)
            case "wake":
                unfreeze_high_error(self, trainer, generator)
            case "prune":
                self._leave_out(trainer, generator)
            case "finish" if trainer.model.canonical.num_dynamic:
                self._finish(trainer, generator)

    def _leave_out(self, trainer: Trainer, generator: torch.Generator) -> None:
        looks = self.sample_views(generator, NUM_BUDGET_VIEWS if trainer.recipe.kept_gaussians else _LOOKS)
        judge = self.judge(trainer)
        measured = prune(self, trainer, judge, self.measure(trainer, looks, generator))
        reduce_sh_degree(self, trainer, judge)
        self.motion = measured.motion
        if self._rests_before_the_end(trainer):
            rest(self, trainer, judge, measured.motion, measured.state)

    def _finish(self, trainer: Trainer, generator: torch.Generator) -> None:
        looks, judge = self.sample_views(generator), self.judge(trainer)
        if not self._rests_before_the_end(trainer):
            self.motion = self.motion or self.measure(trainer, looks, generator).motion
            rest(self, trainer, judge, self.motion, mean_dynamic_state(trainer, looks), ALLOWED_LOSS_AT_END)
        narrow(self, trainer, judge, looks, generator)
        silence_heads(self, trainer, judge)

    @staticmethod
    def _rests_before_the_end(trainer: Trainer) -> bool:
        """Where some rest already; and where a share is forced, for which steps have to make up."""
        return trainer.model.canonical.num_dynamic < trainer.count or trainer.recipe.dynamic_share > 0

    def sample_views(self, generator: torch.Generator, count: int = _LOOKS) -> list[SampledView]:
        """At the images that are learned from."""
        return sample_views(self._capture, self.looked_at, count, generator)

    def measure(self, trainer: Trainer, looks: list[SampledView], generator: torch.Generator) -> Sensitivity:
        """Of the Gaussians as they stand."""
        moving = trainer.model.canonical.num_dynamic
        return measure(lambda moment: gaussians_at(trainer, moment), moving, trainer.capture, looks, generator)

    def judge(
        self,
        trainer: Trainer,
        most: int | None = None,
        played: Callable[[float], GaussianArrays] | None = None,
    ) -> ValidationEvaluator:
        """Of the Gaussians as they stand, or as they are ``played`` at a time; by ``most`` images at most."""
        capture = trainer.capture

        def gaussians_of(shot: int) -> GaussianArrays:
            moment = frame_to_time(capture.shots[shot].frame, capture.frame_count)
            return played(moment) if played else gaussians_at(trainer, moment)

        return ValidationEvaluator(capture, trainer.store, self.judged[:most], gaussians_of)

    def note(self, what: str, trainer: Trainer, before: int, after: int, loss: float | None = None) -> None:
        """Adds a reduction that saves neither time nor bytes by itself."""
        self.reductions.append(CompressionStep(what, trainer.progress, before, after, loss))

    @contextmanager
    def noted(
        self,
        what: str,
        trainer: Trainer,
        count: Callable[[], int],
        work: Callable[[], object],
        loss: float | None = None,
    ) -> Iterator[None]:
        """Notes what is done inside: ``count()`` before and after, and how much faster ``work`` becomes."""
        before, size, seconds = count(), _bytes_of(trainer), _median_seconds(work)
        yield
        saved = 1e3 * (seconds - _median_seconds(work)), size - _bytes_of(trainer)
        self.reductions.append(CompressionStep(what, trainer.progress, before, count(), loss, *saved))


def heads_of(model: SceneModel) -> list[str]:
    """Names of what a model's network changes; none where nothing moves."""
    return model.heads if isinstance(model, Frog) and model.canonical.num_dynamic else []


def _bytes_of(trainer: Trainer) -> int:
    return sum(parameter.nbytes for parameter in trainer.model.parameters())


def _median_seconds(work: Callable[[], object], times: int = 3) -> float:
    seconds = []
    for _ in range(times):
        started = time.perf_counter()
        work()
        if torch.cuda.is_available():
            torch.cuda.synchronize()
        seconds.append(time.perf_counter() - started)
    return float(np.median(seconds))
