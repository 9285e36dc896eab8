"""The deformation field in the native library: network, activations and opacity reduction in one pass, and gradients.

A block of Gaussians goes through all layers while they lie in the processor's caches; nothing of the size of a layer
times the Gaussians is ever stored, and the backward pass computes a block's layers again.
"""

from __future__ import annotations

from ctypes import byref
from dataclasses import dataclass
from typing import Any

from . import structs
from .binding import library


@dataclass(frozen=True)
class FieldShape:
    """What the arrays do not say themselves; see model.frog.FrogSettings for the meaning.

    Attributes:
        head_width: of each head's hidden layer; 0 when all outputs read the first layer.
        sh_active, sh_deformed: coefficients that come out, and that the network changes.
        opacity_form: "paper", "unit" or "off".
        networks: 2 where the outputs of two networks of the same shape add up (E-D3DGS's coarse and fine one); see
            model.deformation.DeformationField for how their layers lie in the arrays.
    """

    head_width: int
    sh_active: int
    sh_deformed: int
    opacity_form: str
    opacity_sharpness: float
    opacity_share: float
    motion_unit: float
    networks: int = 1

    @property
    def outputs(self) -> int:
        """Numbers that the network gives for a Gaussian: 3 + 3 + 4 + 1 and the spherical harmonics."""
        return 11 + 3 * self.sh_deformed


def deform(shape: FieldShape, arrays: dict[str, Any], result: dict[str, Any]) -> None:
    """Fills ``result`` with the deformed, activated Gaussians.

    Args:
        shape: settings.
        arrays: contiguous float32 by name: the canonical field's attributes, of which ``embeddings`` (M, E) may have
            fewer rows than there are Gaussians: those behind them are at rest; ``shared`` (networks * hidden,) (the
            first layer's temporal part and bias), and the network's ``embedding_weight``, ``output_weight``,
            ``output_bias`` and, with heads, ``head_weight`` and ``head_bias``.
        result: contiguous float32 by name: the attributes of GaussianArrays, with ``sh`` (N, sh_active, 3), and where
            wanted ``changes`` (M, outputs). Coefficients that ``arrays["sh"]`` does not have are left as they are.
    """
    _deform(_field(shape, arrays), result)


class PlaybackField:
    """``deform`` at one moment after the other, with unit quaternions. Where the arrays lie is looked up once, which
    takes as long as a thousand Gaussians.

    Args:
        shape: settings.
        arrays: as for ``deform``; they are kept, and not to be replaced. Without heads ``groups`` may stand for the
            Gaussians' attributes but ``means``, whose length counts, and then the network's are in columns (see
            inference.groups for both).
        kept_products: what ``groups`` has instead of embeddings.
        reshaped: with ``groups``, the first so many Gaussians turn and grow, the others keep their shape; None for all.
    """

    def __init__(
        self,
        shape: FieldShape,
        arrays: dict[str, Any],
        precomputed_first_layer: bool = False,
        num_shape_dynamic: int | None = None,
    ) -> None:
        if shape.head_width and "groups" in arrays:
            raise ValueError("groups: found some beside heads, expected embeddings")
        self._arrays, self._field = arrays, _field(shape, arrays)
        self._field.unit_quaternions, self._field.precomputed_first_layer = True, precomputed_first_layer
        for name in ("groups", "temporal_weight", "modulation_weight"):
            setattr(self._field, name, structs.address(arrays.get(name)))
        if num_shape_dynamic is not None:
            self._field.num_shape_dynamic = num_shape_dynamic

    def deform(self, moment: dict[str, Any], result: dict[str, Any], active: Any = None) -> None:
        """Fills the first rows of ``result`` at a moment.

        Args:
            moment: arrays that are other than at other moments: ``shared`` and ``embedding_weight``, or with ``groups``
                and ``temporal_weight`` the moment's ``temporal`` embedding (networks, T).
            result: arrays, or their addresses. Beside the attributes it may have ``was_visible`` (groups,), as the last
                call left it, or ones: a group that is invisible now and was then is not written again.
            active: with ``groups``, (groups,) uint8, or None for all: where it is zero, Gaussians cannot be seen. They
                come out as they are canonically, but for an opacity of zero, and the network is not asked.
        """
        field = structs.Field.from_buffer_copy(self._field)  # others may be at another moment
        field.active = structs.address(active)
        for name, array in moment.items():
            setattr(field, name, structs.address(array))
        _deform(field, result)


def _deform(field: Any, result: dict[str, Any]) -> None:
    if library().frog_deform(byref(field), byref(structs.pointers(structs.Deformed, structs.DEFORMED, result))):
        raise MemoryError("deforming the Gaussians ran out of memory")


def deform_backward(shape: FieldShape, arrays: dict[str, Any], by: dict[str, Any], result: dict[str, Any]) -> None:
    """Fills ``result`` (names and shapes of ``arrays``) from the gradients ``by`` of what ``deform`` gave.

    The same bits for any number of threads.
    """
    if library().frog_deform_backward(
        byref(_field(shape, arrays)),
        byref(structs.pointers(structs.Deformed, structs.DEFORMED, by)),
        byref(structs.pointers(structs.FieldGradients, structs.FIELD_ARRAYS, result)),
    ):
        raise MemoryError("the deformation's backward pass ran out of memory")


def _field(shape: FieldShape, arrays: dict[str, Any]) -> Any:
    in_groups, count, weight = "groups" in arrays, len(arrays["means"]), arrays["embedding_weight"]
    units, embedding = (len(arrays["output_weight"]), len(weight)) if in_groups else weight.shape
    return structs.Field(
        *(count, count if in_groups else len(arrays["embeddings"])),
        *(embedding, units // shape.networks, shape.head_width, shape.networks),
        *(shape.sh_deformed if in_groups else arrays["sh"].shape[1], shape.sh_active, shape.sh_deformed),
        *(structs.OPACITY_FORMS[shape.opacity_form], False, False),
        *(arrays["temporal_weight"].shape[0] if in_groups and "temporal_weight" in arrays else 0, count),
        *(shape.opacity_sharpness, shape.opacity_share, shape.motion_unit),
        *[structs.address(arrays.get(name)) for name in structs.FIELD_ARRAYS],
    )
