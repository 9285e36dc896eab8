"""The deformation network at playback (FRoG's, and E-D3DGS's two): numpy and the native library.

What does not depend on time is computed once: without modulation the first layer's product with the Gaussians'
embeddings; static Gaussians and colours that do not deform are written once into the frames' memory. Groups that are
invisible at a time are not deformed, and Gaussians with opacity tracks never are.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from ..arrays import Array, SceneArrays
from ..errors import FrogError, brief
from ..field.first_layer import first_layer
from ..field.names import FORMS
from ..field.opacity_tracks import OpacityTracks
from ..field.output_layout import column_outputs, num_heads, num_outputs
from ..gaussians import GaussianArrays, NumpyGaussians
from ..io.plain_values import JsonMapping
from ..native.deformation import FieldShape, PlaybackField
from ..native.structs import Buffer
from ..scene.scene_file import OPACITY_TRACKS, VISIBILITY
from .buffer_pool import BufferPool
from .canonical import canonical_gaussians
from .frame_delta import FrameDelta, extract_columns
from .simd_layout import num_groups, pack_lanes, transpose_weights
from .temporal import TemporalEmbedding, checked
from .visibility import VisibilityMask

_CANONICAL = ("means", "log_scales", "quaternions", "opacity_logits")


def _checked_arrays(arrays: SceneArrays, model: JsonMapping, temporal: TemporalEmbedding) -> SceneArrays:
    """Contiguous float32 by the native library's names.

    KeyError or ValueError unless every array is what the settings say: the library only sees addresses.
    """
    count, networks, embedding = len(arrays["means"]), temporal.networks, int(model["embedding_size"])
    deformed, fading = len(arrays["embeddings"]), len(arrays.get(OPACITY_TRACKS, ()))
    if deformed + fading > count:
        raise ValueError(f"{deformed + fading} of its {count} Gaussians move")
    hidden, heads, colors = (int(model[name]) for name in ("hidden_width", "head_width", "deformed_sh"))
    outputs = num_outputs(colors)
    if not 0 <= colors <= arrays["sh"].shape[1]:
        raise ValueError("it deforms more colours than there are")
    shapes = {name: (count, *size) for name, size in zip(_CANONICAL, ((3,), (3,), (4,), ()), strict=True)}
    shapes |= {"sh": (count, arrays["sh"].shape[1], 3)}
    if deformed or not fading:  # of a part of a scene all may only fade
        shapes |= {"embeddings": (deformed, embedding)}
    shapes |= {
        "network.embedding_weight": (networks * hidden, embedding),
        "network.temporal_weight": (networks * hidden, temporal.size),
        "network.bias": (networks * hidden,),
        "network.output_weight": (outputs, networks * (heads or hidden)),
        "network.output_bias": (outputs,),
    }
    if model.get("modulation", False):
        if embedding > temporal.size:
            raise ValueError(f"embeddings of {embedding} are modulated by {temporal.size} numbers")
        shapes["network.modulation_weight"] = (networks * hidden, embedding)
    if heads:
        width = networks * heads * num_heads(colors)
        shapes |= {"network.head_weight": (width, hidden), "network.head_bias": (width,)}
    result = {name.removeprefix("network."): checked(arrays, name, shape) for name, shape in shapes.items()}
    return {"embeddings": np.empty((0, embedding), np.float32)} | result


def _shape(model: JsonMapping, sh_count: int, networks: int) -> FieldShape:
    """KeyError or ValueError for settings that cannot be."""
    form, sharpness = model["opacity_reduction"], float(model["opacity_sharpness"])
    if form not in FORMS or not sharpness >= 0:
        raise ValueError(f"the opacity reduction is {form!r}, {sharpness}")
    share = float(model.get("opacity_share", 1.0))
    if not 0 <= share <= 1:
        raise ValueError(f"the opacity reduction's share is {share}")
    head_width, deformed, unit = int(model["head_width"]), int(model["deformed_sh"]), float(model["motion_unit"])
    return FieldShape(head_width, sh_count, deformed, form, sharpness, share, unit, networks)


def _changing(arrays: SceneArrays, deformed: int) -> frozenset[str]:
    """The columns that some output of the network reaches."""
    reached = arrays["output_weight"].any(axis=1) | (arrays["output_bias"] != 0)
    return frozenset(name for name, outputs in column_outputs(deformed).items() if reached[outputs].any())


class DeformationPlayer:
    """Deformed Gaussians at a time, exactly as the training path computes them, but for rounding.

    Args:
        arrays: the scene file's arrays.
        model: the scene header's model settings.

    Attributes:
        num_dynamic: Gaussians that change in time, which come first.
        deformed: those of them that the network moves, which come first; the others have opacity tracks.
        changing: the columns (see frame_delta) that change in time. An output of zeros changes none.
        visibility: when groups of deformed Gaussians are visible; None where the file does not say.
    """

    def __init__(self, arrays: SceneArrays, model: JsonMapping) -> None:
        try:
            self._temporal = TemporalEmbedding(arrays, model)
            a = _checked_arrays(arrays, model, self._temporal)
            self._shape = _shape(model, a["sh"].shape[1], self._temporal.networks)
            self.deformed = len(a["embeddings"])
            self.visibility = VisibilityMask(arrays[VISIBILITY], self.deformed) if VISIBILITY in arrays else None
            self._tracks = OpacityTracks(arrays[OPACITY_TRACKS]) if OPACITY_TRACKS in arrays else None
        except (KeyError, ValueError, TypeError, AttributeError, IndexError, OverflowError) as error:
            raise FrogError(
                f"The scene's deformation network cannot be used ({brief(error)}); train it again."
            ) from error
        a["shared"] = a.pop("bias")
        self.num_dynamic = self.deformed + (len(self._tracks) if self._tracks else 0)
        colors = self._shape.sh_deformed
        self.changing = _changing(a, colors) if self.deformed else frozenset()
        if self.visibility or self._tracks:
            self.changing |= {"base"}  # in which opacities are
        self._still = vars(canonical_gaussians(a))
        was_visible = {"was_visible": np.ones(num_groups(self.deformed), np.float32)} if self.visibility else {}
        self._memory = BufferPool({k: v for k, v in self._still.items() if k != "sh" or colors} | was_visible)
        for name in _CANONICAL:
            a[name] = a[name][: self.deformed]
        a["sh"] = np.ascontiguousarray(a["sh"][: self.deformed, :colors])  # the others are in the frames' memory
        kept = "modulation_weight" not in a  # the first layer's product with the embeddings is the same at all times
        self._first_layer = a["shared"], a["embedding_weight"], a["temporal_weight"], a.get("modulation_weight")
        if not self._shape.head_width:  # heads are nearly all of the arithmetic: how Gaussians lie matters little
            a = {"means": a["means"], "groups": pack_lanes(a, kept), **transpose_weights(a)}
        # Of frames, which have all colours, and of parts, which have those that deform.
        self._field, self._part_field = (
            PlaybackField(shape, a, kept) for shape in (self._shape, replace(self._shape, sh_active=colors))
        )

    def temporal(self, time: float) -> Array:
        """(networks, T) what each network is given at a time in [0, 1]."""
        return self._temporal.at(time)

    def _time_inputs(self, time: float) -> SceneArrays:
        """The native library's inputs that depend on time. With groups it computes the first layer itself."""
        temporal = self.temporal(time)
        if not self._shape.head_width:
            return {"temporal": temporal}
        bias, embedding_weight, temporal_weight, modulation_weight = self._first_layer
        found = first_layer(temporal, temporal_weight, bias, embedding_weight, modulation_weight)
        return dict(zip(("shared", "embedding_weight"), found, strict=True))

    def _deform(
        self,
        field: PlaybackField,
        time: float,
        result: SceneArrays,
        addresses: Mapping[str, Buffer | int] | None = None,
    ) -> None:
        """Fills the dynamic Gaussians of ``result``; ``addresses`` are those of its arrays, if known."""
        if self.deformed:
            active = self.visibility.at(time) if self.visibility else None
            field.deform(self._time_inputs(time), addresses or result, active)
        if self._tracks:
            self._tracks.at(time, result["opacities"][self.deformed : self.num_dynamic])

    def at(self, time: float) -> NumpyGaussians:
        """The Gaussians at a time in [0, 1], activated, with unit quaternions; the arrays are not to be changed."""
        memory, addresses = self._memory.acquire()
        result = {"sh": self._still["sh"]} | memory
        self._deform(self._field, time, result, result | addresses)
        result.pop("was_visible", None)
        return GaussianArrays(**result)

    def delta_at(self, time: float, names: Collection[str]) -> FrameDelta:
        """Columns of the dynamic Gaussians at a time in [0, 1]: the same bits as in ``at``."""
        count, colors = self.num_dynamic, self._shape.sh_deformed
        sizes = {"means": (3,), "quaternions": (4,), "scales": (3,), "opacities": (), "sh": (colors, 3)}
        moved = {name: np.empty((count, *size), np.float32) for name, size in sizes.items()}
        for name, values in moved.items():  # Gaussians with opacity tracks
            still = self._still[name][self.deformed : count]
            values[self.deformed :] = still[:, :colors] if name == "sh" else still
        self._deform(self._part_field, time, moved)
        if not colors:
            moved["sh"] = self._still["sh"][:count]
        return extract_columns(GaussianArrays(**moved), names)
