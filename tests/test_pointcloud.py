"""Crop, mask, sample and thin against slow oracles that share no code with them."""

import copy

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from cei_gym.demonstration import Scene
from cei_gym.embodiment import Embodiment, load_embodiment
from cei_gym.embodiment.meshes import visual_geoms, visual_link_meshes
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud import (
    CloudOptions,
    CloudSynthesiser,
    RobotMask,
    SurfaceSampler,
    crop,
    farthest_point_sample,
    first_of_voxels,
    frame_points,
    fuse_depth,
    share_sample,
)
from cei_gym.pointcloud.seen import SeenPoints
from cei_gym.rendering import look_at

seeds = st.integers(0, 2**31)
PANDA, UR5E = "Panda-PandaGripper", "UR5e-FourierRight"


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
        assert distances(points_world[sampler.link_ids == link], body).max() < 1e-6  # as far as trimesh measures
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
    if count <= n:  # all of them, before any comes again
        assert {*map(tuple, thinned[:count])} == {*map(tuple, points)}
    gap = np.linalg.norm(points - thinned[0], axis=1)
    for chosen in thinned[1:count]:
        np.testing.assert_allclose(gap[(points == chosen).all(axis=1)].max(), gap.max(), rtol=1e-5)
        gap = np.minimum(gap, np.linalg.norm(points - chosen, axis=1))


