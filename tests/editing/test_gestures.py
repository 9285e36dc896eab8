"""What is inside a brush, a lasso, a box, a sphere and a closed mesh is what geometry says, and how crops fade."""

import numpy as np
import pytest
from support.builders import blobs, odd_camera, plain_camera, random_gaussians, rotation_of
from support.solids import CORNERS, FACES

from frog_blender.engine.capture.camera import Camera
from frog_blender.engine.editing.box_tree import BoxTree
from frog_blender.engine.editing.closed_mesh import ClosedMesh
from frog_blender.engine.editing.crops import Crop
from frog_blender.engine.editing.gestures import BRUSH, GESTURES, LASSO, OnScreen, drawn
from frog_blender.engine.gaussians import joined

CAMERA = odd_camera(450, 270)


@pytest.fixture(scope="module")
def gaussians():
    return random_gaussians(CAMERA, 3000, 0).checked()


@pytest.fixture(scope="module")
def screen(gaussians):
    return OnScreen.of(gaussians, CAMERA)


def distance_to_path(point, path):
    """From a point to the nearest of a path's lines."""
    nearest = []
    for start, end in zip(path, path[1:] or path, strict=False):
        way = np.subtract(end, start)
        share = np.clip(np.dot(np.subtract(point, start), way) / max(way @ way, 1e-9), 0, 1)
        nearest.append(np.linalg.norm(np.subtract(point, start) - share * way))
    return min(nearest)


def turns_about(point, outline):
    """The sum of the angles under which a point sees the edges of a closed outline, in turns."""
    corners = np.array([*outline, outline[0]]) - point
    angles = np.arctan2(corners[:, 1], corners[:, 0])
    steps = (np.diff(angles) + np.pi) % (2 * np.pi) - np.pi
    return round(steps.sum() / (2 * np.pi))


def test_what_is_not_drawn_is_not_hit():
    camera = plain_camera()
    means = np.array([[0, 0, 2], [0, 0, -2], [0, 0, 2], [0, 0, 0.001]], np.float32)
    opacities = np.array([0.5, 0.5, 0.001, 0.5], np.float32)
    actual = OnScreen.of(blobs(means, 0.1, opacities=opacities), camera)
    np.testing.assert_array_equal(actual.rows, [0])
    np.testing.assert_array_equal(actual.among(np.ones(1, bool), 4), [True, False, False, False])
    assert not len(OnScreen.of(blobs(means[1:2], 0.1, opacities=opacities[1:2]), camera, only_visible=True).rows)


@pytest.mark.parametrize("path", [[(200.0, 100.0)], [(50.0, 40.0), (60.0, 200.0), (60.0, 200.0), (400.0, 210.0)]])
def test_a_brush_hits_what_is_near_its_way(screen, path):
    hit = drawn(BRUSH, screen, path, 25.0).hit
    distances = np.array([distance_to_path(position, path) for position in screen.places.T.astype(float)])
    clear = np.abs(distances - 25.0) > 1e-3
    np.testing.assert_array_equal(hit[clear], (distances <= 25.0)[clear])
    assert 0 < hit.sum() < len(hit)


@pytest.mark.parametrize("seed", range(4))
def test_a_lasso_hits_what_it_encloses_an_odd_number_of_times(screen, seed):
    outline = np.random.default_rng(seed).uniform((0, 0), (450, 270), (4 + 5 * seed, 2))
    outline = [(float(x), float(y)) for x, y in outline]
    turns = np.array([turns_about(position, outline) for position in screen.places.T.astype(float)])
    crossed = GESTURES[LASSO](screen, 0.0)
    for count, position in enumerate(outline, 1):
        crossed.move(position)
        shown = [turns_about(position, outline[:count]) for position in screen.places.T[:20].astype(float)]
        np.testing.assert_array_equal(crossed.hit[:20], np.array(shown) % 2 == 1)  # while it is drawn as well
    np.testing.assert_array_equal(crossed.hit, turns % 2 == 1)
    assert 0 < crossed.hit.sum() < len(turns)


