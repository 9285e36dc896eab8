"""FRoG: canonical Gaussians, a temporal table, and one deformation network with early fusion."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import nn

from ..rasterizer import GaussianArrays
from ..rasterizer.native_deformation import FieldShape
from .canonical import CanonicalField
from .deformation import DeformationField
from .fused import deform_fused
from .opacity import reduction_factor
from .temporal import temporal_weights


@dataclass(frozen=True)
class FrogSettings:
    """The shape of the model; written into the scene file, since playback needs it.

    Attributes:
        temporal_rows, coarse_rows: rows of the table, and rows it is resampled to for the coarse embedding.
        temporal_size, embedding_size: lengths of t and e.
        hidden_width, head_width: see DeformationField.
        deformed_sh: SH coefficients that deform.
        opacity_reduction, opacity_sharpness: see model.opacity.
        motion_unit: world units that a network output of one moves a Gaussian by (makes rates independent of the
            capture's units).
        fine_rows, opacity_share: how far the schedules had come when the scene was written; all rows (0) and 1 unless
            training was stopped early.
    """

    temporal_rows: int
    coarse_rows: int
    temporal_size: int = 64
    embedding_size: int = 32
    hidden_width: int = 64
    head_width: int = 0
    deformed_sh: int = 1
    opacity_reduction: str = "unit"
    opacity_sharpness: float = 10.0
    motion_unit: float = 1.0
    fine_rows: int = 0
    opacity_share: float = 1.0


@dataclass(frozen=True)
class Progressing:
    """How far the schedules inside the model have come, each from 0 to 1 (all 1 in a finished scene).

    Attributes:
        fine_rows: the fine embedding's rows grow from the coarse to all (E-D3DGS's coarse-to-fine schedule).
        opacity: how far the opacity reduction is ramped in.
    """

    fine_rows: float = 1.0
    opacity: float = 1.0


FINISHED = Progressing()


class Frog(nn.Module):
    """``model(time)`` gives the Gaussians at a time in [0, 1]; ``model.deform`` also what was added to them."""

    def __init__(self, canonical: CanonicalField, settings: FrogSettings) -> None:
        super().__init__()
        self.canonical: CanonicalField = canonical
        self.settings = settings
        self.temporal_table = nn.Parameter(initial_table(settings))
        self.deformation = DeformationField(
            settings.embedding_size,
            settings.temporal_size,
            settings.hidden_width,
            settings.head_width,
            settings.deformed_sh,
        )

    def fine_rows(self, progressing: Progressing) -> int:
        """Rows of the fine embedding as its schedule stands."""
        s = self.settings
        return round(s.coarse_rows + (s.temporal_rows - s.coarse_rows) * progressing.fine_rows)

    def temporal_embedding(self, time: float, progressing: Progressing = FINISHED) -> torch.Tensor:
        """(T,) coarse and fine embedding fused by the Hadamard product (FRoG, section on early fusion)."""
        s = self.settings
        fine_rows = self.fine_rows(progressing)
        return self._resampled(time, s.coarse_rows) * self._resampled(time, fine_rows)

    def _resampled(self, time: float, rows: int) -> torch.Tensor:
        """(T,) the table at ``time`` when resampled to ``rows`` rows."""
        table = self.temporal_table
        weights = torch.from_numpy(temporal_weights(time, rows, self.settings.temporal_rows))
        if table.is_cuda:  # from pinned memory a copy does not wait for the work that is queued before it
            weights = weights.pin_memory()
        return weights.to(table.device, non_blocking=True) @ table

    def deform(
        self, time: float, progressing: Progressing = FINISHED, sh_count: int | None = None
    ) -> tuple[GaussianArrays, dict[str, torch.Tensor]]:
        """The Gaussians at ``time`` and the changes (N, size) by attribute, means in world units.

        Args:
            sh_count: coefficients that come out, from the first; None for all.
        """
        sh_count = sh_count or self.canonical.sh.shape[1]
        temporal = self.temporal_embedding(time, progressing)
        means = self.canonical.means
        if means.dtype == torch.float32 and means.device.type == "cpu":
            s = self.settings
            shape = FieldShape(
                s.head_width,
                sh_count,
                s.deformed_sh,
                s.opacity_reduction,
                s.opacity_sharpness,
                progressing.opacity,
                s.motion_unit,
            )
            gaussians, changes = deform_fused(self.canonical, self.deformation, temporal, shape)
            sizes = self.deformation.sizes
            return gaussians, dict(zip(sizes, changes.split(list(sizes.values()), dim=1), strict=True))
        return self.deform_plainly(temporal, progressing, sh_count)

    def deform_plainly(
        self, temporal: torch.Tensor, progressing: Progressing, sh_count: int
    ) -> tuple[GaussianArrays, dict[str, torch.Tensor]]:
        """``deform`` in plain torch, on any device and in any floating-point type; the fused one is tested against it.

        Args:
            temporal: (T,) fused temporal embedding.
        """
        c, s = self.canonical, self.settings
        changes = self.deformation(temporal, c.embeddings)
        changes["means"] = changes["means"] * s.motion_unit
        d_opacity = changes["opacity_logits"].squeeze(1)
        opacities = torch.sigmoid(c.opacity_logits + d_opacity)
        if s.opacity_reduction != "off":
            opacities = opacities * reduction_factor(
                d_opacity, s.opacity_reduction, s.opacity_sharpness, progressing.opacity
            )
        sh = c.sh
        if s.deformed_sh:
            d_sh = changes["sh"].reshape(len(c), s.deformed_sh, 3)
            sh = torch.cat([sh[:, : s.deformed_sh] + d_sh, sh[:, s.deformed_sh :]], dim=1)
        gaussians = GaussianArrays(
            c.means + changes["means"],
            c.quaternions + changes["quaternions"],
            (c.log_scales + changes["log_scales"]).exp(),
            opacities,
            sh[:, :sh_count],
        )
        return gaussians, changes

    def forward(self, time: float, progressing: Progressing = FINISHED) -> GaussianArrays:
        return self.deform(time, progressing)[0]


def total_deformation(changes: dict[str, torch.Tensor]) -> torch.Tensor:
    """(N,) sum of the attributes' change norms, each in units of its own mean over the Gaussians."""
    norms = [change.detach().norm(dim=1) for change in changes.values()]
    return torch.stack([norm / norm.mean().clamp(min=1e-12) for norm in norms]).sum(0)


def initial_table(settings: FrogSettings) -> torch.Tensor:
    """(rows, T): one plus a sine of random frequency and phase in each column.

    Around one, because the product of a zero table with itself has no gradient at all; slow waves, because they let
    neighbouring moments learn from each other from the first step (0.5 dB better in the moving region than noise of
    the same size after a short training). On the CPU, as the network's first weights.
    """
    times = torch.linspace(0, 1, settings.temporal_rows, device="cpu")[:, None]
    # Cycles over the capture.
    frequencies = torch.rand(settings.temporal_size, device="cpu") * settings.coarse_rows / 2
    phases = torch.rand(settings.temporal_size, device="cpu")
    return 1 + torch.sin(2 * math.pi * (frequencies * times + phases))


def rows_for(frame_count: int) -> tuple[int, int]:
    """(temporal rows, coarse rows) for a capture: a row for every two frames up to 150, and a third of them coarse.

    The paper's base uses 150 and 30 for 300 frames; short captures keep a few rows more.
    """
    rows = max(2, min(150, math.ceil(frame_count / 2)))
    return rows, max(2, min(rows, round(rows / 3 if rows < 60 else rows / 5)))
