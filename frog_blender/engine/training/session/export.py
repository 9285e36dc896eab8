"""A training's scene as a file: the arrays that playback needs, quantized where that is not visible, and a report."""

from .. import passive_threads  # noqa: F401

# isort: split
import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from numpy.typing import NDArray

from ...errors import UsageError, reason
from ...field.names import CANONICAL, PER_GAUSSIAN
from ...gaussians import TorchGaussians
from ...io.atomic_files import write_atomically
from ...io.plain_values import JsonObject
from ...model.canonical import ATTRIBUTES
from ...playback.player import ScenePlayer
from ...scene.compression_report import StepKind
from ...scene.header import SceneHeader
from ...scene.quantization import morton_order_by_range, unpack
from ...scene.scene_file import SceneFile, packed_arrays, scene_bytes, settings_json
from ..compression.budget import fit_within, keep_within
from ..compression.context import Compression, CompressionStep, compression_of
from ..optimize.gaussian_state import GaussianState
from .session import Session

EVALUATED_SHOTS = 30
"""Images, at most, that a finished scene's PSNR is the mean of."""

Metrics = Mapping[str, float | str]
"""What was measured of a scene: ``psnr`` (dB) and ``split`` ("held-out" or "training")."""

_REPORT_BYTES = 4000  # for what is left out when a budget is measured: report, metrics, times


def export_scene(session: Session, path: Path) -> None:
    """Writes the scene to ``path`` as training stands; see ``build_scene``.

    Raises:
        FrogError: the disk does not accept it; nothing was changed there.
    """
    write_atomically(path, build_scene(session, {})[1])


def build_scene(session: Session, metrics: Metrics) -> tuple[SceneFile, bytes, str]:
    """The scene as training stands: quantized with ``capacity="auto"``, unless it is to be lossless or that is visible.

    Whatever fails on the way to a smaller file, every number is written as it is instead. Metrics that are not finite
    are left out, since no header can hold them.

    Returns:
        What it holds, the bytes of its file, and a sentence where something optional failed and was left out.
    """
    finite = {name: value for name, value in metrics.items() if not isinstance(value, float) or math.isfinite(value)}
    compression, warning = compression_of(session.trainer), ""
    if compression is not None and not session.job.lossless:
        try:
            return *_compact(session, compression, finite), ""
        except Exception as error:
            warning = f"The scene could not be packed ({reason(error)}): every number is written as it is."
    scene = scene_as_it_stands(session, finite)
    return scene, scene_bytes(scene), warning


def check_budget(session: Session) -> str | None:
    """Checks a budget of bytes before a training begins.

    Returns:
        A warning where the budget may hold nothing.

    Raises:
        FrogError: not even a single Gaussian with an empty network fits.
    """
    budget = session.job.max_bytes
    if not budget:
        return None
    scene, draw = scene_as_it_stands(session), np.random.default_rng(0)
    one = {name: array[:1] if name in PER_GAUSSIAN else array for name, array in scene.arrays.items()}
    least = _packed_size(SceneFile(scene.header, one))
    if least > budget:
        raise UsageError(f"The budget of {budget} bytes is too small: expected at least {least}.")
    # Learned values take more bytes than initial zeros; how much of the network is needed shows late.
    learned = {name: draw.standard_normal(array.shape, np.float32) for name, array in one.items()}
    usual = _packed_size(SceneFile(scene.header, learned))
    if usual <= budget:
        return None
    return f"The budget of {budget} bytes may be too small: the whole network takes {usual}."


def fit_budget(session: Session) -> None:
    """Prunes Gaussians until the scene is within its limit and budgets; call it before the last evaluation.

    The budget of bytes holds for a finished training, since much changes at its end.
    """
    trainer, budget = session.trainer, session.job.max_bytes
    compression = compression_of(trainer)
    if not compression:
        return
    keep_within(compression, trainer.recipe.kept_at_most)
    if budget and trainer.finished:
        fit_within(compression, lambda: _packed_size(reorder_for_playback(scene_as_it_stands(session))), budget)


def remove_non_finite(gaussians: GaussianState) -> None:
    """Removes Gaussians with non-finite parameters, unless there are no others."""
    canonical = gaussians.canonical
    finite = torch.ones(len(canonical.means), dtype=torch.bool, device=canonical.means.device)
    for name in ATTRIBUTES:
        values = getattr(canonical, name).detach()
        rows = torch.isfinite(values).reshape(len(values), math.prod(values.shape[1:]))
        finite[: len(values)] &= rows.all(1)
    if bool(finite.any()) and not bool(finite.all()):
        gaussians.keep(finite.nonzero().squeeze(1))


def _packed_size(scene: SceneFile) -> int:
    """Bytes of a packed file, at most; the same for the same training on any day."""
    header = replace(scene.header, capacity={})
    return len(scene_bytes(SceneFile(header, scene.arrays), compact=True)) + _REPORT_BYTES


