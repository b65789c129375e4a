"""Crop, mask, sample and thin against slow oracles that share no code with them."""

import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cei_gym.errors import CEIError
from cei_gym.pointcloud import RobotMask, SurfaceSampler, crop, farthest_point_sample

seeds = st.integers(0, 2**31)


def poses(random: np.random.Generator, count: int) -> np.ndarray:
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = Rotation.random(count, random_state=random).as_matrix()
    T[:, :3, 3] = random.uniform(-0.3, 0.3, (count, 3))
    return T


def distances(points: np.ndarray, mesh: trimesh.Trimesh) -> np.ndarray:
    """Exact distance of every point to every triangle by trimesh, the least for each point."""
    count = len(mesh.faces)
    nearest = trimesh.triangles.closest_point(
        np.repeat(mesh.triangles, len(points), axis=0), np.tile(points, (count, 1))
    )
    return np.linalg.norm(nearest.reshape(count, -1, 3) - points, axis=-1).min(axis=0)


def near_surface(random: np.random.Generator, mesh: trimesh.Trimesh, count: int, reach_m: float) -> np.ndarray:
    points, _ = trimesh.sample.sample_surface(mesh, count, seed=random)
    return points + random.uniform(-reach_m, reach_m, points.shape)


def robot(random: np.random.Generator) -> list[trimesh.Trimesh | None]:
    """Large, small, thin and torn links, and one without a surface."""
    soup = random.uniform(-0.05, 0.05, (30, 1, 3)) + random.uniform(-0.01, 0.01, (30, 3, 3))
    sliver = np.array([[[0, 0, 0], [0.2, 0, 0], [0.1, 1e-6, 0]], [[0, 0, 0], [0, 0, 0], [0.1, 0.1, 0]]])
    return [
        trimesh.creation.box(random.uniform(0.01, 0.5, 3)),
        None,
        trimesh.creation.capsule(height=0.1, radius=0.03, count=[8, 8]),
        trimesh.Trimesh(**trimesh.triangles.to_kwargs(soup), process=False),
        trimesh.Trimesh(**trimesh.triangles.to_kwargs(sliver), process=False),
    ]


@settings(max_examples=25, deadline=None)
@given(seed=seeds, tau_m=st.sampled_from([0.001, 0.005, 0.02]))
def test_mask_agrees_with_exact_distances(seed, tau_m):
    random = np.random.default_rng(seed)
    meshes = robot(random)
    T = poses(random, len(meshes))
    bodies = [m.copy().apply_transform(T[i]) for i, m in enumerate(meshes) if m is not None]
    points = np.concatenate([near_surface(random, body, 60, 2 * tau_m) for body in bodies])
    distance_m = np.min([distances(points, body) for body in bodies], axis=0)
    sure = np.abs(distance_m - tau_m) > 1e-6
    masked = RobotMask(meshes, tau_m)(points, T)
    np.testing.assert_array_equal(masked[sure], (distance_m <= tau_m)[sure])
    assert 0 < masked.sum() < len(points)


def test_mask_ignores_points_that_are_not_finite_and_robots_without_surface():
    box = trimesh.creation.box((1, 1, 1))
    points = np.array([[0.5, 0, 0], [np.nan, 0, 0], [0.5, np.inf, 0], [9, 9, 9], [0, 0, 0]])
    assert RobotMask([box])(points, np.eye(4)[None]).tolist() == [True, False, False, False, False]
    assert not RobotMask([None])(points, np.eye(4)[None]).any()
    assert RobotMask([])(points, np.empty((0, 4, 4))).shape == (5,)
    assert RobotMask([box])(np.empty((0, 3)), np.eye(4)[None]).shape == (0,)


