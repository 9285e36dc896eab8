"""Proxy meshes: spheres and planes of splats become spheres and planes, and what moves is told from what stays."""

import numpy as np
import pytest
from support.builders import blobs, looking_at, refused, result_of

from frog_blender.engine.gaussians import joined
from frog_blender.engine.surfaces.fusion import MOST_VOXELS, Grid, surface_depth, surface_nets
from frog_blender.engine.surfaces.proxy import make_proxy, steps_of


def turned_to(normals):
    """(N, 4) quaternions that turn z to unit normals (N, 3)."""
    half = normals + np.array([0, 0, 1])
    half[np.linalg.norm(half, axis=1) < 1e-6] = [1, 0, 0]
    half /= np.linalg.norm(half, axis=1, keepdims=True)
    return np.concatenate([half[:, 2:] * 0, half], axis=1)  # half a turn about what lies between


def discs(places, normals, size, thickness=0.002):
    """Opaque flat Gaussians (N, 3) on a surface."""
    turns = turned_to(normals.astype(np.float64))
    return blobs(places, (size, size, thickness), opacities=0.98, turns=turns)


def sphere(center=(0.0, 0.0, 0.0), radius=1.0, count=1500):
    heights = 1 - 2 * (np.arange(count) + 0.5) / count
    angles = np.pi * (3 - np.sqrt(5)) * np.arange(count)
    flat = np.sqrt(1 - heights**2)
    normals = np.stack([flat * np.cos(angles), flat * np.sin(angles), heights], axis=1)
    return discs(normals * radius + center, normals, 2.5 * radius / np.sqrt(count))


def looking_down(height=4.0, size=64):
    """A camera above the origin that looks at it."""
    lens = np.array([[size, 0, size / 2], [0, size, size / 2], [0, 0, 1]])
    return looking_at("above", (0.0, 0.0, height), (size, size), lens, up=(0.0, 1.0, 0.0))


def normals_of(mesh):
    a, b, c, d = (mesh.vertices[mesh.quads[:, corner]] for corner in range(4))
    return np.cross(c - a, d - b)


