"""FRoG: canonical Gaussians, a temporal table, and one deformation network with early fusion."""

import math
from dataclasses import asdict, replace

import numpy as np
import torch
from torch import nn
from torch.nn import functional

from ..arrays import Array
from ..capture.camera import Camera
from ..cuda import field as cuda_field
from ..cuda import launch
from ..field.network import fuse, temporal_weights
from ..gaussians import TorchGaussians
from ..io.plain_values import JsonObject
from ..native.deformation import FieldShape
from ..rasterizer import GaussianArrays, RasterizeOptions, cpu, cuda, exposed
from ..rasterizer.differentiable import RasterPass
from .canonical import CanonicalField
from .deformation import DeformationField, FrogSettings, reduction_factor, uniform
from .fused import FieldPass, FusedRenderResult, field_arrays, forward_field, versions_of
from .interface import FINISHED, Deformed, RenderResult, SceneModel, ScheduleState

_ATTENTION_WIDTH = 16


class Frog(SceneModel):
    """Canonical Gaussians, temporal table and deformation field; with ``fusion="dual"`` E-D3DGS's two networks."""

    def __init__(self, canonical: CanonicalField, settings: FrogSettings, table_smoothness: float = 0.0) -> None:
        """``table_smoothness`` weighs the mean square of the differences between the table's neighbouring rows."""
        super().__init__()
        self.canonical: CanonicalField = canonical
        self.settings = settings
        self.table_smoothness = table_smoothness
        self.temporal_table = nn.Parameter(initial_table(settings))
        self.deformation = DeformationField(settings)
        if settings.fusion == "attention":
            bound = settings.temporal_size**-0.5
            self.attention_weight = uniform(bound, _ATTENTION_WIDTH, settings.temporal_size)
            self.attention_query = uniform(bound, _ATTENTION_WIDTH)
        if not settings.deformed_opacity:
            self._silence_opacity()

    def fine_rows(self, schedule_state: ScheduleState) -> int:
        """Rows of the fine embedding as its schedule stands."""
        s = self.settings
        return round(s.coarse_rows + (s.temporal_rows - s.coarse_rows) * schedule_state.fine_rows)

    def output_rows(self, name: str) -> slice:
        """Where a head's numbers lie among the outputs."""
        names = list(self.deformation.sizes)
        first = sum(self.deformation.sizes[other] for other in names[: names.index(name)])
        return slice(first, first + self.deformation.sizes[name])

    @torch.no_grad()
    def _silence_opacity(self) -> None:
        """Sets the opacities' outputs to zero and keeps them there: no gradient reaches their weights."""
        rows = self.output_rows("opacity_logits")

        def without_opacity(gradient: torch.Tensor) -> torch.Tensor:
            gradient = gradient.clone()
            gradient[rows] = 0
            return gradient

        for parameter in (self.deformation.output_weight, self.deformation.output_bias):
            parameter[rows] = 0
            parameter.register_hook(without_opacity)

    @property
    def opacity_form(self) -> str:
        """The opacity reduction; none where opacities do not deform."""
        return self.settings.opacity_reduction if self.settings.deformed_opacity else "off"

    def temporal_embedding(self, time: float, schedule_state: ScheduleState = FINISHED) -> torch.Tensor:
        """(networks, T) coarse and fine embedding, fused (FRoG, section on early fusion)."""
        weights = torch.from_numpy(np.stack(self._row_weights(time, schedule_state)))
        table = self.temporal_table
        embeddings = launch.sent(weights.to(table.dtype), table.device) @ table
        fused: torch.Tensor = fuse(self.settings.fusion, embeddings, self._shares)
        return fused

    def _row_weights(self, time: float, schedule_state: ScheduleState) -> list[Array]:
        """The table's rows' weights in the coarse and in the fine embedding."""
        s = self.settings
        rows = (s.coarse_rows, self.fine_rows(schedule_state))
        return [temporal_weights(time, row, s.temporal_rows) for row in rows]

    def _shares(self, embeddings: torch.Tensor) -> torch.Tensor:
        """See ``fuse``: the score of an embedding e is query . tanh(weight e)."""
        return torch.softmax(torch.tanh(embeddings @ self.attention_weight.T) @ self.attention_query, dim=0)

    def deform(self, time: float, schedule_state: ScheduleState = FINISHED) -> Deformed:
        """See SceneModel; by plain torch where gradients are asked for."""
        if not self.canonical.num_dynamic:
            return self.canonical.gaussians(schedule_state.sh_count), {}
        if torch.is_grad_enabled() or not self._is_fused:
            return self.deform_reference(self.temporal_embedding(time, schedule_state), schedule_state)
        _, _, gaussians, changes = self.deform_fused(time, schedule_state)
        return gaussians, self.deformation.by_attribute(changes)

    def deform_fused(
        self, time: float, schedule_state: ScheduleState
    ) -> tuple[dict[str, torch.Tensor], FieldPass | cuda_field.FieldPass, TorchGaussians, torch.Tensor]:
        """Arrays, and what ``forward_field`` gives of them: on a GPU the one of ``cuda.field``."""
        c, shape, low_pass = self.canonical, self.field_shape(schedule_state), self.canonical.low_pass
        if launch.on_gpu(c.means):
            arrays = field_arrays(c, self.deformation, temporal_table=self.temporal_table)
            rows = self._row_weights(time, schedule_state)
            return arrays, *cuda_field.forward_field(shape, self.settings.fusion, rows, arrays, low_pass)
        arrays = field_arrays(c, self.deformation, temporal=self.temporal_embedding(time, schedule_state))
        return arrays, *forward_field(shape, arrays, low_pass)

    def draw(
        self,
        time: float,
        camera: Camera,
        background: tuple[float, float, float],
        options: RasterizeOptions,
        schedule_state: ScheduleState = FINISHED,
        *,
        pose: torch.Tensor | None = None,
    ) -> RenderResult:
        """See SceneModel. Where the field needs no torch, nothing of the result has gradients of its own; its
        ``backward`` brings what automatic differentiation would."""
        if not (self._is_fused and self.canonical.num_dynamic and torch.is_grad_enabled()):
            return super().draw(time, camera, background, options, schedule_state, pose=pose)
        arrays, field, gaussians, changes = self.deform_fused(time, schedule_state)
        drawing: RasterPass
        if launch.on_gpu(gaussians.means):
            rows = None if pose is None else pose.detach()[:3].contiguous()
            drawing, rgb, alpha = cuda.draw(gaussians, camera, background, options, pose=rows, room=self.pair_room)
        else:
            camera = camera if pose is None else camera.with_pose(pose.detach().numpy())
            drawing, rgb, alpha = cpu.draw(gaussians, camera, background, options)
        screen = changes.new_empty((len(gaussians), 2))  # for its gradient alone
        image = exposed(drawing.image(rgb, alpha, screen), camera)
        silent = None if self.settings.deformed_opacity else self.output_rows("opacity_logits")
        by_attribute = self.deformation.by_attribute(changes)
        versions = versions_of(arrays, gaussians)
        return FusedRenderResult(image, gaussians, by_attribute, arrays, pose, field, drawing, silent, versions)

    @property
    def _is_fused(self) -> bool:
        """Whether the native library computes the field, or on a GPU the kernels."""
        means, s = self.canonical.means, self.settings
        if self.backend is not None or means.dtype != torch.float32:
            return False
        if launch.on_gpu(means):
            return cuda_field.can_compute(s.fusion, s.temporal_size, s.embedding_size, s.head_width)
        return means.device.type == "cpu"

    def field_shape(self, schedule_state: ScheduleState) -> FieldShape:
        """What the native library has to know of the field."""
        s = self.settings
        return FieldShape(
            s.head_width,
            schedule_state.sh_count or self.canonical.sh.shape[1],
            s.deformed_sh,
            self.opacity_form,
            s.opacity_sharpness,
            schedule_state.opacity,
            s.motion_unit,
            self.deformation.networks,
        )

    def deform_reference(self, temporal: torch.Tensor, schedule_state: ScheduleState) -> Deformed:
        """``deform`` in plain torch, on any device and in any floating-point type; the fused one is tested against it.

        Args:
            temporal: (networks, T) fused temporal embedding.
        """
        c, s = self.canonical, self.settings
        changes = self.deformation(temporal, c.embeddings)
        changes["means"] = changes["means"] * s.motion_unit
        # Nothing is added to static Gaussians.
        added = {name: functional.pad(change, (0, 0, 0, len(c) - c.num_dynamic)) for name, change in changes.items()}
        opacities = torch.sigmoid(c.opacity_logits + added["opacity_logits"].squeeze(1))
        if self.opacity_form != "off":
            factor = reduction_factor(
                changes["opacity_logits"].squeeze(1), self.opacity_form, s.opacity_sharpness, schedule_state.opacity
            )
            opacities = opacities * functional.pad(factor, (0, len(c) - c.num_dynamic), value=1.0)
        sh = c.sh
        if s.deformed_sh:
            d_sh = added["sh"].reshape(len(c), s.deformed_sh, 3)
            sh = torch.cat([sh[:, : s.deformed_sh] + d_sh, sh[:, s.deformed_sh :]], dim=1)
        gaussians = GaussianArrays(
            c.means + added["means"],
            c.quaternions + added["quaternions"],
            (c.log_scales + added["log_scales"]).exp(),
            opacities,
            sh[:, : schedule_state.sh_count],
            low_pass=c.low_pass,
        )
        return gaussians, changes

    def rate_groups(self) -> dict[str, list[nn.Parameter]]:
        network = list(self.deformation.parameters())
        if self.settings.fusion == "attention":
            network += [self.attention_weight, self.attention_query]
        return {"temporal": [self.temporal_table], "network": network}

    def regularization(self) -> torch.Tensor | None:
        if not self.table_smoothness:
            return None
        return self.table_smoothness * functional.mse_loss(self.temporal_table[1:], self.temporal_table[:-1])

    def stored_settings(self, schedule_state: ScheduleState) -> JsonObject:
        """Schedules included: a scene stopped early plays as it was trained."""
        settings = replace(
            self.settings,
            fine_rows=self.fine_rows(schedule_state),
            opacity_share=schedule_state.opacity,
            opacity_reduction=self.opacity_form,
        )
        return asdict(settings)


