"""The depth of a mesh's surfaces: against rays and triangles in numpy, at every awkward place."""

import numpy as np
import pytest
from support.builders import odd_camera, plain_camera

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.native.options import RasterizeOptions
from frog_blender.engine.rasterizer.mesh_depth import mesh_depth


def by_rays(vertices: np.ndarray, triangles: np.ndarray, camera: Camera, near: float = 0.01) -> np.ndarray:
    """(H, W) the same by Moeller and Trumbore, one ray a pixel, in float64."""
    y, x = np.mgrid[0 : camera.height, 0 : camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1).reshape(-1, 3) @ np.linalg.inv(camera.intrinsics).T
    seen = vertices @ camera.rotation.T + camera.world_to_camera[:3, 3]
    depth = np.full(len(rays), np.inf)
    for a, b, c in seen[triangles]:
        u, v = b - a, c - a
        p = np.cross(rays, v)
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1 / (p @ u)
            first = (p @ -a) * inverse
            q = np.cross(-a, u)
            second = (rays @ q) * inverse
            z = (q @ v) * inverse
        hit = (first >= 0) & (second >= 0) & (first + second <= 1) & (z >= near)
        depth = np.where(hit, np.minimum(depth, z), depth)
    return depth.reshape(camera.height, camera.width)


def agree(found: np.ndarray, expected: np.ndarray) -> None:
    """Edges through a pixel's very centre may fall to either side."""
    assert found.dtype == np.float32 and found.shape == expected.shape
    both = np.isfinite(found) & np.isfinite(expected)
    assert np.mean(np.isfinite(found) != np.isfinite(expected)) < 2e-3
    assert np.mean(~np.isclose(found[both], expected[both], rtol=2e-5)) < 2e-3


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("camera", [plain_camera(61, 37), odd_camera(90, 71)], ids=["plain", "odd"])
def test_random_triangles(camera: Camera, seed: int) -> None:
    """Before, behind, across the near plane, beyond the image's edges."""
    random = np.random.default_rng(seed)
    vertices = (random.normal(0, 2.0, (60, 3)) + np.array([0, 0, 2])).astype(np.float32)
    triangles = random.integers(0, 60, (40, 3))
    found = mesh_depth(vertices, triangles, camera)
    assert np.isfinite(found).mean() > 0.1
    agree(found, by_rays(vertices.astype(float), triangles, camera))


def test_a_tilted_floor_is_exact() -> None:
    camera = plain_camera(64, 48)
    corners = np.array([[-500, 1, 0.5], [500, 1, 0.5], [500, 1, 90], [-500, 1, 90]], np.float32)
    depth = mesh_depth(corners, np.array([[0, 1, 2], [2, 3, 0]]), camera)
    rows = np.arange(48) + 0.5 - 24
    with np.errstate(divide="ignore", invalid="ignore"):
        expected = np.where((rows > 0) & (40 / rows < 90) & (40 / rows > 0.5), 40 / rows, np.inf)
    np.testing.assert_allclose(depth, np.repeat(expected[:, None], 64, 1), rtol=1e-5)
    assert np.isinf(depth[:24]).all()


def test_a_region_is_that_part_of_the_image() -> None:
    camera, random = odd_camera(70, 50), np.random.default_rng(1)
    vertices, triangles = random.normal(0, 2, (30, 3)) + np.array([0, 0, 2]), random.integers(0, 30, (20, 3))
    whole = mesh_depth(vertices, triangles, camera)
    part = mesh_depth(vertices, triangles, camera, RasterizeOptions(region=(13, 7, 40, 33)))
    np.testing.assert_array_equal(part, whole[7:40, 13:53])


def test_what_cannot_be_drawn_is_left_out() -> None:
    camera = plain_camera()
    good = [[-1, -1, 3], [1, -1, 3], [0, 1, 3]]
    vertices = np.array([*good, [np.nan, 0, 3], [np.inf, 0, 3], [1e30, 1e30, 1e30]], np.float32)
    whole = mesh_depth(vertices[:3], np.array([[0, 1, 2]]), camera)
    triangles = np.array([[0, 1, 3], [0, 1, 4], [0, 1, 99], [-1, 0, 1], [0, 0, 0], [0, 1, 1], [0, 1, 2]])
    np.testing.assert_array_equal(mesh_depth(vertices, triangles, camera), whole)
    assert np.isfinite(whole).any()
    assert not np.isnan(mesh_depth(vertices, np.array([[0, 1, 5]]), camera)).any()
    assert np.isinf(mesh_depth(np.zeros((0, 3)), np.zeros((0, 3)), camera)).all()


def test_arrays_of_other_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match=r"vertices: shape \(4, 2\)"):
        mesh_depth(np.zeros((4, 2)), np.zeros((0, 3)), plain_camera())
    with pytest.raises(ValueError, match="triangles"):
        mesh_depth(np.zeros((4, 3)), np.zeros((2, 4)), plain_camera())
