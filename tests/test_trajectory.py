"""Whole trajectories: velocity limits, smoothness, clearance, live use, ablations."""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
import trimesh
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import home, problem_of

from cei_gym.alignment import (
    ClearanceOptions,
    InitialisationOptions,
    Motion,
    SolverOptions,
    Stream,
    Surroundings,
    make_solver,
)
from cei_gym.alignment.follow import Follower
from cei_gym.alignment.judge.clearance import Clearance
from cei_gym.alignment.kernels import collision, frame
from cei_gym.alignment.kernels.target import load_source, make_target
from cei_gym.alignment.links import LinkShapes, collision_constraint, idle_bodies, link_shapes, pack_obstacles
from cei_gym.alignment.start.starts import find_basins
from cei_gym.embodiment import load_embodiment
from cei_gym.kinematics.joints import reduce_to_joints

OPTIONS = SolverOptions()
DT_S = 0.05


@cache
def follower_of(name: str, clearance: ClearanceOptions) -> Follower:
    return Follower(problem_of(name), replace(OPTIONS, clearance=clearance))


@cache
def shapes_of(name: str) -> LinkShapes:
    return link_shapes(load_embodiment(name))


def reach(frames: int = 40, lower_m: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The Panda's pads go down and close, and lower still by `lower_m`."""
    problem = problem_of("Panda-PandaGripper")
    s = np.linspace(0, 1, frames)[:, None]
    points, normals = problem.place(home(problem) + s * [0.2, 0.2, 0, -0.05, 0, 0.1, 0, -0.02])
    return points - s[:, :, None] * [0, 0, lower_m], normals


@cache
def start(name: str) -> np.ndarray:
    """The best first frame that touches neither itself nor what is a little below the pads."""
    problem, (points, normals) = problem_of(name), reach()
    clearance, qpos = Clearance(problem.embodiment), problem.embodiment.coupled.expand
    found = find_basins(problem, OPTIONS, points[0], normals[0], InitialisationOptions(starts=64))
    return next(u for u in found if clearance.worst(qpos(u)[None], points[..., 2].min() - 0.03)[0] < 1e-3)


# -- reduced tree --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["IIWA-Inspire", "Panda-RobotiqThreeFinger", "UR5e-PandaGripper"])
def test_joint_frames_place_bodies_where_mujoco_does(name: str) -> None:
    problem = problem_of(name)
    embodiment = problem.embodiment
    target = make_target(problem.representation, problem.tree, all_joints=True)
    _, attachment = reduce_to_joints(problem.tree.arrays)
    pose = frame.empty_memory(target, 4).pose
    data = mujoco.MjData(embodiment.model)
    for seed in range(3):
        u = np.random.default_rng(seed).uniform(*embodiment.independent_limits)
        collision.place_joints(target, u, pose)
        data.qpos[:] = embodiment.coupled.expand(u)
        mujoco.mj_kinematics(embodiment.model, data)
        for body in np.flatnonzero(attachment.joint >= 0):
            R, t = pose.rot[attachment.joint[body]], pose.pos[attachment.joint[body]]
            np.testing.assert_allclose(R @ attachment.pos[body] + t, data.xpos[body], atol=1e-9)
            np.testing.assert_allclose(R @ attachment.rot[body], data.xmat[body].reshape(3, 3), atol=1e-9)


# -- speed ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["UR5e-RobotiqThreeFinger", "IIWA-Inspire", "Panda-PandaGripper"])
def test_no_joint_is_faster_than_it_can(name: str) -> None:
    problem = problem_of(name)
    embodiment = problem.embodiment
    points, normals = reach(6)  # 7 times as fast as `reach`
    solver = make_solver(problem, OPTIONS)
    free = embodiment.coupled.expand(solver.track(points, normals, start(name)).u)
    held = embodiment.coupled.expand(solver.track(points, normals, start(name), dt_s=0.01).u)
    allowed = embodiment.max_velocity * 0.01
    assert (np.abs(np.diff(free, axis=0)) > 1.5 * allowed).any()
    assert (np.abs(np.diff(held, axis=0)) <= allowed + 1e-12).all()
    half = make_solver(problem, replace(OPTIONS, velocity_scale=0.5)).track(points, normals, start(name), dt_s=0.01)
    assert (np.abs(np.diff(embodiment.coupled.expand(half.u), axis=0)) <= 0.5 * allowed + 1e-12).all()
    off = make_solver(problem, replace(OPTIONS, velocity_scale=0.0)).track(points, normals, start(name), dt_s=0.01)
    np.testing.assert_array_equal(embodiment.coupled.expand(off.u), free)


def test_what_is_too_fast_is_caught_up_with() -> None:
    """A source that jumps and waits: the target arrives later, as fast as it may."""
    problem = problem_of("UR5e-RobotiqThreeFinger")
    points, normals = reach(2)
    points, normals = (np.repeat(x, [1, 40], axis=0) for x in (points, normals))
    track = make_solver(problem, OPTIONS).track(points, normals, start("UR5e-RobotiqThreeFinger"), dt_s=0.02)
    assert track.objective[1] > track.objective[-1] + 0.01
    settled = make_solver(problem, OPTIONS).track(points[-1:], normals[-1:], track.u[-1], 200)
    assert track.objective[-1] < settled.objective[0] + 1e-3


def test_smoothness_weight_lowers_acceleration() -> None:
    problem = problem_of("IIWA-Inspire")
    points, normals = reach(30)
    points = points + np.random.default_rng(0).normal(0, 0.004, (30, 1, 3))  # a hand that shakes
    jerk = []
    for weight in (0.0, 0.1, 1.0):
        track = make_solver(problem, replace(OPTIONS, smoothness_weight=weight)).track(
            points, normals, start("IIWA-Inspire")
        )
        jerk.append(np.linalg.norm(np.diff(track.u, n=2, axis=0)))
    assert jerk[0] > 1.2 * jerk[1]
    assert jerk[1] > 1.2 * jerk[2]


# -- live ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt_s", [None, DT_S])
def test_a_stream_is_the_track_frame_by_frame(dt_s: float | None) -> None:
    problem, name = problem_of("IIWA-Inspire"), "IIWA-Inspire"
    points, normals = reach(15)
    track = make_solver(problem, OPTIONS).track(points, normals, start(name), dt_s=dt_s)
    stream = Stream(problem, OPTIONS, u0=start(name), dt_s=dt_s)
    for _ in range(2):
        live = [stream(p, n) for p, n in zip(points, normals, strict=True)]
        np.testing.assert_allclose(live, track.u, atol=1e-9)
        stream.reset()


def test_a_stream_without_a_start_finds_one() -> None:
    problem = problem_of("UR5e-RobotiqThreeFinger")
    points, normals = reach(3)
    init = InitialisationOptions(starts=64)
    stream = Stream(problem, OPTIONS, init)
    first = stream(points[0], normals[0])
    expected = find_basins(problem, OPTIONS, points[0], normals[0], init)[0]
    assert np.abs(problem.place(first)[0] - problem.place(expected)[0]).max() < 1e-3


# -- clearance -----------------------------------------------------------------------------------------------


def test_idle_fingers_are_those_without_a_pad() -> None:
    problem = problem_of("IIWA-Inspire")
    names = {problem.embodiment.body_names[i] for i in np.flatnonzero(idle_bodies(problem))}
    assert names == {f"ee/r_{finger}_{part}" for finger in ("ring", "pinky") for part in ("proximal", "distal")}
    assert not idle_bodies(problem_of("Panda-RobotiqThreeFinger")).any()


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000), height=st.floats(-0.2, 0.6))
def test_missing_clearance_of_a_plane_is_that_of_the_meshes(seed: int, height: float) -> None:
    """The oracle: all vertices of all links, placed by MuJoCo."""
    problem = problem_of("Kinova3-FourierRight")
    embodiment = problem.embodiment
    u = np.random.default_rng(seed).uniform(*embodiment.independent_limits)
    options = ClearanceOptions(arm_margin_m=0.02, hand_margin_m=0.0, idle_margin_m=0.005)
    motion = Motion(*reach(1), u, surroundings=Surroundings(height))
    found = follower_of("Kinova3-FourierRight", options).shortfall_m(motion, u[None])[0]
    data = mujoco.MjData(embodiment.model)
    data.qpos[:] = embodiment.coupled.expand(u)
    mujoco.mj_kinematics(embodiment.model, data)
    shapes, idle = shapes_of("Kinova3-FourierRight"), idle_bodies(problem)
    expected = 0.0
    first = problem.tree.arrays.body_joint == 0  # the shoulder only turns about the vertical
    for body, hand in zip(shapes.body, shapes.hand, strict=True):
        if problem.tree.arrays.body_joint[body] >= 0 and not first[body]:
            geoms = [g for g in range(embodiment.model.ngeom) if embodiment.model.geom_bodyid[g] == body]
            lowest = min(
                (lowest_point(embodiment.model, data, g) for g in geoms if embodiment.model.geom_contype[g] != 0),
                default=np.inf,
            )
            margin = 0.005 if idle[body] else 0.0 if hand else 0.02
            expected = max(expected, height + margin - lowest)
    assert found == pytest.approx(expected, abs=2e-3)