def _wall(depth, scale, turned=0.0):
    """Gaussians side by side, flat along a plane that is turned about the vertical."""
    x, y = (grid.ravel() for grid in np.meshgrid(np.linspace(-1, 1, 21), np.linspace(-1, 1, 21)))
    rotation = rotation_of((0.0, 1.0, 0.0), turned)
    flat = blobs(np.stack([x, y, np.zeros(441)], 1) @ rotation.T + (0.0, 0.0, depth), (scale, scale, 0.001))
    flat.quaternions[:] = np.cos(turned / 2), 0.0, np.sin(turned / 2), 0.0
    return flat


@pytest.mark.parametrize("turned", [0.0, 0.9, -1.2])
def test_only_what_nothing_hides_is_visible(turned):
    camera = Camera("plain", 900, 600, np.array([[900.0, 0, 450], [0, 900, 300], [0, 0, 1]]), np.eye(4))
    before = blobs([(0.0, 0.0, 2.0)], 0.02, opacities=0.05)  # faint, which hides nothing
    everything = joined([_wall(4.0, 0.08, turned), before, blobs([(0.2, 0.1, 9.0), (40.0, 0.0, 6.0)], 0.05)])
    rows = OnScreen.of(everything, camera).rows
    np.testing.assert_array_equal(rows, np.arange(444))
    visible = set(OnScreen.of(everything, camera, only_visible=True).rows.tolist())
    assert 441 in visible and 442 not in visible and 443 not in visible, "before the wall, behind it, outside"
    across = camera.project(everything.means[:441])[0][:, 0]
    assert visible >= set(np.flatnonzero((across >= 0) & (across < 900)).tolist()), "and the wall itself"


def ring(count=24, tube=12):
    """A torus around the z axis: radii 2 and 0.7."""
    u, v = (np.arange(n) * 2 * np.pi / n for n in (count, tube))
    u, v = np.meshgrid(u, v, indexing="ij")
    points = np.stack([(2 + 0.7 * np.cos(v)) * np.cos(u), (2 + 0.7 * np.cos(v)) * np.sin(u), 0.7 * np.sin(v)], -1)
    index = np.arange(count * tube).reshape(count, tube)
    a, b = index, np.roll(index, -1, 0)
    c, d = np.roll(index, -1, 1), np.roll(np.roll(index, -1, 0), -1, 1)
    faces = np.concatenate([np.stack([a, b, c], -1).reshape(-1, 3), np.stack([b, d, c], -1).reshape(-1, 3)])
    return points.reshape(-1, 3), faces


def turned(seed=0):
    random = np.random.default_rng(seed)
    rotation, _ = np.linalg.qr(random.normal(size=(3, 3)))
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rotation * (0.5, 1.5, 0.8), (0.3, -0.2, 0.6)
    return matrix


def test_a_mesh_contains_what_its_solid_does():
    points = np.random.default_rng(0).uniform(-3, 3, (20_000, 3))
    mesh = ClosedMesh.of(*ring())
    flat = np.hypot(points[:, 0], points[:, 1])
    distance = np.hypot(flat - 2, points[:, 2])
    inside = mesh.contains(points)
    assert inside[distance < 0.6].all() and not inside[distance > 0.7].any() and inside.sum() > 500


def test_rays_through_edges_and_vertices_count_right():
    cube = ClosedMesh.of(CORNERS, FACES)
    points = np.stack(np.meshgrid(*[np.linspace(-1.5, 1.5, 13)] * 3), -1).reshape(-1, 3)
    strictly, outside = (np.abs(points) < 1).all(1), (np.abs(points) > 1).any(1)
    inside = cube.contains(points)
    assert inside[strictly].all() and not inside[outside].any()