@settings(max_examples=25, deadline=None)
@given(seed=seeds)
def test_sampler_lies_on_the_surface_and_moves_with_its_links(seed):
    random = np.random.default_rng(seed)
    meshes = robot(random)
    sampler = SurfaceSampler(meshes, 100, seed)
    T = poses(random, len(meshes))
    points_world = sampler(T)
    assert points_world.shape == (100, 3)
    for link in np.unique(sampler.link_ids):
        body = meshes[link].copy().apply_transform(T[link])
        assert distances(points_world[sampler.link_ids == link], body).max() < 1e-9
    common = poses(random, 1)[0]
    moved = points_world @ common[:3, :3].T + common[:3, 3]
    np.testing.assert_allclose(sampler(common @ T), moved, atol=1e-12)
    np.testing.assert_array_equal(SurfaceSampler(meshes, 100, seed)(T), points_world)


def test_sampler_is_uniform_over_area():
    slab, cube = trimesh.creation.box((4, 1, 0.001)), trimesh.creation.box((1, 1, 1))
    count = 40_000
    sampler = SurfaceSampler([slab, None, cube], count, seed=1)
    on_cube = sampler.link_ids == 2
    assert abs(on_cube.mean() - cube.area / (slab.area + cube.area)) < 4 * np.sqrt(0.25 / count)
    x = sampler.points_link[~on_cube, 0]
    shares = np.histogram(x, np.linspace(-2, 2, 9))[0] / len(x)
    assert np.abs(shares - 1 / 8).max() < 4 * np.sqrt(1 / 8 / len(x))


@settings(max_examples=100, deadline=None)
@given(seed=seeds, count=st.integers(1, 200), n=st.integers(1, 64))
def test_thinning_is_greedy(seed, count, n):
    points = np.random.default_rng(seed).normal(size=(count, 3)).astype(np.float32)
    thinned = farthest_point_sample(points, n, seed)
    assert thinned.shape == (n, 3)
    assert thinned.dtype == np.float32
    np.testing.assert_array_equal(farthest_point_sample(points, n, seed), thinned)
    assert (thinned[:, None] == points).all(axis=-1).any(axis=1).all()
    if count <= n:
        np.testing.assert_array_equal(thinned[:count], points)
        return
    gap = np.linalg.norm(points - thinned[0], axis=1)
    for chosen in thinned[1:]:
        np.testing.assert_allclose(gap[(points == chosen).all(axis=1)].max(), gap.max(), rtol=1e-5)
        gap = np.minimum(gap, np.linalg.norm(points - chosen, axis=1))


def test_thinning_spends_its_seed_and_survives_repeated_points():
    points = np.random.default_rng(0).normal(size=(500, 3))
    assert not np.array_equal(farthest_point_sample(points, 10, 0), farthest_point_sample(points, 10, 1))
    np.testing.assert_array_equal(farthest_point_sample(np.ones((50, 3)), 7), np.ones((7, 3)))
    np.testing.assert_array_equal(farthest_point_sample(np.empty((0, 3)), 7), np.zeros((7, 3)))


@settings(max_examples=50, deadline=None)
@given(
    points=st.lists(st.tuples(*[st.floats(-2, 2) | st.sampled_from([np.nan, np.inf, -np.inf, 1.0])] * 3), max_size=20)
)
def test_crop_keeps_the_box(points):
    points = np.array(points, dtype=np.float64).reshape(-1, 3)
    expected = [all(-1 <= value <= 1 for value in point) for point in points.tolist()]
    assert crop(points, np.array([[-1, -1, -1], [1, 1, 1]])).tolist() == expected


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: crop(np.zeros((1, 3)), np.array([[0, 0, 1], [1, 1, 0]])), "workspace"),
        (lambda: RobotMask([], tau_m=0), "tau"),
        (lambda: RobotMask([None])(np.zeros((1, 3)), np.eye(4)), "1 links"),
        (lambda: SurfaceSampler([None], 3), "mesh"),
        (lambda: SurfaceSampler([trimesh.creation.box()], 3)(np.eye(4)), "1 links"),
        (lambda: farthest_point_sample(np.full((2, 3), np.nan)), "finite"),
    ],
)
def test_bad_input_is_named(make, message):
    with pytest.raises(CEIError, match=message):
        make()