def lowest_point(model: mujoco.MjModel, data: mujoco.MjData, geom: int) -> float:
    R, t = data.geom_xmat[geom].reshape(3, 3), data.geom_xpos[geom]
    size, kind = model.geom_size[geom], model.geom_type[geom]
    if kind == mujoco.mjtGeom.mjGEOM_MESH:
        mesh = model.geom_dataid[geom]
        first = model.mesh_vertadr[mesh]
        vertices = model.mesh_vert[first : first + model.mesh_vertnum[mesh]]
        return float((vertices @ R[2] + t[2]).min())
    if kind == mujoco.mjtGeom.mjGEOM_SPHERE:
        return float(t[2] - size[0])
    if kind == mujoco.mjtGeom.mjGEOM_BOX:
        return float(t[2] - np.abs(R[2]) @ size)
    if kind == mujoco.mjtGeom.mjGEOM_CAPSULE:
        return float(t[2] - abs(R[2, 2]) * size[1] - size[0])
    assert kind == mujoco.mjtGeom.mjGEOM_CYLINDER, kind
    return float(t[2] - abs(R[2, 2]) * size[1] - np.hypot(R[2, 0], R[2, 1]) * size[0])


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_points_in_an_idle_finger_are_as_deep_as_in_its_hull(seed: int) -> None:
    problem = problem_of("IIWA-Inspire")
    embodiment = problem.embodiment
    rng = np.random.default_rng(seed)
    shapes, idle = shapes_of("IIWA-Inspire"), idle_bodies(problem)
    which = int(rng.choice(np.flatnonzero(idle[shapes.body])))
    hull = trimesh.convex.convex_hull(shapes.vertices_link[which])
    weights = rng.dirichlet(np.ones(len(hull.vertices)))
    inside_link = weights @ hull.vertices
    depth = float(trimesh.proximity.signed_distance(hull, inside_link[None])[0])
    T = problem.tree.forward(embodiment.coupled.expand(home(problem)))[shapes.body[which]]
    obstacle = (T[:3, :3] @ inside_link + T[:3, 3])[None]
    far = Surroundings(-10.0, [obstacle])
    follower = follower_of("IIWA-Inspire", ClearanceOptions(idle_margin_m=0.0))
    found = follower.shortfall_m(Motion(*reach(1), home(problem), surroundings=far), home(problem)[None])[0]
    assert depth > 0
    assert found >= depth - 1e-6  # sides of the shape touch the hull or stand off
    assert found < depth + 0.004
    elsewhere = Surroundings(-10.0, [obstacle + [0.0, 0.0, 1.0]])
    assert follower.shortfall_m(Motion(*reach(1), home(problem), surroundings=elsewhere), home(problem)[None])[0] == 0


