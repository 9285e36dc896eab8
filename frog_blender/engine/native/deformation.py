"""The deformation field in the native library: network, activations and opacity reduction in one pass, and gradients.

A block of Gaussians goes through all layers while they lie in the processor's caches; nothing of the size of a layer
times the Gaussians is ever stored, and the backward pass computes a block's layers again.
"""

from collections.abc import Mapping
from ctypes import Structure, byref
from dataclasses import dataclass
from typing import TypeAlias

from ..field.network import num_outputs
from . import structs
from .binding import check_status, library
from .structs import Buffer

Buffers: TypeAlias = Mapping[str, Buffer]


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
        return num_outputs(self.sh_deformed)

    @property
    def result_shapes(self) -> dict[str, tuple[int, ...]]:
        """Of what comes out for a Gaussian, by attribute."""
        return {"means": (3,), "quaternions": (4,), "scales": (3,), "opacities": (), "sh": (self.sh_active, 3)}


def deform(shape: FieldShape, arrays: Buffers, result: Buffers) -> None:
    """Fills ``result`` with the deformed, activated Gaussians.

    Args:
        shape: settings.
        arrays: contiguous float32 by name: the canonical field's attributes, of which ``embeddings`` (M, E) may have
            fewer rows than there are Gaussians: the others are static; ``shared`` (networks * hidden,) (the
            first layer's temporal part and bias), and the network's ``embedding_weight``, ``output_weight``,
            ``output_bias`` and, with heads, ``head_weight`` and ``head_bias``.
        result: contiguous float32 by name: the attributes of GaussianArrays, with ``sh`` (N, sh_active, 3), and where
            wanted ``changes`` (M, outputs). Coefficients that ``arrays["sh"]`` does not have are left as they are.
    """
    _deform(_field(shape, arrays), result)


class PlaybackField:
    """``deform`` at many times, with unit quaternions; looks up the arrays' addresses once, which costs as much as a
    thousand Gaussians.

    Args:
        shape: settings.
        arrays: as for ``deform``; kept, and not to be replaced. Without heads of their own, ``groups`` may stand for
            all attributes but ``means`` (which gives the number of Gaussians), with transposed weights; see
            playback.deformation for both.
        precomputed_first_layer: whether ``groups`` has the embeddings' products with the first layer in their place.
    """

    def __init__(self, shape: FieldShape, arrays: Buffers, precomputed_first_layer: bool = False) -> None:
        if shape.head_width and "groups" in arrays:
            raise ValueError("groups: found some beside heads, expected embeddings")
        self._arrays, self._field = arrays, _field(shape, arrays)
        self._field.unit_quaternions, self._field.precomputed_first_layer = True, precomputed_first_layer

    def deform(self, inputs: Buffers, result: Mapping[str, Buffer | int]) -> None:
        """Fills the first rows of ``result``.

        Args:
            inputs: the arrays that depend on time: ``shared`` and ``embedding_weight``, or with ``groups`` and
                ``temporal_weight`` the ``temporal`` embedding (networks, T).
            result: arrays, or their addresses.
        """
        field = structs.Field.from_buffer_copy(self._field)  # other threads may deform at another time
        for name, array in inputs.items():
            setattr(field, name, structs.address(array))
        _deform(field, result)


def _deform(field: Structure, result: Mapping[str, Buffer | int]) -> None:
    status = library().frog_deform(byref(field), byref(structs.pointers(structs.Deformed, result)))
    check_status(status, "deforming the Gaussians")


def deform_backward(shape: FieldShape, arrays: Buffers, by: Buffers, result: Buffers) -> None:
    """Fills ``result`` (names and shapes of ``arrays``) from the gradients ``by`` of what ``deform`` gave.

    The same bits for any number of threads.
    """
    gradients = structs.pointers(structs.Deformed, by), structs.pointers(structs.FieldGradients, result)
    status = library().frog_deform_backward(byref(_field(shape, arrays)), *map(byref, gradients))
    check_status(status, "the deformation's backward pass")


def _field(shape: FieldShape, arrays: Buffers) -> Structure:
    in_groups, count, weight = "groups" in arrays, len(arrays["means"]), arrays["embedding_weight"]
    units, embedding = (len(arrays["output_weight"]), len(weight)) if in_groups else weight.shape
    return structs.pointers(
        structs.Field,
        arrays,
        **{**vars(shape), "opacity_form": structs.OPACITY_FORMS[shape.opacity_form]},
        count=count,
        num_dynamic=count if in_groups else len(arrays["embeddings"]),
        embedding_size=embedding,
        hidden_width=units // shape.networks,
        sh_count=shape.sh_deformed if in_groups else arrays["sh"].shape[1],
        temporal_size=arrays["temporal_weight"].shape[0] if in_groups and "temporal_weight" in arrays else 0,
    )
