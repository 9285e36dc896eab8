"""Moving a scene as a whole: rotation, uniform scale and translation, spherical harmonics included."""

from __future__ import annotations

import numpy as np

from ..errors import FrogError
from ..gaussians import GaussianArrays

Y_DOWN = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""(4, 4) from Blender's axes (z up) to those of most 3DGS files (y down, z into the image)."""


def transform(gaussians: GaussianArrays, matrix: np.ndarray) -> GaussianArrays:
    """Gaussians after ``matrix`` (4, 4): a rotation times a uniform positive scale, and a translation.

    FrogError for a matrix that shears, mirrors or scales unevenly: Gaussians could follow it, their colours could not.
    """
    linear = np.asarray(matrix, np.float64)[:3, :3]
    scale = np.cbrt(np.linalg.det(linear))
    if not (np.isfinite(matrix).all() and scale > 1e-9):
        raise FrogError("The object is mirrored or flattened; a Gaussian scene can only be moved, turned and scaled.")
    rotation = linear / scale
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
        raise FrogError("The object is scaled unevenly or sheared; a Gaussian scene can only be scaled evenly.")
    if np.abs(rotation - np.eye(3)).max() < 1e-7:
        quaternions, sh = gaussians.quaternions, gaussians.sh
    else:
        quaternions = _multiply(_quaternion(rotation), gaussians.quaternions)
        sh = rotate_sh(gaussians.sh, rotation)
    means = gaussians.means @ linear.T.astype(np.float32) + np.asarray(matrix, np.float32)[:3, 3]
    return GaussianArrays(means, quaternions, gaussians.scales * np.float32(scale), gaussians.opacities, sh).checked()


def rotate_sh(sh: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    """(N, K, 3) coefficients of the same light seen after the scene was turned by ``rotation`` (3, 3).

    Each degree turns within itself. Its matrix follows from sampling: the turned function at direction d is the old
    one at R^T d, which determines the new coefficients by least squares (exactly, the polynomials being closed).
    """
    count = sh.shape[1]
    if count == 1:
        return sh
    directions = np.random.default_rng(0).normal(size=(64, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    new_basis, old_basis = sh_basis(count, directions), sh_basis(count, directions @ rotation)
    result = sh.copy()
    for degree in range(1, int(count**0.5)):
        part = slice(degree**2, (degree + 1) ** 2)
        turn = np.linalg.lstsq(new_basis[:, part], old_basis[:, part], rcond=None)[0].astype(np.float32)
        result[:, part] = np.einsum("jk,nkc->njc", turn, sh[:, part])
    return result


def sh_basis(count: int, directions: np.ndarray) -> np.ndarray:
    """(M, count) real spherical harmonics at unit directions (M, 3), in the order and signs of 3DGS."""
    x, y, z = directions.T
    xx, yy, zz = x * x, y * y, z * z
    terms = [
        np.full_like(x, 0.28209479177387814),
        *(-0.4886025119029199 * y, 0.4886025119029199 * z, -0.4886025119029199 * x),
        *(1.0925484305920792 * x * y, -1.0925484305920792 * y * z, 0.31539156525252005 * (2 * zz - xx - yy)),
        *(-1.0925484305920792 * x * z, 0.5462742152960396 * (xx - yy), -0.5900435899266435 * y * (3 * xx - yy)),
        *(2.890611442640554 * x * y * z, -0.4570457994644658 * y * (4 * zz - xx - yy)),
        *(0.3731763325901154 * z * (2 * zz - 3 * xx - 3 * yy), -0.4570457994644658 * x * (4 * zz - xx - yy)),
        *(1.445305721320277 * z * (xx - yy), -0.5900435899266435 * x * (xx - 3 * yy)),
    ]
    return np.stack(terms[:count], axis=-1)


def _quaternion(rotation: np.ndarray) -> np.ndarray:
    """(4,) w, x, y, z of a rotation matrix: the largest eigenvector (Bar-Itzhack's method), stable everywhere."""
    r = rotation
    k = np.array(
        [
            [r[0, 0] + r[1, 1] + r[2, 2], r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 0] - r[1, 1] - r[2, 2], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0]],
            [r[0, 2] - r[2, 0], r[0, 1] + r[1, 0], r[1, 1] - r[0, 0] - r[2, 2], r[1, 2] + r[2, 1]],
            [r[1, 0] - r[0, 1], r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], r[2, 2] - r[0, 0] - r[1, 1]],
        ]
    )
    return np.linalg.eigh(k)[1][:, -1]


def _multiply(p: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Hamilton products p * q of one quaternion (4,) with many (N, 4)."""
    w, x, y, z = p
    matrix = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]], np.float32)
    return q @ matrix.T