@pytest.mark.parametrize("seed", range(4))
def test_the_penaltys_gradient_is_its_finite_difference(seed: int) -> None:
    problem = problem_of("IIWA-Inspire")
    embodiment = problem.embodiment
    rng = np.random.default_rng(seed)
    target = make_target(problem.representation, problem.tree, all_joints=True)
    links = collision_constraint(problem, ClearanceOptions(arm_margin_m=0.1, hand_margin_m=0.1, idle_margin_m=0.05))
    links = links._replace(height_m=0.35)
    u = home(problem) + rng.uniform(-0.2, 0.2, len(home(problem)))
    u = np.clip(u, *embodiment.independent_limits)
    fingers = problem.tree.forward(embodiment.coupled.expand(u))[idle_bodies(problem)][:, :3, 3]
    packed = pack_obstacles(Surroundings(0.0, [fingers + rng.normal(0, 0.01, fingers.shape)]), 1)
    obstacles = collision.at_frame(packed, 0)
    memory = frame.empty_memory(target, 4)
    load_source(*(x[0, :4].copy() for x in reach(1)), memory.source)

    def penalty(u: np.ndarray, derivatives: bool = False) -> float:
        collision.place_joints(target, u, memory.pose)
        origin = memory.source.origin
        return collision.penalise(links, obstacles, origin, memory.pose, memory.quadratic, derivatives)

    memory.quadratic.force[:] = 0
    memory.quadratic.block[:] = 0
    assert penalty(u, derivatives=True) > 0.1
    frame.project(target, memory.source.origin, memory.pose, memory.quadratic)
    h = 1e-7
    numeric = [(penalty(u + h * e) - penalty(u - h * e)) / (2 * h) for e in np.eye(len(u))]
    np.testing.assert_allclose(memory.quadratic.gradient, numeric, rtol=1e-4, atol=1e-3)
    # Gauss-Newton: a sum of squares
    assert np.linalg.eigvalsh(memory.quadratic.hessian).min() > -1e-6


