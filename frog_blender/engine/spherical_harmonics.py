"""Real spherical harmonics in the order and signs of 3DGS (Kerbl et al., 2023), for numpy and torch alike."""

from typing import TYPE_CHECKING, TypeVar

from .arrays import Array

if TYPE_CHECKING:
    import torch

Values = TypeVar("Values", Array, "torch.Tensor")

SH_DC = 0.28209479177387814
"""The constant of degree 0."""


def sh_terms(count: int, x: Values, y: Values, z: Values) -> list[Values]:
    """The basis functions after the constant one at unit directions.

    Args:
        count: of basis functions with the constant one: 1, 4, 9 or 16.
        x, y, z: (N,) each.

    Returns:
        count - 1 arrays (N,).
    """
    terms: list[Values] = []
    if count > 1:
        terms += [-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x]
    xx, yy, zz = x * x, y * y, z * z
    xx_yy: Values = xx - yy
    if count > 4:
        terms += [
            1.0925484305920792 * x * y,
            -1.0925484305920792 * y * z,
            0.31539156525252005 * (2 * zz - xx - yy),
            -1.0925484305920792 * x * z,
            0.5462742152960396 * xx_yy,
        ]
    if count > 9:
        terms += [
            -0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            -0.4570457994644658 * y * (4 * zz - xx - yy),
            0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy),
            -0.4570457994644658 * x * (4 * zz - xx - yy),
            1.445305721320277 * z * xx_yy,
            -0.5900435899266435 * x * (xx - 3 * yy),
        ]
    return terms