def edges_of(mesh):
    """How many quads each edge belongs to."""
    pairs = np.sort(np.stack([mesh.quads, np.roll(mesh.quads, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    return np.unique(pairs, axis=0, return_counts=True)[1]


def test_surface_nets_of_a_ball_are_closed_and_face_outwards():
    points = np.stack(np.meshgrid(*[np.arange(24.0)] * 3, indexing="ij"), axis=-1)
    mesh = surface_nets(np.linalg.norm(points - 11.3, axis=-1) - 7.0)
    assert np.abs(np.linalg.norm(mesh.vertices - 11.3, axis=1) - 7.0).max() < 0.2
    assert (edges_of(mesh) == 2).all()
    middles = mesh.vertices[mesh.quads].mean(1) - 11.3
    assert ((normals_of(mesh) * middles).sum(1) > 0).all()
    area = 0.5 * np.linalg.norm(normals_of(mesh), axis=1).sum()
    assert area == pytest.approx(4 * np.pi * 49, rel=0.03)


def test_the_depth_of_a_slanted_floor_has_no_steps():
    normal = np.array([0.0, -0.5, 1.0]) / np.sqrt(1.25)
    steps = np.linspace(-2, 2, 9)
    x, y = (axis.ravel() for axis in np.meshgrid(steps, steps))
    floor = discs(np.stack([x, y, 0.5 * y], axis=1), np.tile(normal, (len(x), 1)), 0.5)
    camera = looking_down()
    depth = surface_depth(floor, camera)
    rows, columns = np.nonzero(np.isfinite(depth))
    assert len(rows) > 3000
    pixels = np.stack([columns + 0.5, rows + 0.5, np.ones(len(rows))], axis=1)
    points = camera.center + pixels @ np.linalg.inv(camera.intrinsics).T @ camera.rotation * depth[rows, columns, None]
    inside = np.abs(points[:, :2]).max(1) < 1.5
    assert np.abs(points[inside] @ normal).max() < 0.02


def test_a_sphere_of_splats_becomes_a_sphere_within_a_voxel():
    scene, resolution = sphere(), 32
    proxy, said = result_of(make_proxy([lambda: scene], [], resolution))
    away = np.abs(np.linalg.norm(proxy.still.vertices, axis=1) - 1.0)
    assert proxy.voxel == pytest.approx(2 / resolution, rel=0.1)
    assert away.max() < proxy.voxel and away.mean() < 0.5 * proxy.voxel
    assert (edges_of(proxy.still) % 2 == 0).all(), "it is closed"
    middles = proxy.still.vertices[proxy.still.quads].mean(1)
    assert ((normals_of(proxy.still) * middles).sum(1) > 0).all()
    assert proxy.moving == [] and said[-1] == 2 < steps_of(1)


def test_what_cameras_do_not_see_stays_open():
    proxy, _ = result_of(make_proxy([lambda: sphere()], [looking_down()], 24))
    assert 0.9 < proxy.still.vertices[:, 2].max() < 1.1 and proxy.still.vertices[:, 2].min() > -0.2
    assert (edges_of(proxy.still) == 1).any()


def test_a_floor_that_is_seen_from_the_side_is_flat():
    steps = np.linspace(-1.5, 1.5, 21)
    x, y = (axis.ravel() for axis in np.meshgrid(steps, steps))
    floor = discs(np.stack([x, y, 0 * x], axis=1), np.tile([0.0, 0.0, 1.0], (len(x), 1)), 0.15)
    cameras = []
    lens = np.array([[90.0, 0, 48], [0, 90, 32], [0, 0, 1]])
    for angle in (0.0, 0.7, -0.7):
        back = np.array([np.sin(angle), -np.cos(angle), 0.25]) / np.sqrt(1.0625)
        cameras.append(looking_at(f"{angle}", 4.0 * back, (96, 64), lens))
    proxy, _ = result_of(make_proxy([lambda: floor], cameras, 32))
    inside = np.abs(proxy.still.vertices[:, :2]).max(1) < 0.8
    heights = np.abs(proxy.still.vertices[inside, 2])
    assert np.quantile(heights, 0.95) < 0.2 * proxy.voxel, "but below its rim, which the cameras see past"
    middles = np.abs(proxy.still.vertices[proxy.still.quads].mean(1))
    slopes = normals_of(proxy.still)[middles[:, :2].max(1) < 0.8]
    assert np.median(slopes[:, 2] / np.linalg.norm(slopes, axis=1)) > 0.98


def test_what_moves_has_a_mesh_a_frame():
    room = sphere(center=(0, 0, 0), radius=1.0)
    frames = [lambda x=x: joined([room, sphere((2.5 + x, 0, 0), 0.4, 600)]) for x in (0.0, 0.3, 0.6)]
    proxy, said = result_of(make_proxy(frames, [], 40))
    assert np.linalg.norm(proxy.still.vertices, axis=1).max() < 1.0 + proxy.voxel
    assert len(proxy.moving) == 3
    for mesh, x in zip(proxy.moving, (2.5, 2.8, 3.1), strict=True):
        away = np.abs(np.linalg.norm(mesh.vertices - (x, 0, 0), axis=1) - 0.4)
        assert away.max() < proxy.voxel
    assert said[-1] == steps_of(3) and sorted(said) == said


def test_without_identity_everything_moves():
    scenes = [sphere(), sphere(radius=0.9, count=1400)]
    frames = [lambda scene=scene: scene for scene in scenes]
    proxy, _ = result_of(make_proxy(frames, [], 24, keeps_identity=False))
    assert not len(proxy.still.quads) and all(len(mesh.quads) for mesh in proxy.moving)
    assert np.linalg.norm(proxy.moving[1].vertices, axis=1).mean() == pytest.approx(0.9, abs=0.5 * proxy.voxel)
    assert len(result_of(make_proxy(frames, [], 24))[0].moving) == 2, "their numbers differ"


@pytest.mark.parametrize("index", [1, 6, 11])
def test_what_moves_in_a_single_frame_moves(index):
    room = sphere(count=400)
    places = [2.5] * 13
    places[index] = 3.1
    frames = [lambda x=x: joined([room, sphere((x, 0, 0), 0.4, 200)]) for x in places]
    proxy, _ = result_of(make_proxy(frames, [], 16))
    assert len(proxy.moving) == 13 and proxy.still.vertices[:, 0].max() < 1.0 + proxy.voxel
    assert proxy.moving[index].vertices[:, 0].mean() == pytest.approx(3.1, abs=proxy.voxel)


def test_frames_that_show_the_same_share_a_mesh():
    frames = [lambda x=x: sphere((x, 0, 0), 1.0, 400) for x in (0.0, 0.5, 0.5, 0.0)]
    proxy, _ = result_of(make_proxy(frames, [], 12))
    first, second, third, fourth = proxy.moving
    assert first is fourth and second is third and first is not second


def test_a_far_floater_that_comes_and_goes_costs_no_grid_up_to_it():
    room, shown = sphere(count=400), sphere((150.0, 0.0, -400.0), 60.0, 100)
    floater = sphere((150.0, 0.0, -400.0), 60.0, 100)
    floater.opacities[:] = 0.0
    ball = [sphere((2.0 + x, 0.0, 0.0), 0.4, 200) for x in (0.0, 0.3)]
    frames = [lambda: joined([room, ball[0], floater]), lambda: joined([room, ball[1], shown])]
    side = looking_down(height=8.0)
    proxy, _ = result_of(make_proxy(frames, [side], 48))
    tall = max(np.ptp(mesh.vertices, axis=0).max() for mesh in proxy.moving)
    assert len(proxy.moving) == 2 and tall < 2 * 48 * proxy.voxel


def test_nothing_to_see_and_too_much_are_said():
    faint = sphere()
    faint.opacities[:] = 0.01
    refused("no surface", result_of, make_proxy([lambda: faint], [], 16))
    refused("no surface", result_of, make_proxy([lambda: sphere(count=0)], [], 16))
    refused(f"{MOST_VOXELS:,}. Lower Resolution", Grid.around, np.zeros(3), np.full(3, 1e6), 0.1)