@pytest.mark.parametrize(
    ("vertices", "triangles", "said"),
    [
        (CORNERS, FACES[:-1], "open borders"),
        (CORNERS, np.where(FACES == 7, 9, FACES), "not there"),
        (np.where(CORNERS == 1, np.nan, CORNERS), FACES, "not finite"),
        (CORNERS[:3], FACES[:2], "possible"),
    ],
)
def test_meshes_that_are_none_are_refused(vertices, triangles, said):
    with pytest.raises(ValueError, match=said):
        ClosedMesh.of(vertices, triangles)


def test_feather_fades_over_that_distance_away_from_what_is_kept():
    matrix = turned()
    normal = matrix[:3, 0] / np.linalg.norm(matrix[:3, 0])
    surface = matrix[:3, 3] + matrix[:3, 0]
    points = (surface + np.outer((-0.1, 0.0, 0.1, 0.2, 0.4), normal)).astype(np.float32)
    flat = tuple(matrix.ravel().tolist())
    np.testing.assert_allclose(Crop("box", flat, True, 0.2).kept(points), (1, 1, 0.5, 0, 0), atol=1e-5)
    np.testing.assert_allclose(Crop("box", flat, False, 0.2).kept(points), (0.5, 1, 1, 1, 1), atol=1e-5)
    ball = tuple(np.diag([2.0, 2, 2, 1]).ravel().tolist())
    along = np.outer((1.9, 2.0, 2.1, 2.3), (0.6, 0.8, 0.0)).astype(np.float32)
    np.testing.assert_allclose(Crop("sphere", ball, True, 0.2).kept(along), (1, 1, 0.5, 0), atol=1e-5)


@pytest.mark.parametrize("keep_inside", [True, False])
def test_a_mesh_keeps_and_fades_as_the_box_that_it_is(keep_inside):
    points = np.random.default_rng(2).normal(size=(3000, 3)).astype(np.float32)
    matrix = tuple(turned().ravel().tolist())
    box = Crop("box", matrix, keep_inside).kept(points)
    mesh = Crop("mesh", matrix, keep_inside, mesh=ClosedMesh.of(CORNERS, FACES)).kept(points)
    np.testing.assert_array_equal(mesh, box)
    assert 0 < box.sum() < 3000
    for shape, solid in (("box", None), ("mesh", ClosedMesh.of(CORNERS, FACES))):
        np.testing.assert_array_equal(Crop(shape, matrix, keep_inside, 1e-300, mesh=solid).kept(points), box)
    box = Crop("box", matrix, keep_inside, 0.4).kept(points)
    mesh = Crop("mesh", matrix, keep_inside, 0.4, mesh=ClosedMesh.of(CORNERS, FACES)).kept(points)
    np.testing.assert_allclose(mesh, box, atol=2e-5)
    assert ((mesh > 0) & (mesh < 1)).sum() > 300


def test_distance_from_a_mesh_is_that_of_the_nearest_triangle():
    """Against all triangles, some of which are flat, one by one; and a torus, whose distance is known."""
    random = np.random.default_rng(3)
    corners = random.normal(size=(300, 3, 3))
    corners[::7, 1] = corners[::7, 0]
    points = 2 * random.normal(size=(200, 3))
    actual = BoxTree(corners).within(points, 1e6)
    edges = np.linspace(0, 1, 40)
    u, v = (grid.ravel() for grid in np.meshgrid(edges, edges))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    sampled = np.einsum("ks,tkc->tsc", np.stack([1 - u - v, u, v]), corners).reshape(-1, 3)
    near = np.array([np.linalg.norm(sampled - point, axis=1).min() for point in points[:40]])
    assert (actual[:40] <= near + 1e-9).all() and np.abs(actual[:40] - near).max() < 0.1
    vertices, faces = ring(96, 48)
    torus, most = np.abs(np.hypot(np.hypot(points[:, 0], points[:, 1]) - 2, points[:, 2]) - 0.7), 0.5
    actual = BoxTree(vertices[faces]).within(points, most)
    np.testing.assert_allclose(actual, np.minimum(torus, most), atol=6e-3)