def _compact(session: Session, compression: Compression, metrics: Metrics) -> tuple[SceneFile, bytes]:
    trainer, budget = session.trainer, session.job.max_bytes
    scene = reorder_for_playback(scene_as_it_stands(session, metrics))
    content = scene_bytes(scene, compact=True)
    if not trainer.finished:
        return scene, content
    packing = packing_step(compression, scene, len(content))
    compact = packing.loss is None or packing.loss <= compression.settings.max_packing_loss or bool(budget)
    report = compression_report(session, [*compression.log, packing] if compact else compression.log)
    scene = replace(scene, header=replace(scene.header, capacity=report))
    return scene, scene_bytes(scene, compact=compact)


def scene_as_it_stands(session: Session, metrics: Metrics | None = None) -> SceneFile:
    """The scene as training stands. On the CPU its arrays are the training's own: see ``_arrays``."""
    job, trainer, capture = session.job, session.trainer, session.capture
    shots: list[list[int]] = [[] for _ in capture.cameras]
    for shot in capture.shots:
        shots[shot.camera].append(shot.frame)
    compression, is_dynamic = compression_of(trainer), trainer.gaussians.num_dynamic > 0
    header = SceneHeader(
        method=trainer.options.method,
        recipe=settings_json(trainer.recipe),
        model=trainer.model.stored_settings(trainer.schedule_state()) if is_dynamic else {},
        cameras=capture.cameras,
        camera_shots=tuple(tuple(frames) for frames in shots),
        test_cameras=tuple(sorted(capture.test_cameras)),
        test_frames=tuple(sorted(capture.test_frames)),
        frame_count=capture.frame_count,
        frames_per_second=capture.frames_per_second,
        background=capture.background,
        capture_path=str(Path(job.capture).resolve()),
        capture_format=capture.format,
        scale=session.scale,
        pixel_offsets=dict(job.pixel_offsets or {}),
        world=capture.world,
        masks=job.mask_settings,
        layout=job.layout,
        made_of=trainer.made_of,
        low_pass=trainer.recipe.low_pass,
        metrics=dict(metrics or {}),
        steps=trainer.step_count,
        capacity=compression_report(session, compression.log) if compression else {},
    )
    return SceneFile(header, _arrays(session))


def _arrays(session: Session) -> dict[str, NDArray[np.generic]]:
    """What the file holds, by its names; on the CPU not copied."""
    trainer, arrays = session.trainer, {}
    for name, value in trainer.model.state_dict().items():
        name = name.removeprefix("canonical.").replace("deformation.", "network.")
        arrays[name] = value.detach().cpu().numpy()
    if not trainer.gaussians.num_dynamic:  # the network has nothing to deform
        arrays = {name: array for name, array in arrays.items() if name in CANONICAL}
    elif not arrays["embeddings"].size:
        del arrays["embeddings"]
    return arrays


def compression_report(session: Session, steps: list[CompressionStep]) -> JsonObject:
    """What the header's ``capacity`` holds."""
    trainer = session.trainer
    canonical = trainer.model.canonical
    return {
        "gaussians": trainer.count,
        "dynamic": trainer.gaussians.num_dynamic,
        "sh_degree": int(canonical.sh.shape[1] ** 0.5) - 1,
        "reductions": [step.to_json() for step in steps],
    }


def reorder_for_playback(scene: SceneFile) -> SceneFile:
    """The scene with neighbours together, dynamic Gaussians before static ones."""
    count, deformed = len(scene.arrays["means"]), len(scene.arrays.get("embeddings", ()))
    order = morton_order_by_range(scene.arrays["means"], *({deformed} - {0, count}))
    arrays = {n: array[order[: len(array)]] if n in PER_GAUSSIAN else array for n, array in scene.arrays.items()}
    return SceneFile(scene.header, arrays)


def as_packed(scene: SceneFile) -> SceneFile:
    """The scene with numbers as they come back from a packed file; FrogError where none can hold them."""
    packed = packed_arrays(scene.arrays)
    return SceneFile(scene.header, {name: unpack(array.content, array.description) for name, array in packed.items()})


def packing_step(context: Compression, scene: SceneFile, size: int) -> CompressionStep:
    """What packing a reordered scene into ``size`` bytes saves and costs."""
    packed, device = ScenePlayer(as_packed(scene)), context.training.gaussians.device

    def played(time_: float) -> TorchGaussians:
        return packed.at(time_).mapped(lambda array: torch.from_numpy(np.array(array)).to(device))

    plain = sum(array.nbytes for array in scene.arrays.values())
    loss = context.evaluator().now - context.evaluator(played).now
    return CompressionStep(StepKind.PACK, 1.0, plain, size, loss, bytes=plain - size)