@pytest.mark.parametrize("name", ["IIWA-Inspire", "UR5e-RobotiqThreeFinger"])
def test_a_track_that_goes_too_low_is_lifted(name: str) -> None:
    """Judged by MuJoCo, not by the shapes that the terms use."""
    problem = problem_of(name)
    points, normals = reach(40, lower_m=0.03)
    free = make_solver(problem, OPTIONS).track(points, normals, start(name))
    follower = Follower(problem, OPTIONS)
    qpos = problem.embodiment.coupled.expand
    lowest = points[:, :, 2].min() + 0.01  # a surface that the source's pads dip into by 1 cm
    motion = Motion(points, normals, start(name), surroundings=Surroundings(lowest))
    held = follower.follow(motion)
    deep, _ = follower.clearance.worst(qpos(free.u), lowest)
    shallow, _ = follower.clearance.worst(qpos(held.u), lowest)
    assert deep > 0.008
    assert shallow < 0.003
    assert held.objective.mean() < free.objective.mean() + 0.01
    ignored = Follower(problem, replace(OPTIONS, clearance=ClearanceOptions(weight=0))).follow(motion)
    np.testing.assert_array_equal(ignored.u, free.u)


def test_a_track_with_room_is_not_touched() -> None:
    problem, name = problem_of("IIWA-Inspire"), "IIWA-Inspire"
    points, normals = reach(10)
    motion = Motion(points, normals, start(name), surroundings=Surroundings(-1.0, [np.full((5, 3), 9.0)] * 10))
    free = make_solver(problem, OPTIONS).track(points, normals, start(name))
    np.testing.assert_array_equal(Follower(problem, OPTIONS).follow(motion).u, free.u)


def test_an_idle_finger_gets_out_of_an_objects_way() -> None:
    problem, name = problem_of("IIWA-Inspire"), "IIWA-Inspire"
    points, normals = reach(10)
    follower = Follower(problem, OPTIONS)
    free = make_solver(problem, OPTIONS).track(points, normals, start(name))
    shapes = link_shapes(problem.embodiment)
    body = problem.embodiment.body_id("r_pinky_distal")
    vertices = shapes.vertices_link[int(np.flatnonzero(shapes.body == body)[0])]
    T = problem.tree.forward(problem.embodiment.coupled.expand(free.u[-1]))[body]
    blob = vertices.mean(0) + np.random.default_rng(0).normal(0, 0.002, (30, 3))
    ball = blob @ T[:3, :3].T + T[:3, 3]  # sits in the fingertip where the trajectory ends
    motion = Motion(points, normals, start(name), surroundings=Surroundings(-1.0, [ball] * 10))
    assert follower.shortfall_m(motion, free.u)[-1] > 0.005
    held = follower.follow(motion)
    assert follower.shortfall_m(motion, held.u)[-1] < 0.002
    idle = [problem.embodiment.joint_names[i] for i in problem.embodiment.coupled.independent].index(
        "joint_r_pinky_proximal"
    )
    assert np.ptp(free.u[:, idle]) == 0
    assert abs(held.u[-1, idle] - free.u[-1, idle]) > 0.05
    assert held.objective.mean() < free.objective.mean() + 2e-3