@pytest.mark.parametrize("count", [65, 128, 129, 5000])
def test_thinning_is_the_brute_force_one_to_the_bit(count):
    points = np.random.default_rng(count).normal(size=(count, 3)).astype(np.float32)
    points[count // 2] = points[0]  # a point twice
    thinned = farthest_point_sample(points, 64)
    chosen, gap = [int(np.flatnonzero((points == thinned[0]).all(axis=1))[0])], np.full(count, np.inf, np.float32)
    for _ in range(63):
        difference = points - points[chosen[-1]]
        square = difference[:, 0] ** 2 + difference[:, 1] ** 2 + difference[:, 2] ** 2
        gap = np.minimum(gap, square)
        gap[chosen] = -1
        chosen.append(int(gap.argmax()))
    np.testing.assert_array_equal(thinned, points[chosen])


def test_a_cloud_with_few_points_is_in_that_order_too_and_loses_none_of_one_place():
    """The first of a cloud that a policy looks at are as well spread as all: of a picture row by row they would be its top."""
    row = np.stack([np.arange(200.0), np.zeros(200), np.zeros(200)], axis=1)
    for first in (8, 50):
        assert np.diff(np.sort(farthest_point_sample(row, 1024)[:first, 0])).max() <= 2 * 200 / first
    coloured = np.concatenate([np.zeros((5, 3)), np.eye(5)[:, :3]], axis=1)
    coloured[:, 3] = np.arange(5)
    assert {*farthest_point_sample(coloured, 8)[:5, 3]} == {0, 1, 2, 3, 4}


def test_thinning_spends_its_seed_and_survives_repeated_points():
    points = np.random.default_rng(0).normal(size=(500, 3))
    assert not np.array_equal(farthest_point_sample(points, 10, 0), farthest_point_sample(points, 10, 1))
    np.testing.assert_array_equal(farthest_point_sample(np.ones((50, 3)), 7), np.ones((7, 3)))
    np.testing.assert_array_equal(farthest_point_sample(np.empty((0, 3)), 7), np.zeros((7, 3)))


@settings(max_examples=50, deadline=None)
@given(seed=seeds, count=st.integers(0, 300), voxel_m=st.sampled_from([0.01, 0.3, 5.0]))
def test_a_voxel_keeps_its_first_point(seed, count, voxel_m):
    points = np.random.default_rng(seed).normal(size=(count, 6))
    first: dict[tuple, int] = {}
    for i, point in enumerate(points):
        first.setdefault(tuple(np.floor(point[:3] / voxel_m)), i)
    assert first_of_voxels(points, voxel_m).tolist() == sorted(first.values())


@settings(max_examples=25, deadline=None)
@given(seed=seeds, count=st.integers(1, 200))
def test_colours_go_with_their_points_and_have_no_say(seed, count):
    random = np.random.default_rng(seed)
    points = random.normal(size=(count, 3)).astype(np.float32)
    colours = random.uniform(0, 1e6, size=(count, 3)).astype(np.float32)
    plain = farthest_point_sample(points, 32, seed)
    coloured = farthest_point_sample(np.concatenate([points, colours], axis=1), 32, seed)
    np.testing.assert_array_equal(coloured[:, :3], plain)
    for row in coloured:
        assert (colours[(points == row[:3]).all(axis=1)] == row[3:]).all(axis=1).any()


TWO_COLOURS = """
<mujoco><worldbody>
  <geom type="box" size="0.1 0.1 0.1" rgba="1 0 0 1"/>
  <body pos="0 0 0.3"><geom type="sphere" size="0.1" rgba="0 0.2 1 1"/></body>
</worldbody></mujoco>
"""


def test_sampled_points_have_the_colours_of_their_geoms():
    sampler = SurfaceSampler(visual_link_meshes(mujoco.MjModel.from_xml_string(TWO_COLOURS)), 200)
    assert set(sampler.link_ids) == {0, 1}
    np.testing.assert_allclose(sampler.colours[sampler.link_ids == 0], [[1, 0, 0]] * (sampler.link_ids == 0).sum())
    np.testing.assert_allclose(sampler.colours[sampler.link_ids == 1], [[0, 0.2, 1]] * (sampler.link_ids == 1).sum())


def rays(robot: Embodiment, eye: np.ndarray, points: np.ndarray) -> np.ndarray:
    """How far in front of each point MuJoCo's ray from the eye first meets the robot at home, m."""
    model = copy.copy(robot.model)
    model.geom_group[:] = ~visual_geoms(model)
    data = mujoco.MjData(model)
    data.qpos[:] = robot.home
    mujoco.mj_forward(model, data)
    away = np.linalg.norm(points - eye, axis=1)
    first = [
        mujoco.mj_ray(model, data, eye, direction, np.eye(6, dtype=np.uint8)[0], 1, -1, np.zeros(1, np.int32))
        for direction in (points - eye) / away[:, None]
    ]
    return away - np.where(np.array(first) < 0, np.inf, first)


def test_seen_points_are_those_that_rays_reach():
    robot = load_embodiment(PANDA)
    meshes = visual_link_meshes(robot.model)
    T = KinematicTree(robot).forward(robot.home)
    points = SurfaceSampler(meshes, 1500)(T)
    cameras = [
        look_at("a", (1.6, 0.9, 0.8), (0.3, 0, 0.4), 640, 480, 50),
        look_at("b", (-1, 1, 1), (0, 0, 0.4), 640, 480, 50),
    ]
    y, z = np.meshgrid(np.linspace(-0.3, 0.7, 1000), np.linspace(0.4, 0.9, 800))
    wall = np.stack([np.full(y.size, 0.8), y.ravel(), z.ravel()], axis=1)
    seen = SeenPoints(robot.model, cameras)(points, T, wall)
    free, blocked = [], []
    for camera in cameras:
        eye = camera.T_world_camera[:3, 3]
        behind_m = rays(robot, eye, points)
        share = (0.8 - eye[0]) / (points[:, 0] - eye[0])  # of the ray before it meets the wall's plane
        met = eye + share[:, None] * (points - eye)
        inset_m = np.minimum(met[:, 1:] - (-0.3, 0.4), (0.7, 0.9) - met[:, 1:]).min(axis=1)
        walled = (share > 0) & (share < 1)
        free.append((behind_m < 0.002) & ~(walled & (inset_m > -0.02)))
        blocked.append((behind_m > 0.05) | (walled & (inset_m > 0.02)))
    expected, hidden = np.any(free, axis=0), np.all(blocked, axis=0)
    assert expected.sum() > 100
    assert hidden.sum() > 100
    assert seen[expected].mean() > 0.95  # grazing surfaces lean more than 1 cm within a pixel
    assert seen[hidden].mean() < 0.02  # within half a pixel of an outline


SCENE = Scene(
    np.eye(4), (look_at("a", (1.6, 0.9, 0.8), (0.3, 0, 0.4), 160, 120, 50),), np.array([[0.1, -1, -0.1], [1, 1, 1]])
)


def exchanged(options: CloudOptions, scene_points: np.ndarray, scene: Scene = SCENE) -> np.ndarray:
    """The cloud of a UR5e in the place of a Panda, both at home, in float64."""
    source, target = load_embodiment(PANDA), load_embodiment(UR5E)
    synthesiser = CloudSynthesiser(source, target, options)
    return synthesiser.add(synthesiser.remove(scene_points, scene, source.home), scene, target.home).astype(float)


def ball(points: int = 400, columns: int = 3) -> np.ndarray:
    """On a ball that no robot is near; colours tell the points apart."""
    random = np.random.default_rng(1)
    xyz = random.normal(size=(points, 3))
    xyz = 0.05 * xyz / np.linalg.norm(xyz, axis=1, keepdims=True) + (0.8, -0.7, 0.0)
    return np.concatenate([xyz, random.uniform(size=(points, 3))], axis=1)[:, :columns]


def on_ball(cloud: np.ndarray) -> np.ndarray:
    return np.abs(np.linalg.norm(cloud[:, :3] - (0.8, -0.7, 0.0), axis=1) - 0.05) < 1e-6


def test_a_coloured_cloud_stays_coloured_and_its_robot_gets_the_robots_colours():
    recorded = ball(columns=6)
    cloud = exchanged(CloudOptions(points=512), recorded)
    assert cloud.shape == (512, 6)
    of_ball = on_ball(cloud)
    assert of_ball.sum() > 5
    for point in cloud[of_ball]:
        np.testing.assert_allclose(recorded[np.abs(recorded[:, :3] - point[:3]).max(axis=1).argmin()], point, atol=1e-6)
    palette = {
        tuple(c) for c in np.round(SurfaceSampler(visual_link_meshes(load_embodiment(UR5E).model), 4096).colours, 5)
    }
    assert {tuple(c) for c in np.round(cloud[~of_ball, 3:], 5)} <= palette
    np.testing.assert_array_equal(exchanged(CloudOptions(points=512, colours=False), recorded), cloud[:, :3])


def test_only_what_cameras_see_is_put_in():
    cloud, whole = (exchanged(CloudOptions(seen_only=only), ball()) for only in (True, False))
    target = load_embodiment(UR5E)
    seen = SeenPoints(target.model, SCENE.cameras)
    T = KinematicTree(target).forward(target.home)
    assert seen(cloud[~on_ball(cloud)], T, np.zeros((0, 3))).mean() > 0.99
    assert seen(whole[~on_ball(whole)], T, np.zeros((0, 3))).mean() < 0.7
    with pytest.raises(CEIError, match=r"clouds\.seen_only asks what cameras see, but the scene has none"):
        exchanged(CloudOptions(seen_only=True), ball(), Scene(np.eye(4), (), SCENE.workspace_world))


@pytest.mark.parametrize("points", [200, 512])
def test_a_robot_leaves_its_share_to_what_is_small(points: int):
    cloud, whole = (exchanged(CloudOptions(points=points, robot_share=share), ball()) for share in (0.25, None))
    assert len(np.unique(cloud, axis=0)) == points
    assert on_ball(cloud).mean() == 0.75 > 3 * on_ball(whole).mean()
    assert on_ball(cloud[: points // 2]).mean() == 0.75  # the first are a cloud themselves
    spread = farthest_point_sample(ball(), int(0.75 * points)).astype(float)
    np.testing.assert_array_equal(cloud[on_ball(cloud)], spread)


def test_a_share_that_others_cannot_fill_goes_to_the_robot():
    cloud = exchanged(CloudOptions(points=512, robot_share=0.25), ball(points=60))
    assert on_ball(cloud).sum() == 60
    assert len(np.unique(cloud, axis=0)) == 512
    nothing, other = np.zeros((0, 3)), ball(points=8)
    assert share_sample(nothing, nothing, 0.5, 4).tolist() == [[0, 0, 0]] * 4
    for others, robot in ((other, nothing), (nothing, other)):
        assert on_ball(share_sample(others, robot, 0.5, 12).astype(float)).all()


def test_voxels_thin_before_thinning():
    cloud = exchanged(CloudOptions(points=4096, voxel_m=0.05), ball())
    distinct = np.unique(cloud, axis=0)
    assert len(distinct) < 1000
    assert len({tuple(np.floor(p / 0.05)) for p in distinct.astype(np.float32).astype(float)}) > 0.99 * len(distinct)


def test_points_of_a_frame_come_from_the_richest_source():
    depth_m = {"a": np.where(np.arange(120 * 160).reshape(120, 160) % 3 == 0, 1.5, 0).astype(np.float32)}
    rgb = {"a": np.random.default_rng(0).integers(0, 256, (120, 160, 3), dtype=np.uint8)}
    plain, coloured = ball(), ball(columns=6)
    seen = fuse_depth(SCENE, depth_m)
    assert frame_points(SCENE, {}, {}, None, True) is None
    assert frame_points(SCENE, {}, {}, plain, True) is plain
    np.testing.assert_array_equal(frame_points(SCENE, depth_m, {}, plain, True), seen)
    assert frame_points(SCENE, depth_m, {}, coloured, True) is coloured
    np.testing.assert_array_equal(frame_points(SCENE, depth_m, {}, coloured, False), seen)
    fused = frame_points(SCENE, depth_m, rgb, coloured, True)
    np.testing.assert_array_equal(fused[:, :3], seen)
    np.testing.assert_array_equal(fused[:, 3:], rgb["a"].reshape(-1, 3)[::3] / 255)
    np.testing.assert_array_equal(frame_points(SCENE, depth_m, {"b": rgb["a"]}, plain, True), seen)
    assert frame_points(SCENE, depth_m, {"b": rgb["a"]}, coloured, True) is coloured
    with pytest.raises(CEIError, match=r"camera 'a' has depth \(120, 160\) but a picture of shape None"):
        fuse_depth(SCENE, depth_m, {"b": rgb["a"]})


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
        (lambda: CloudOptions(robot_share=1.0), r"clouds\.robot_share=1\.0 must be between 0 and 1, or null"),
        (lambda: CloudOptions(points=0), r"clouds\.points=0"),
        (lambda: CloudOptions(tau_m=float("nan")), r"clouds\.tau_m=nan"),
        (lambda: CloudOptions(voxel_m=-1), r"clouds\.voxel_m=-1"),
        (lambda: exchanged(CloudOptions(), np.zeros((5, 4))), r"\(N, 6\): and r, g, b in \[0, 1\]; not \(5, 4\)"),
    ],
)
def test_bad_input_is_named(make, message):
    with pytest.raises(CEIError, match=message):
        make()
