"""Moving a scene as a whole: rotation, uniform scale and translation, spherical harmonics included."""

import numpy as np

from ..arrays import Array
from ..errors import FrogError
from ..gaussians import NumpyGaussians, rotation_terms
from ..spherical_harmonics import SH_DC, sh_terms

Y_DOWN = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]])
"""(4, 4) from Blender's axes (z up) to those of most 3DGS files (y down, z into the image)."""


def transform(gaussians: NumpyGaussians, matrix: Array) -> NumpyGaussians:
    """Gaussians after ``matrix`` (4, 4), see ``rotation_and_scale``."""
    rotation, scale = rotation_and_scale(matrix)
    linear = np.asarray(matrix, np.float64)[:3, :3]
    if np.abs(rotation - np.eye(3)).max() < 1e-7:
        quaternions, sh = gaussians.quaternions, gaussians.sh
    else:
        quaternions = _multiply(quaternion_of(rotation), gaussians.quaternions)
        sh = rotate_sh(gaussians.sh, rotation)
    means = gaussians.means @ linear.T.astype(np.float32) + np.asarray(matrix, np.float32)[:3, 3]
    scales = gaussians.scales * np.float32(scale)
    moved = {"means": means, "quaternions": quaternions, "scales": scales, "sh": sh}
    return gaussians.changed(moved).checked()


def rotation_and_scale(matrix: Array) -> tuple[Array, float]:
    """The rotation (3, 3) and the uniform positive scale in a matrix (4, 4).

    FrogError for a matrix that shears, mirrors or scales unevenly: Gaussians could follow it, their colours could not.
    """
    linear = np.asarray(matrix, np.float64)[:3, :3]
    scale = float(np.cbrt(np.linalg.det(linear)))
    if not (np.isfinite(matrix).all() and scale > 1e-9):
        raise FrogError("The object is mirrored or flattened; a Gaussian scene can only be moved, turned and scaled.")
    rotation: Array = linear / scale
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > 1e-3:
        raise FrogError("The object is scaled unevenly or sheared; a Gaussian scene can only be scaled evenly.")
    return rotation, scale


def rotate_sh(sh: Array, rotation: Array) -> Array:
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


def sh_basis(count: int, directions: Array) -> Array:
    """(M, count) real spherical harmonics at unit directions (M, 3), in the order and signs of 3DGS."""
    x, y, z = directions.T
    return np.stack([np.full_like(x, SH_DC), *sh_terms(count, x, y, z)], axis=-1)


def quaternion_of(rotation: Array) -> Array:
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


def rotations_of(quaternions: Array) -> Array:
    """(N, 3, 3) rotations of (N, 4) quaternions w, x, y, z of any length: a Gaussian's axes are the columns."""
    unit = quaternions / np.linalg.norm(quaternions, axis=1, keepdims=True)
    rows: Array = np.stack(rotation_terms(*unit.T), axis=-1)
    return rows.reshape(-1, 3, 3)


def _multiply(p: Array, q: Array) -> Array:
    """Hamilton products p * q of one quaternion (4,) with many (N, 4)."""
    w, x, y, z = p
    matrix = np.array([[w, -x, -y, -z], [x, w, -z, y], [y, z, w, -x], [z, -y, x, w]], np.float32)
    return q @ matrix.T