def total_deformation(changes: dict[str, torch.Tensor]) -> torch.Tensor:
    """(N,) sum of the attributes' change norms, each in units of its own mean over the Gaussians."""
    norms = [change.detach().norm(dim=1) for change in changes.values()]
    return torch.stack([norm / norm.mean().clamp(min=1e-12) for norm in norms]).sum(0)


def initial_table(settings: FrogSettings) -> torch.Tensor:
    """(rows, T): one plus a sine in each column, of a frequency that two columns share a quarter of a turn apart.

    Around one, because the product of a zero table with itself has no gradient at all; slow waves, because they let
    neighbouring frames learn from each other from the first step (0.5 dB better in the moving region than noise of
    the same size after a short training). The frequencies lie evenly spread and in pairs so that none is missing
    and none depends on its phase: drawn freely they decided more about a training than anything else that is drawn
    (docs/experiments/stability.md). On the CPU, as the network's first weights.
    """
    times = torch.linspace(0, 1, settings.temporal_rows, device="cpu")[:, None]
    waves = -(-settings.temporal_size // 2)
    places = (torch.randperm(waves, device="cpu") + torch.rand(waves, device="cpu")) / waves
    frequencies = places * settings.coarse_rows / 4  # cycles over the capture: half of what the coarse rows could tell
    turns = frequencies * times + torch.rand(waves, device="cpu")
    pairs = torch.stack([turns, turns + 0.25], dim=2).flatten(1)[:, : settings.temporal_size]
    return 1 + torch.sin(2 * math.pi * pairs)
