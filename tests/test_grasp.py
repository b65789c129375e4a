"""What contact is: which sides close on each other, where they meet, and how a followed trajectory is refined for it.

Oracles are MuJoCo's geometry, brute force over vertices and points, and finite differences, never the code under test.
"""

from dataclasses import replace
from functools import cache

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import problem_of
from scipy.optimize import linprog, minimize
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from cei_gym.alignment import (
    AlignmentProblem,
    ClearanceOptions,
    ContactOptions,
    InitialisationOptions,
    Motion,
    SolverOptions,
    Surroundings,
    Track,
    make_solver,
)
from cei_gym.alignment.contact.observed import onto_objects, source_grip
from cei_gym.alignment.contact.pads import opposing_sides, pad_shapes
from cei_gym.alignment.contact.refine import GraspRefiner
from cei_gym.alignment.contact.squeeze import squeeze
from cei_gym.alignment.follow import Follower
from cei_gym.alignment.grip import Grip
from cei_gym.alignment.kernels import collision, contact
from cei_gym.alignment.kernels.contact import SOFTNESS_M, in_grip
from cei_gym.alignment.kernels.distance import place_joints
from cei_gym.alignment.kernels.frame import empty_memory
from cei_gym.alignment.kernels.quadratic import project
from cei_gym.alignment.kernels.target import empty_pose, make_target
from cei_gym.alignment.links import collision_constraint, link_shapes, no_collision_constraint
from cei_gym.alignment.retime import retime
from cei_gym.alignment.start.starts import find_basins
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.embodiment import END_EFFECTORS, Embodiment, Pad, load_embodiment
from cei_gym.embodiment.meshes import outermost
from cei_gym.functional import sample_representation
from cei_gym.functional.representation import pad_mesh
from cei_gym.kinematics import KinematicTree
from cei_gym.pointcloud import CloudOptions
from cei_gym.pointcloud.remember import remember
from cei_gym.transfer import Transfer, TransferOptions

SOURCE, TARGETS = "Panda-PandaGripper", ("UR5e-FourierLeft", "UR5e-RobotiqThreeFinger")
DT_S = 0.05
OPTIONS = SolverOptions()
CONTACT = ContactOptions(opposition_weight=1e3, turning_weight=1.0, carrying_weight=5.0, posture_weight=0.5)
REACHED, CLOSED, HELD, FRAMES = 16, 24, 28, 44
SEEDS = st.integers(0, 2**31)
ARM_OF = dict(zip(END_EFFECTORS, ("Kinova3", "IIWA", "Panda", "UR5e", "Panda"), strict=True))


def root_of(embodiment: Embodiment) -> int:
    """The end-effector's first link: the first body below the arm's own."""
    return next(i for i, name in enumerate(embodiment.body_names) if name.startswith("ee/"))


def random_joints(embodiment: Embodiment, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).uniform(*embodiment.independent_limits)


def mujoco_data(embodiment: Embodiment, qpos: np.ndarray) -> mujoco.MjData:
    data = mujoco.MjData(embodiment.model)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(embodiment.model, data)
    return data


def body_points(data: mujoco.MjData, body: int, points_link: np.ndarray) -> np.ndarray:
    return points_link @ data.xmat[body].reshape(3, 3).T + data.xpos[body]


def some_rotation(rng: np.random.Generator, angle: float) -> np.ndarray:
    axis = rng.normal(size=3)
    x, y, z = axis / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    return np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K


def angle_deg(R: np.ndarray, other: np.ndarray) -> np.ndarray:
    cosine = (np.einsum("...ij,...ij->...", R, other) - 1) / 2
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


# -- sides ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", END_EFFECTORS)
def test_the_thumb_is_on_one_side_and_the_fingers_on_the_other(name: str) -> None:
    problem = problem_of(f"{ARM_OF[name]}-{name}")
    sides = opposing_sides(problem.representation, problem.tree)
    pads = problem.embodiment.end_effector.pads
    of_pad = {}
    for pad in pads:
        own = sides[problem.representation.body == problem.embodiment.body_id(pad.body)]
        assert len(set(own.tolist())) == 1
        of_pad[pad.body] = int(own[0])
    (alone,) = [body for body in of_pad if "thumb" in body or "middle_link_3" in body or body == "finger_joint1_tip"]
    others = [side for body, side in of_pad.items() if body != alone]
    assert set(of_pad.values()) == {0, 1}
    assert set(others) == {1 - of_pad[alone]}


def with_pads(name: str, keep: list[int]) -> AlignmentProblem:
    embodiment = load_embodiment(name)
    spec = embodiment.end_effector
    embodiment = replace(embodiment, end_effector=replace(spec, pads=[spec.pads[i] for i in keep]))
    return AlignmentProblem(sample_representation(embodiment, 24), KinematicTree(embodiment))


@pytest.mark.parametrize(
    ("name", "keep"),
    [("Panda-PandaGripper", [0]), ("IIWA-Inspire", [0]), ("IIWA-Inspire", [1, 2]), ("Kinova3-FourierRight", [1, 2])],
)
def test_pads_that_do_not_face_each_other_have_no_sides(name: str, keep: list[int]) -> None:
    """One pad alone, and two fingers without their thumb."""
    problem = with_pads(name, keep)
    assert opposing_sides(problem.representation, problem.tree) is None
    # Then there is no contact to carry over, and a trajectory stays as it was followed.
    u = problem.embodiment.coupled.reduce(problem.embodiment.home)[None]
    track = Track(u, np.zeros(1), np.zeros(1, int))
    motion = Motion(*problem.place(u), u[0], grip=source_motion().grip.at(np.array([HELD])))
    refiner = GraspRefiner(problem, OPTIONS, CONTACT)
    assert refiner.refine(motion, track) is track
    assert (refiner.overlap(motion, u)[0] == 0).all()


# -- the source's grip ---------------------------------------------------------------------------------------


@cache
def source_qpos() -> np.ndarray:
    """(FRAMES, 9): a Panda that reaches out, closes on 36 mm, rests, and carries while it turns."""
    home = load_embodiment(SOURCE).home
    smooth = 0.5 - 0.5 * np.cos(np.pi * np.linspace(0, 1, 16)[:, None])
    reach = home + smooth * np.array([0.1, 0.25, 0, -0.1, 0.1, 0.2, 0.1, 0, 0])
    rest = np.repeat(reach[-1:], HELD - REACHED, axis=0)
    carry = reach[-1] + smooth * np.array([0.2, -0.2, 0.1, 0, 0.1, -0.1, 0.3, 0, 0])
    qpos = np.concatenate([reach, rest, carry])
    gap = np.interp(np.arange(FRAMES), [REACHED - 1, CLOSED - 1], [0.04, 0.018])
    qpos[:, 7:] = gap[:, None] * [1, -1]
    return qpos


@cache
def source_motion() -> Motion:
    """The same, as a motion in the base frame that all arms here share; it starts nowhere."""
    problem = problem_of(SOURCE)
    representation = problem.representation
    T_links = problem.tree.forward(source_qpos())
    sides = opposing_sides(representation, problem.tree)
    held = np.arange(FRAMES) >= HELD
    grip = source_grip(representation, sides, root_of(problem.embodiment), T_links, held)
    return Motion(*representation.place(T_links), np.zeros(0), dt_s=DT_S, surroundings=Surroundings(-0.5), grip=grip)


def face_centres(data: mujoco.MjData, model: mujoco.MjModel) -> np.ndarray:
    """(2, 3) middles of the faces with which the Panda's two box pads look at each other."""
    geoms = [model.geom(f"ee/finger{i}_pad_collision").id for i in (1, 2)]
    centres = []
    for geom, other in (geoms, geoms[::-1]):
        R = data.geom_xmat[geom].reshape(3, 3)
        towards = R.T @ (data.geom_xpos[other] - data.geom_xpos[geom])
        k = int(np.abs(towards).argmax())
        offset = np.zeros(3)
        offset[k] = np.sign(towards[k]) * model.geom_size[geom][k]
        centres.append(data.geom_xpos[geom] + R @ offset)
    return np.array(centres)


@settings(max_examples=15, deadline=None)
@given(seed=SEEDS, opening=st.floats(0.002, 0.04))
def test_contacts_of_a_parallel_gripper_are_where_its_pads_look_at_each_other(seed: int, opening: float) -> None:
    problem = problem_of(SOURCE)
    embodiment, model = problem.embodiment, problem.embodiment.model
    u = random_joints(embodiment, seed)
    u[-1] = opening
    qpos = embodiment.coupled.expand(u)
    data = mujoco_data(embodiment, qpos)
    sides = opposing_sides(problem.representation, problem.tree)
    T_links, held = problem.tree.forward(qpos[None]), np.ones(1, bool)
    grip = source_grip(problem.representation, sides, root_of(embodiment), T_links, held)
    faces = face_centres(data, model)
    if sides[problem.representation.body == embodiment.body_id("finger_joint1_tip")][0] == 1:
        faces = faces[::-1]
    np.testing.assert_allclose(grip.contacts[0], faces, atol=1e-6)
    between = grip.contacts[0, 1] - grip.contacts[0, 0]
    # Unit, and the way in which side 0 presses: towards side 1.
    assert np.linalg.norm(grip.axis[0]) == pytest.approx(1, abs=1e-9)
    np.testing.assert_allclose(between / np.linalg.norm(between), grip.axis[0], atol=1e-3)
    np.testing.assert_allclose(grip.position[0], data.xpos[root_of(embodiment)], atol=1e-9)
    np.testing.assert_allclose(grip.rotation[0], data.xmat[root_of(embodiment)].reshape(3, 3), atol=1e-9)


def test_a_grip_moves_with_its_gripper() -> None:
    """Frame by frame what a rigid motion of the whole robot makes of it."""
    problem = problem_of(SOURCE)
    rng = np.random.default_rng(0)
    T_links = problem.tree.forward(source_qpos()[:4])
    moved, shift = np.eye(4), rng.normal(size=3)
    moved[:3, :3], moved[:3, 3] = some_rotation(rng, 1.0), shift
    sides = opposing_sides(problem.representation, problem.tree)
    arguments = (problem.representation, sides, root_of(problem.embodiment))
    here, there = (source_grip(*arguments, T, np.zeros(4, bool)) for T in (T_links, moved @ T_links))
    R = moved[:3, :3]
    np.testing.assert_allclose(there.axis, here.axis @ R.T, atol=1e-9)
    np.testing.assert_allclose(there.contacts, here.contacts @ R.T + shift, atol=1e-9)
    np.testing.assert_allclose(there.position, here.position @ R.T + shift, atol=1e-9)
    np.testing.assert_allclose(there.rotation, R @ here.rotation, atol=1e-9)


@settings(max_examples=40, deadline=None)
@given(held=st.lists(st.booleans(), min_size=1, max_size=20), seed=SEEDS)
def test_carried_is_the_way_since_the_frame_that_took_hold(held: list[bool], seed: int) -> None:
    rng, T = np.random.default_rng(seed), len(held)
    contacts = rng.normal(size=(T, 2, 3))
    grip = Grip(rng.normal(size=(T, 3)), contacts, np.zeros((T, 3)), np.zeros((T, 3, 3)), np.array(held))
    for t, carried in enumerate(grip.carried_m):
        took = t
        while took > 0 and held[t] and held[took - 1]:
            took -= 1
        expected = np.linalg.norm((contacts[t] - contacts[took]).mean(axis=0)) if held[t] else 0.0
        assert carried == pytest.approx(expected, abs=1e-12)


def test_frames_of_a_motion_can_be_taken_again_and_again() -> None:
    motion = source_motion()
    clouds = [np.full((t, 3), float(t)) for t in range(FRAMES)]
    motion = replace(motion, surroundings=Surroundings(0.1, clouds))
    frames = np.array([0, 3, 3, 9])
    taken = motion.at(frames)
    for new, old in enumerate(frames):
        np.testing.assert_array_equal(taken.points_base[new], motion.points_base[old])
        np.testing.assert_array_equal(taken.normals_base[new], motion.normals_base[old])
        np.testing.assert_array_equal(taken.surroundings.obstacles_base[new], clouds[old])
        for name in ("axis", "contacts", "position", "rotation", "held"):
            np.testing.assert_array_equal(getattr(taken.grip, name)[new], getattr(motion.grip, name)[old])
    assert len(taken.surroundings.obstacles_base) == len(taken.grip.held) == 4
    assert (taken.surroundings.support_z_base_m, taken.dt_s) == (0.1, DT_S)
    bare = replace(motion, grip=None, surroundings=Surroundings(0.2)).at(frames)
    assert bare.grip is None
    assert len(bare.surroundings.obstacles_base) == 0
    assert replace(motion, surroundings=None).at(frames).surroundings is None


def test_frames_of_a_demonstration_can_be_taken_again_and_again() -> None:
    rng, T = np.random.default_rng(0), 6
    scene = Scene(np.eye(4), (), np.zeros((2, 3)))
    whole = Demonstration(
        SOURCE,
        20.0,
        rng.normal(size=(T, 9)),
        rng.normal(size=(T, 9)),
        scene,
        task="Wait.",
        depth_m={"a": rng.random((T, 2, 3)), "b": rng.random((T, 4, 5))},
        point_cloud_world=rng.random((T, 7, 3)),
        environment_state=rng.random((T, 2)),
        environment_state_names=("x_m", "y_m"),
        index=3,
    )
    frames = np.array([0, 1, 1, 5])
    taken = whole.at(frames)
    assert len(taken) == 4
    for name in ("qpos", "action", "point_cloud_world", "environment_state"):
        np.testing.assert_array_equal(getattr(taken, name), getattr(whole, name)[[0, 1, 1, 5]])
    for name, images in whole.depth_m.items():
        np.testing.assert_array_equal(taken.depth_m[name], images[[0, 1, 1, 5]])
    for name in ("embodiment", "fps", "scene", "task", "environment_state_names", "index"):
        assert getattr(taken, name) == getattr(whole, name)
    bare = replace(whole, point_cloud_world=None, environment_state=None, depth_m={}).at(frames)
    assert (bare.point_cloud_world, bare.environment_state, bare.depth_m) == (None, None, {})


@settings(max_examples=60, deadline=None)
@given(seed=SEEDS, length=st.floats(0.0, 0.1), radius=st.floats(0.005, 0.05))
def test_what_is_in_the_grip_is_near_the_line_between_the_contacts(seed: int, length: float, radius: float) -> None:
    rng = np.random.default_rng(seed)
    one, direction = rng.normal(size=3), rng.normal(size=3)
    other = one + length * direction / np.linalg.norm(direction)
    points = (one + other) / 2 + rng.uniform(-0.12, 0.12, (200, 3))
    found = in_grip(points, np.array([one, other]), radius)
    share = np.linspace(0, 1, 4001)
    segment = one + share[:, None] * (other - one)
    apart = np.linalg.norm(points[:, None] - segment[None], axis=-1)
    distance, where = apart.min(axis=1), share[apart.argmin(axis=1)]
    slack = length / 4000 + 1e-9
    between = (where > 0) & (where < 1)
    sure = np.abs(distance - radius) > slack
    np.testing.assert_array_equal(found[between & sure], (distance < radius)[between & sure])
    assert found[distance < radius - slack].all()
    assert not found[distance > np.sqrt(2) * radius + slack].any()  # ends are flat


# -- contact points of a configuration -----------------------------------------------------------------------


@pytest.mark.parametrize("name", ["UR5e-FourierLeft", "UR5e-RobotiqThreeFinger", "Panda-PandaGripper"])
@pytest.mark.parametrize("seed", range(4))
def test_a_pad_touches_where_it_reaches_farthest(name: str, seed: int) -> None:
    """As deep as the farthest of all vertices of its mesh, and across among those that are about as far."""
    problem = problem_of(name)
    embodiment = problem.embodiment
    # the pads as kernels take them
    target, grasp, _, _ = GraspRefiner(problem, OPTIONS, CONTACT).arrays
    rng = np.random.default_rng(seed)
    u = random_joints(embodiment, seed)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    pose, points = empty_pose(target, 1), np.empty((len(grasp.joint), 3))
    place_joints(target, u, pose)
    contact.contact_points(grasp, pose, axis, points)
    data = mujoco_data(embodiment, embodiment.coupled.expand(u))
    sides = opposing_sides(problem.representation, problem.tree)
    for pad, point in zip(embodiment.end_effector.pads, points, strict=True):
        body = embodiment.body_id(pad.body)
        vertices = body_points(data, body, pad_vertices(embodiment, pad))
        pressing = axis if sides[problem.representation.body == body][0] == 0 else -axis
        depth = vertices @ pressing
        # `outermost` leaves out what is within 2 mm of what it keeps.
        assert depth.max() - 2e-3 < point @ pressing < depth.max() + 1e-9
        across = np.eye(3) - np.outer(pressing, pressing)
        touching = vertices[depth > depth.max() - 10 * SOFTNESS_M] @ across
        assert in_hull(point @ across, touching)
    # The shapes themselves, where MuJoCo puts them, by the definition.
    shapes = pad_shapes(problem.representation, sides)
    for body, side, vertices_link, point in zip(shapes.body, shapes.side, shapes.vertices_link, points, strict=True):
        vertices, pressing = body_points(data, body, vertices_link), axis if side == 0 else -axis
        depth = vertices @ pressing
        weight = np.exp((depth - depth.max()) / SOFTNESS_M)
        expected = weight @ vertices / weight.sum()
        expected += (depth.max() - expected @ pressing) * pressing
        np.testing.assert_allclose(point, expected, atol=2e-4)  # compiled code leaves the tail of the weights out


def pad_vertices(embodiment: Embodiment, pad: Pad) -> np.ndarray:
    """(V, 3) corners of the part of a link's mesh that is pad: its vertices there, and where its edges leave that part."""
    mesh = pad_mesh(embodiment, pad)
    vertices = np.asarray(mesh.vertices)
    along = vertices @ np.linalg.eigh(np.cov(vertices.T))[1][:, -1]
    along = along if along.max() > -along.min() else -along
    share = (along - along.min()) / np.ptp(along)
    corners = [vertices[(share >= pad.extent[0]) & (share <= pad.extent[1])]]
    ends = np.asarray(mesh.edges_unique)
    for cut in pad.extent:
        one, two = share[ends].T
        crossed = ends[(one - cut) * (two - cut) < 0]
        weight = (cut - share[crossed[:, :1]]) / (share[crossed[:, 1:]] - share[crossed[:, :1]])
        corners.append(vertices[crossed[:, 0]] + weight * (vertices[crossed[:, 1]] - vertices[crossed[:, 0]]))
    return np.concatenate(corners)


def in_hull(point: np.ndarray, vertices: np.ndarray, slack: float = 1e-6) -> bool:
    """Whether a point is a convex combination of vertices, by linear programming."""
    A = np.concatenate([vertices.T, np.ones((1, len(vertices)))])
    b = np.append(point, 1.0)
    n = len(vertices)
    # Minimise the worst coordinate's error t.
    bound = np.concatenate([np.hstack([A, -np.ones((4, 1))]), np.hstack([-A, -np.ones((4, 1))])])
    result = linprog(np.append(np.zeros(n), 1.0), bound, np.concatenate([b, -b]), bounds=[(0, None)] * (n + 1))
    return bool(result.status == 0 and result.fun < slack)


# -- refinement ----------------------------------------------------------------------------------------------


@cache
def followed(name: str) -> tuple[Motion, Track]:
    """The source's motion from the first frame that leads to the best followed trajectory, and that trajectory."""
    problem, motion = problem_of(name), source_motion()
    points, normals = motion.points_base, motion.normals_base
    starts = find_basins(problem, OPTIONS, points[0], normals[0], InitialisationOptions(starts=48, basins=8))
    follower = Follower(problem, OPTIONS, CONTACT)
    motions = [replace(motion, u0=u0) for u0 in starts]
    tracks = follower.follow_all(motions, refine=False)
    best = int(np.argmin([track.objective.mean() for track in tracks]))
    return motions[best], tracks[best]


@cache
def refined(name: str, **changes) -> Track:
    motion, _ = followed(name)
    return Follower(problem_of(name), OPTIONS, replace(CONTACT, **changes)).follow(motion)


def miss_m(name: str, u: np.ndarray, frame: int, meshes: bool = True) -> float:
    """How far the sides' mean contact points are from the source's, on pads placed by MuJoCo; sides as suits them.

    Pads are all their corners, or only the outermost ones, which are what the code under test looks at.
    """
    problem, grip = problem_of(name), source_motion().grip
    embodiment, axis = problem.embodiment, grip.axis[frame]
    data = mujoco_data(embodiment, embodiment.coupled.expand(u[frame]))
    source = load_embodiment(SOURCE)
    faces = face_centres(mujoco_data(source, source_qpos()[frame]), source.model)
    faces = faces[np.argsort(faces @ axis)]  # the first presses along the axis
    sides = opposing_sides(problem.representation, problem.tree)
    misses = []
    for first in (0, 1):
        ends: list[list[np.ndarray]] = [[], []]
        for pad in embodiment.end_effector.pads:
            body = embodiment.body_id(pad.body)
            which = 0 if sides[problem.representation.body == body][0] == first else 1
            surface = pad_vertices(embodiment, pad)
            vertices = body_points(data, body, surface if meshes else outermost(surface))
            pressing = axis if which == 0 else -axis
            depth = vertices @ pressing
            weight = np.exp((depth - depth.max()) / SOFTNESS_M)
            touch = weight @ vertices / weight.sum()
            ends[which].append(touch + (depth.max() - touch @ pressing) * pressing)
        misses.append(max(np.linalg.norm(np.mean(e, axis=0) - f) for e, f in zip(ends, faces, strict=True)))
    return min(misses)


def palm_in_source(name: str, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(T, 3, 3), (T, 3): pose of the target's palm in the source's end-effector, by MuJoCo."""
    target, source = load_embodiment(name), load_embodiment(SOURCE)
    rotations, positions = [], []
    for q, q_source in zip(target.coupled.expand(u), source_qpos(), strict=True):
        palm, hand = mujoco_data(target, q), mujoco_data(source, q_source)
        a, b = root_of(target), root_of(source)
        R = hand.xmat[b].reshape(3, 3).T
        rotations.append(R @ palm.xmat[a].reshape(3, 3))
        positions.append(R @ (palm.xpos[a] - hand.xpos[b]))
    return np.array(rotations), np.array(positions)


@pytest.mark.parametrize("name", TARGETS)
def test_contact_points_come_to_be_the_sources(name: str) -> None:
    (_, free), track = followed(name), refined(name)
    before, after = ([miss_m(name, u, t) for t in range(CLOSED, HELD + 1)] for u in (free.u, track.u))
    assert np.mean(before) > 0.004
    assert np.mean(after) < 0.4 * np.mean(before)
    assert after[-1] < min(0.01, 0.5 * before[-1])
    # What it says of itself is what they miss, and while it holds, what they missed when it took hold.
    assert track.contact_miss_m[HELD] == pytest.approx(miss_m(name, track.u, HELD, meshes=False), abs=3e-4)
    assert (track.contact_miss_m[HELD:] == track.contact_miss_m[HELD]).all()
    # Contact is not bought by leaving the source's pads behind.
    assert track.objective.mean() < free.objective.mean() + 0.03


@pytest.mark.parametrize("name", TARGETS)
def test_while_something_is_held_hand_and_object_move_as_one(name: str) -> None:
    (_, free), track = followed(name), refined(name)
    hand = problem_of(name).embodiment.coupled.independent >= problem_of(name).embodiment.n_arm
    R, t = palm_in_source(name, track.u)
    R, t = R[HELD:], t[HELD:]
    assert angle_deg(R, R[0]).max() < 1
    assert np.linalg.norm(t - t[0], axis=1).max() < 2e-3
    assert np.ptp(track.u[HELD:, hand], axis=0).max() < 0.01
    # Which it does not by itself.
    R, t = palm_in_source(name, free.u)
    assert angle_deg(R[HELD:], R[HELD]).max() > 3
    assert np.linalg.norm(t[HELD:] - t[HELD], axis=1).max() > 5e-3


@pytest.mark.parametrize("name", TARGETS)
def test_the_palm_arrives_turned_as_it_grasps(name: str) -> None:
    free = followed(name)[1]
    away = slice(REACHED // 2, HELD)

    def turn(track: Track) -> float:
        R, _ = palm_in_source(name, track.u)
        return float(angle_deg(R[away], R[HELD]).max())

    assert turn(refined(name, turning_weight=100.0)) < 4
    assert turn(refined(name)) < 0.5 * turn(free)
    assert turn(refined(name, turning_weight=0.01)) > turn(refined(name))


@pytest.mark.parametrize("name", TARGETS)
def test_a_refined_trajectory_keeps_limits_and_speeds(name: str) -> None:
    embodiment, track = problem_of(name).embodiment, refined(name)
    qpos = embodiment.coupled.expand(track.u)
    assert (qpos >= embodiment.lower - 1e-9).all()
    assert (qpos <= embodiment.upper + 1e-9).all()
    assert (np.abs(np.diff(qpos, axis=0)) <= embodiment.max_velocity * DT_S + 1e-9).all()
    # Where it has less time, it uses what there is.
    motion, free = followed(name)
    slow = GraspRefiner(problem_of(name), replace(OPTIONS, velocity_scale=0.2), CONTACT).refine(motion, free)
    step = np.abs(np.diff(embodiment.coupled.expand(slow.u), axis=0)) / (embodiment.max_velocity * DT_S)
    assert step.max() <= 0.2 + 1e-9
    assert step.max() > 0.199
    assert (np.abs(np.diff(qpos, axis=0)) > 0.2 * embodiment.max_velocity * DT_S).any()


@pytest.mark.parametrize("name", TARGETS)
def test_without_weight_a_trajectory_is_what_was_followed(name: str) -> None:
    motion, free = followed(name)
    off = refined(name, opposition_weight=0.0)
    np.testing.assert_array_equal(off.u, free.u)
    np.testing.assert_array_equal(off.objective, free.objective)
    assert off.contact_miss_m is None
    blind = Follower(problem_of(name), OPTIONS, CONTACT).follow(replace(motion, grip=None))
    np.testing.assert_array_equal(blind.u, free.u)


@pytest.mark.parametrize("name", TARGETS)
def test_which_pads_are_first_makes_no_difference(name: str) -> None:
    """Sides have no names: a target whose side 0 does what the source's side 1 does is turned around."""
    motion, free = followed(name)
    grip = motion.grip
    other = replace(grip, axis=-grip.axis, contacts=grip.contacts[:, ::-1].copy())
    follower = Follower(problem_of(name), OPTIONS, CONTACT)
    again = follower.follow(replace(motion, grip=other))
    np.testing.assert_allclose(again.u, refined(name).u, atol=1e-3)
    assert np.abs(again.u - free.u).max() > 0.02


def test_a_motion_without_a_hold_keeps_the_palm_as_it_was_followed() -> None:
    name = TARGETS[1]
    motion, free = followed(name)
    frames = np.arange(REACHED)
    open_hand = replace(motion.at(frames), grip=replace(motion.grip.at(frames), held=np.zeros(REACHED, bool)))
    part = replace(free, u=free.u[:REACHED], objective=free.objective[:REACHED])
    track = GraspRefiner(problem_of(name), OPTIONS, replace(CONTACT, turning_weight=100.0)).refine(open_hand, part)
    pad = [np.zeros((FRAMES - REACHED, free.u.shape[1]))]
    R, _ = palm_in_source(name, np.concatenate([track.u, *pad]))
    R_free, _ = palm_in_source(name, np.concatenate([part.u, *pad]))
    assert angle_deg(R[:REACHED], R_free[:REACHED]).max() < 1
    assert miss_m(name, track.u, REACHED - 1) < miss_m(name, part.u, REACHED - 1)


def hull_depth(embodiment: Embodiment, shapes, u: np.ndarray, points: np.ndarray, skip: set[int]) -> float:
    """How deep points are in the hull of any link but some, m: by the hull's planes, links placed by MuJoCo."""
    deepest = 0.0
    data = mujoco_data(embodiment, embodiment.coupled.expand(u))
    for body, hull in shapes:
        if body not in skip:
            local = (points - data.xpos[body]) @ data.xmat[body].reshape(3, 3)
            outside = local @ hull.equations[:, :3].T + hull.equations[:, 3]
            deepest = max(deepest, float(-outside.max(axis=1).min()))
    return deepest


@pytest.mark.parametrize("name", TARGETS)
def test_links_get_out_of_what_stands_in_their_way(name: str) -> None:
    problem, (motion, free) = problem_of(name), followed(name)
    embodiment = problem.embodiment
    without = replace(OPTIONS, clearance=ClearanceOptions(weight=0.0))
    alone = GraspRefiner(problem, without, CONTACT).refine(motion, free)
    links = link_shapes(embodiment)
    hulls = [(int(b), ConvexHull(v)) for b, v in zip(links.body, links.vertices_link, strict=True)]
    pads = {embodiment.body_id(pad.body) for pad in embodiment.end_effector.pads}
    # A few points a centimetre inside the palm, where it ends up when it grasps.
    palm = max((x for x in hulls if embodiment.body_names[x[0]].startswith("ee/") and x[0] not in pads), key=volume)
    data = mujoco_data(embodiment, embodiment.coupled.expand(alone.u[HELD]))
    middle = palm[1].points.mean(axis=0)
    corner = palm[1].points[np.argmax(body_points(data, palm[0], palm[1].points)[:, 2])]
    inside = middle + 0.7 * (corner - middle) + np.random.default_rng(0).normal(0, 1e-3, (5, 3))
    post = body_points(data, palm[0], inside)
    motion = replace(motion, surroundings=Surroundings(-0.5, [post] * FRAMES))
    blind = GraspRefiner(problem, without, CONTACT).refine(motion, free)
    np.testing.assert_array_equal(blind.u, alone.u)
    refiner = GraspRefiner(problem, OPTIONS, CONTACT)
    aware = refiner.refine(motion, free)
    depths = [[hull_depth(embodiment, hulls, u, post, pads) for u in track.u] for track in (blind, aware)]
    assert depths[0][HELD] > 0.004
    assert max(depths[1]) < 0.5 * max(depths[0])
    assert miss_m(name, aware.u, HELD) < 0.01
    # The compiled judge: shapes somewhat larger than hulls, never smaller.
    for track, expected in zip((blind, aware), depths, strict=True):
        found = refiner.overlap(motion, track.u)[0]
        assert (found > np.array(expected) - 1e-6).all()
        assert (found < np.array(expected) + 0.015).all()  # at corners, which their directions cut off late


def volume(shape: tuple[int, ConvexHull]) -> float:
    return float(shape[1].volume)


def test_pads_may_be_in_what_is_gripped_and_nowhere_else() -> None:
    name = TARGETS[1]
    problem, (motion, _), track = problem_of(name), followed(name), refined(name)
    embodiment = problem.embodiment
    refiner = GraspRefiner(problem, OPTIONS, CONTACT)
    middle = motion.grip.contacts[HELD].mean(axis=0)
    pad = embodiment.end_effector.pads[0]
    data = mujoco_data(embodiment, embodiment.coupled.expand(track.u[HELD]))
    inside = body_points(data, embodiment.body_id(pad.body), np.asarray(pad_mesh(embodiment, pad).vertices)).mean(
        axis=0
    )
    post = [inside[None]] * FRAMES
    radius = 1.5 * np.linalg.norm(inside - middle)
    found = {}
    for grip_radius in (radius, 1e-4):
        refiner = GraspRefiner(problem, OPTIONS, replace(CONTACT, grip_radius_m=float(grip_radius)))
        around = replace(motion, surroundings=Surroundings(-0.5, post))
        found[grip_radius] = refiner.overlap(around, track.u)[0][HELD]
    assert found[radius] == 0
    assert found[1e-4] > 0.001


@pytest.mark.parametrize("name", TARGETS)
def test_fingers_that_hold_do_not_give_way(name: str) -> None:
    """Something that is suddenly in a finger's way moves arm and object, if anything: opening would drop it."""
    problem, (motion, free), alone = problem_of(name), followed(name), refined(name)
    embodiment = problem.embodiment
    hand = np.flatnonzero(embodiment.coupled.independent >= embodiment.n_arm)
    pad = embodiment.end_effector.pads[-1]
    nothing, posts = np.zeros((0, 3)), []
    for t in range(FRAMES):
        data = mujoco_data(embodiment, embodiment.coupled.expand(alone.u[t]))
        surface = body_points(data, embodiment.body_id(pad.body), np.asarray(pad_mesh(embodiment, pad).vertices))
        posts.append(surface.mean(axis=0, keepdims=True) if t > HELD + 2 else nothing)
    around = replace(motion, surroundings=Surroundings(-0.5, posts))
    refiner = GraspRefiner(problem, OPTIONS, replace(CONTACT, grip_radius_m=1e-4))
    aware = refiner.refine(around, free)
    assert refiner.overlap(around, alone.u)[0][HELD + 3] > 0.003
    assert np.abs(aware.u - alone.u)[: HELD + 2].max() < 1e-9
    assert np.abs(aware.u - alone.u)[HELD + 3 :].max() > 1e-4
    assert np.ptp(aware.u[HELD:, hand], axis=0).max() < 0.02


@pytest.mark.parametrize("name", [*TARGETS, "IIWA-Inspire"])
@pytest.mark.parametrize("seed", range(3))
def test_the_energys_gradient_is_its_finite_difference(name: str, seed: int) -> None:
    """With a single vertex a pad, so that contact points stay on their links, and a palm that is nearly as wished."""
    problem = problem_of(name)
    # the pads as kernels take them
    target, grasp, _, _ = GraspRefiner(problem, OPTIONS, CONTACT).arrays
    rng, pads = np.random.default_rng(seed), len(grasp.joint)
    grasp = grasp._replace(vertices=grasp.vertices[grasp.start[:-1]].copy(), start=np.arange(pads + 1))
    u = random_joints(problem.embodiment, seed)
    memory, points = empty_memory(target, 1), np.empty((pads, 3))
    place_joints(target, u, memory.pose)
    palm = grasp.palm
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    contact.contact_points(grasp, memory.pose, axis, points)
    wishes = {
        "axis": axis,
        "contacts": points.mean(axis=0) + rng.normal(0, 0.02, (2, 3)),
        "rotation": np.ascontiguousarray(some_rotation(rng, 2e-3) @ memory.pose.rot[palm]),
        "point": rng.normal(0, 0.05, 3),
        "position": memory.pose.pos[palm] + rng.normal(0, 0.05, 3),
        "posture": np.zeros(len(u)),
    }
    weights = {name: rng.uniform(50, 300) for name in contact.GraspTarget._fields if name not in wishes}
    if "facing" in weights:
        weights["facing"] = 5.0
    wish = contact.GraspTarget(**wishes, **(weights | {"turning": 1e4}))
    nothing = np.zeros((0, 3))
    links = contact.Links(no_collision_constraint(), no_collision_constraint(), nothing, nothing)

    def energy(u: np.ndarray, derivatives: bool = False) -> float:
        return contact.grasp_energy(
            target, grasp, links, wish, u, u, memory.pose, points, memory.quadratic, derivatives
        )

    value = energy(u)
    assert energy(u, derivatives=True) == pytest.approx(value)
    project(target, np.zeros(3), memory.pose, memory.quadratic)
    gradient, hessian = memory.quadratic.gradient.copy(), memory.quadratic.hessian.copy()
    h = 1e-6
    numeric = np.array([(energy(u + h * e) - energy(u - h * e)) / (2 * h) for e in np.eye(len(u))])
    np.testing.assert_allclose(gradient, numeric, atol=5e-3 * np.abs(numeric).max())
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-9 * np.abs(hessian).max())
    assert np.linalg.eigvalsh(hessian).min() > -1e-9 * np.abs(hessian).max()


# -- transfer ------------------------------------------------------------------------------------------------


def test_a_transfer_sees_the_grip_in_the_targets_base_frame() -> None:
    rng, turn = np.random.default_rng(0), 0.7
    T_world_source, T_world_target = np.eye(4), np.eye(4)
    T_world_source[:2, :2] = [[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]]
    T_world_source[:3, 3], T_world_target[:3, 3] = rng.normal(size=3), rng.normal(size=3)
    grip, here = transferred_grip(demonstration(T_world_source), T_world_target), source_motion().grip
    T = np.linalg.inv(T_world_target) @ T_world_source
    np.testing.assert_allclose(grip.contacts, here.contacts @ T[:3, :3].T + T[:3, 3], atol=1e-9)
    np.testing.assert_allclose(grip.axis, here.axis @ T[:3, :3].T, atol=1e-9)
    np.testing.assert_allclose(grip.position, here.position @ T[:3, :3].T + T[:3, 3], atol=1e-9)


def demonstration(T_world_base: np.ndarray | None = None) -> Demonstration:
    """The source's motion, told to close all the way from when it starts to close."""
    qpos = source_qpos()
    action = np.concatenate([qpos[1:], qpos[-1:]])
    action[REACHED - 1 :, 7:] = 0
    scene = Scene(np.eye(4) if T_world_base is None else T_world_base, (), np.array([[-3.0, -3, -3], [3, 3, 3]]))
    return Demonstration(SOURCE, 1 / DT_S, qpos, action, scene)


def transferred_grip(demonstration: Demonstration, T_world_target: np.ndarray | None = None) -> Grip:
    bodies = load_embodiment(SOURCE), load_embodiment(TARGETS[1])
    transfer = Transfer(
        *bodies, TransferOptions(points=32), clouds=CloudOptions(robot_points=64), T_world_target=T_world_target
    )
    return transfer.motion(demonstration).grip


def test_something_is_held_while_a_gripper_at_rest_is_told_to_close_further() -> None:
    held = transferred_grip(demonstration()).held
    assert held[CLOSED:].all()
    assert not held[: REACHED - 1].any()
    assert not held[REACHED:CLOSED].any()  # it closes
    qpos = source_qpos()
    no_further = replace(demonstration(), action=np.concatenate([qpos[1:], qpos[-1:]]))
    assert not transferred_grip(no_further).held[REACHED:].any()


def test_an_open_gripper_that_is_just_told_to_close_holds_nothing() -> None:
    assert not transferred_grip(demonstration()).held[REACHED - 1]


# -- where an object is on the pads ------------------------------------------------------------------------------


def held_grip(held: list[bool], seed: int) -> tuple[Grip, np.ndarray]:
    """An upright parallel gripper, 40 mm open along its x, in some place each frame; and the vertices of its pads."""
    rng = np.random.default_rng(seed)
    rotation = Rotation.from_rotvec(rng.uniform(-np.pi, np.pi, (len(held), 1)) * [0, 0, 1]).as_matrix()
    position = rng.normal(size=(len(held), 3))
    pads = np.array([[x, y, z] for x in (-0.02, 0.02) for y in (-0.010, 0.010) for z in (-0.009, 0.009)])
    contacts = np.array([[-0.02, 0, 0], [0.02, 0, 0]])
    place = [points @ R.T + p for points in (pads, contacts) for R, p in zip(rotation, position, strict=True)]
    vertices, contacts = np.stack(place[: len(held)]), np.stack(place[len(held) :])
    return Grip(rotation[:, :, 0], contacts, position, rotation, np.array(held)), vertices


def bar(low: float, high: float, grip: Grip, frame: int) -> np.ndarray:
    """Points on the four sides of a bar along y in the gripper's frame, as wide as the gap, from `low` to `high` in z."""
    y = np.linspace(-0.06, 0.06, 25)
    across = [(x, z) for x in (-0.02, 0.02) for z in np.linspace(low, high, 9)]
    points = np.array([[x, v, z] for x, z in across for v in y])
    return points @ grip.rotation[frame].T + grip.position[frame]


def moved_in_gripper(before: Grip, after: Grip) -> np.ndarray:
    """(T, 3) how far the contacts moved, in the gripper's frame, m."""
    moved = after.contacts - before.contacts
    np.testing.assert_allclose(moved[:, 0], moved[:, 1], atol=1e-12)
    return np.einsum("tji,tj->ti", before.rotation, moved[:, 0])


@pytest.mark.parametrize("seed", range(5))
def test_contacts_go_where_a_thin_object_meets_the_edge_of_the_pads(seed: int) -> None:
    grip, pads = held_grip([False, False, True, True, False], seed)
    objects = [bar(-0.02, -0.004, grip, t) for t in range(5)]
    moved = moved_in_gripper(grip, onto_objects(grip, pads, objects, 0.03))
    np.testing.assert_allclose(moved, np.tile([0, 0, -0.0065], (5, 1)), atol=0.0015)  # [-9, -4] mm is touched


def test_contacts_stay_where_the_pads_touch_all_over_or_nothing() -> None:
    grip, pads = held_grip([False, True, True], 0)
    far = bar(0.05, 0.07, grip, 1)
    for points in (bar(-0.03, 0.03, grip, 1), far, far[:2], np.zeros((0, 3))):
        np.testing.assert_array_equal(onto_objects(grip, pads, [points] * 3, 0.03).contacts, grip.contacts)
    never = replace(grip, held=np.zeros(3, bool))
    assert onto_objects(never, pads, [far] * 3, 0.03) is never


def test_each_hold_has_its_own_place_on_the_pads() -> None:
    held = [False, True, True, False, False, True, False]
    grip, pads = held_grip(held, 1)
    objects = [bar(-0.02, -0.004 if t < 3 else 0.0, grip, t) for t in range(len(held))]
    z = moved_in_gripper(grip, onto_objects(grip, pads, objects, 0.03))[:, 2]
    np.testing.assert_allclose(z[:3], -0.0065, atol=0.0015)
    np.testing.assert_allclose(z[3:], -0.0045, atol=0.0015)  # from the end of the first hold on


def test_what_is_hidden_below_an_edge_is_taken_to_be_there() -> None:
    grip, pads = held_grip([True], 2)
    seen = bar(0.012, 0.014, grip, 0)  # the pads reach from -9 to 9 mm
    np.testing.assert_array_equal(onto_objects(grip, pads, [seen], 0.03).contacts, grip.contacts)


# -- squeeze -------------------------------------------------------------------------------------------------


def pad_centres_and_normals(problem: AlignmentProblem, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(P, 3) each."""
    points, normals = problem.place(u)
    bodies = [problem.embodiment.body_id(pad.body) for pad in problem.embodiment.end_effector.pads]
    own = [problem.representation.body == body for body in bodies]
    mean = np.array([normals[o].mean(axis=0) for o in own])
    return np.array([points[o].mean(axis=0) for o in own]), mean / np.linalg.norm(mean, axis=1, keepdims=True)


def half_closed(problem: AlignmentProblem) -> np.ndarray:
    embodiment = problem.embodiment
    return embodiment.coupled.reduce((embodiment.home + embodiment.closed) / 2)


@pytest.mark.parametrize("name", [f"{arm}-{hand}" for hand, arm in ARM_OF.items()])
def test_a_squeeze_moves_each_pad_along_its_normal_and_no_arm(name: str) -> None:
    """The oracle: of all ways to move the hand's joints, that whose pads come nearest to where they should be."""
    problem = problem_of(name)
    embodiment, u, depth = problem.embodiment, half_closed(problem), 2e-4
    spec = embodiment.end_effector
    hand = np.flatnonzero(embodiment.coupled.independent >= embodiment.n_arm)
    closed = squeeze(problem, u[None], np.array([depth]))[0]
    np.testing.assert_array_equal(np.delete(closed, hand), np.delete(u, hand))
    centres, normals = pad_centres_and_normals(problem, u)
    share = np.array([pad.share for pad in spec.pads])
    wanted = spec.compliance * depth * share / share.mean()
    assert wanted.mean() == pytest.approx(spec.compliance * depth)

    def moved(step: np.ndarray) -> np.ndarray:
        changed = u.copy()
        changed[hand] += step
        return pad_centres_and_normals(problem, changed)[0] - centres

    def short(step: np.ndarray) -> float:
        return 1e8 * float(np.square(moved(step) - wanted[:, None] * normals).sum())

    best = minimize(short, np.zeros(len(hand)), method="BFGS", options={"gtol": 1e-9}).x
    np.testing.assert_allclose(moved(closed[hand] - u[hand]), moved(best), atol=0.05 * depth)
    along = (moved(closed[hand] - u[hand]) * normals).sum(axis=1)
    assert (along > 0.3 * wanted).all()
    assert (along < 1.1 * wanted).all()


def test_both_fingers_of_a_gripper_close_by_the_depth() -> None:
    problem = problem_of(SOURCE)
    u = np.tile(half_closed(problem), (3, 1))
    closed = squeeze(problem, u, np.array([0.0, 0.003, 0.008]))
    embodiment = problem.embodiment
    faces = [face_centres(mujoco_data(embodiment, q), embodiment.model) for q in embodiment.coupled.expand(closed)]
    gaps = [np.linalg.norm(one - other) for one, other in faces]
    np.testing.assert_allclose(gaps[0] - np.array(gaps), [0, 0.006, 0.016], atol=1e-5)


@pytest.mark.parametrize("name", TARGETS)
def test_frames_without_depth_stay_bit_for_bit_and_limits_hold(name: str) -> None:
    problem = problem_of(name)
    embodiment = problem.embodiment
    u = np.array([random_joints(embodiment, seed) for seed in range(6)])
    np.testing.assert_array_equal(squeeze(problem, u, np.zeros(6)), u)
    depth = np.array([0.0, 0.01, 0.0, 0.3, 0.3, 0.3])
    closed = squeeze(problem, u, depth)
    np.testing.assert_array_equal(closed[depth == 0], u[depth == 0])
    assert (np.abs(closed - u).max(axis=1) > 0)[depth > 0].all()
    lower, upper = embodiment.independent_limits
    assert (closed >= lower).all()
    assert (closed <= upper).all()
    assert ((closed == lower) | (closed == upper))[depth == 0.3].any()


# -- pace ----------------------------------------------------------------------------------------------------


def panda_motion(share_of_fastest: float, frames: int = 8) -> Motion:
    """The Panda's pads while its first joint turns at a share of its largest speed, then stands still."""
    problem = problem_of(SOURCE)
    home = problem.embodiment.coupled.reduce(problem.embodiment.home)
    step = share_of_fastest * problem.embodiment.independent_max_velocity[0] * DT_S
    u = np.tile(home, (frames + 4, 1))
    u[:, 0] += step * np.minimum(np.arange(frames + 4), frames)
    return Motion(*problem.place(u), home, dt_s=DT_S)


def paced(motion: Motion, stretch: float, options: SolverOptions = OPTIONS) -> np.ndarray:
    problem = problem_of(SOURCE)
    return retime(problem, make_solver(problem, options), options, motion, stretch)[0]


def test_a_motion_that_can_be_kept_up_with_keeps_its_frames() -> None:
    motion, problem = panda_motion(1.3), problem_of(SOURCE)  # redundant: other joints do a part of it
    u = make_solver(problem, OPTIONS).track(motion.points_base, motion.normals_base, motion.u0, dt_s=DT_S).u
    fastest = (np.abs(np.diff(u, axis=0)) / (problem.embodiment.independent_max_velocity * DT_S)).max()
    assert 0.6 < fastest < 0.95
    np.testing.assert_array_equal(paced(motion, 3.0), np.arange(12))


@pytest.mark.parametrize("stretch", [1.2, 1.5, 2.0, 4.0])
def test_a_motion_that_is_too_fast_gets_more_frames(stretch: float) -> None:
    motion = panda_motion(3.0)
    frames = paced(motion, stretch)
    assert 12 < len(frames) <= stretch * 12
    np.testing.assert_array_equal(np.unique(frames), np.arange(12))  # each at least once
    assert (np.diff(frames) >= 0).all()
    problem = problem_of(SOURCE)
    solver = make_solver(problem, OPTIONS)

    def late_m(frames: np.ndarray) -> float:
        """How far pads still are from the source's when it goes on, in the worst frame."""
        m = motion.at(frames)
        u = solver.track(m.points_base, m.normals_base, m.u0, dt_s=DT_S).u
        apart = np.linalg.norm(problem.place(u)[0] - m.points_base, axis=-1).mean(axis=1)
        return float(apart[np.flatnonzero(np.diff(frames, append=-1))].max())

    hurried = late_m(np.arange(12))
    assert hurried > 0.05
    assert late_m(frames) < (0.9 if stretch < 3 else 0.02) * hurried  # 3 times as long is room enough


def test_nobody_waits_where_time_is_not_limited() -> None:
    motion = panda_motion(2.0)
    everyone = np.arange(12)
    np.testing.assert_array_equal(paced(motion, 1.0), everyone)
    np.testing.assert_array_equal(paced(replace(motion, dt_s=None), 2.0), everyone)
    np.testing.assert_array_equal(paced(motion, 2.0, replace(OPTIONS, velocity_scale=0.0)), everyone)


# -- what the hand hides -------------------------------------------------------------------------------------


def frames_of(*scenes: list[list[float]]) -> list[np.ndarray]:
    return [np.array(s, float).reshape(-1, 3) for s in scenes]


def test_what_vanishes_near_the_hand_is_remembered_and_what_vanishes_far_away_is_not() -> None:
    near, far = [0.05, 0.0, 0.0], [0.3, 0.0, 0.0]
    scenes = frames_of([near, far], [], [])
    kept = remember(scenes, np.zeros((3, 3)), np.zeros(3, bool), 0.1)
    assert [x.tolist() for x in kept] == [[near]] * 3
    wide = remember(scenes, np.zeros((3, 3)), np.zeros(3, bool), 0.5)
    assert sorted(wide[2].tolist()) == [near, far]


def test_what_the_hand_leaves_behind_or_moves_is_forgotten() -> None:
    near, other = [0.05, 0.0, 0.0], [0.0, 0.05, 0.0]
    scenes = frames_of([near], [other], [], [])
    centre = np.zeros((4, 3))
    moved = np.array([False, False, True, False])
    kept = remember(scenes, centre, moved, 0.1)
    assert [len(x) for x in kept] == [1, 2, 0, 0]
    # What is seen counts all the same.
    kept = remember(frames_of([near], [other]), np.zeros((2, 3)), np.array([False, True]), 0.1)
    assert [x.tolist() for x in kept] == [[near], [other]]
    centre[1:] += 1.0  # goes away, and comes back
    centre[3] = 0.0
    assert [len(x) for x in remember(scenes, centre, np.zeros(4, bool), 0.1)] == [1, 0, 0, 0]


def test_a_point_that_is_seen_again_is_not_doubled() -> None:
    point = np.array([0.05, 0.0, 0.0])
    shaken = [point + [0, 0, 0.004 * (t % 2)] for t in range(6)]  # noise of a depth camera
    kept = remember([p[None] for p in shaken], np.zeros((6, 3)), np.zeros(6, bool), 0.1)
    for seen, points in zip(shaken, kept, strict=True):
        np.testing.assert_array_equal(points, seen[None])


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, frames=st.integers(1, 4), n=st.integers(0, 120))
def test_what_is_remembered_is_thin_near_and_complete(seed: int, frames: int, n: int) -> None:
    rng = np.random.default_rng(seed)
    scenes = [rng.uniform(-0.06, 0.06, (n, 3)) for _ in range(frames)]
    radius = 0.05
    kept = remember(scenes, np.zeros((frames, 3)), np.zeros(frames, bool), radius)
    everything = np.concatenate(scenes)
    for t, points in enumerate(kept):
        now = scenes[t][np.linalg.norm(scenes[t], axis=1) < radius]
        assert (np.linalg.norm(points, axis=1) < radius).all()
        # Nothing is made up, nothing near is lost, little is kept of each place.
        assert {tuple(p) for p in points} <= {tuple(p) for p in everything}
        seen = {tuple(v) for v in np.floor(now / 0.008).astype(int)}
        voxels = [tuple(v) for v in np.floor(points / 0.008).astype(int)]
        assert seen <= set(voxels)
        if t == 0:
            assert len(voxels) == len(set(voxels)) == len(seen)
        for frame, past in enumerate(kept[:t]):
            apart = np.linalg.norm(past[:, None] - points[None], axis=-1)
            # each frame may put another point in a point's place, up to 12 mm away
            assert not len(past) or (apart.min(axis=1) <= 0.012 * (t - frame)).all()


# -- distances of links to points ----------------------------------------------------------------------------


@settings(max_examples=40, deadline=None)
@given(seed=SEEDS, cutoff=st.sampled_from([0.0, 0.005, 0.05, 0.5]))
def test_the_nearest_point_is_that_of_a_search_through_all(seed: int, cutoff: float) -> None:
    problem = problem_of("UR5e-FourierLeft")
    target, links, balls = fourier_links()
    rng = np.random.default_rng(seed)
    u = random_joints(problem.embodiment, seed)
    pose = empty_pose(target, 1)
    place_joints(target, u, pose)
    link = int(rng.integers(len(links.joint)))
    k = links.joint[link]
    R, t = pose.rot[k], pose.pos[k]
    vertices = links.vertices[links.start[link] : links.start[link + 1]]
    centre, radius = balls[link]
    middle = R @ centre + t
    spread = rng.choice([0.5, 1.0, 3.0]) * radius
    obstacles = middle + rng.normal(0, spread, (int(rng.integers(0, 60)), 3))
    point, normal = np.full(3, np.nan), np.full(3, np.nan)
    found = collision.nearest(links, link, obstacles, pose, k, cutoff, point, normal)
    # All points, all directions; a link is what its directions bound, inside its ball.
    directions = links.directions @ R.T
    reach = (vertices @ links.directions.T).max(axis=0) + directions @ t
    outside = obstacles @ directions.T - reach
    far = np.linalg.norm(obstacles - middle, axis=1) > radius + cutoff
    distance = np.where(far, np.inf, outside.max(axis=1, initial=-np.inf))
    least = distance.min(initial=np.inf)
    assert found == pytest.approx(min(cutoff, least), abs=1e-9)
    if least < cutoff - 1e-9:
        which = int(distance.argmin())
        np.testing.assert_array_equal(point, obstacles[which])
        assert np.linalg.norm(normal) == pytest.approx(1, abs=1e-6)
        # The way out: the link's face with the least to go, outwards for the link.
        face = -normal
        assert obstacles[which] @ face - (vertices @ R.T + t).dot(face).max() == pytest.approx(found, abs=1e-9)
    # What was not looked at is farther than the cutoff from the link itself.
    for p in obstacles[far][:5]:
        assert np.linalg.norm(vertices @ R.T + t - p, axis=1).min() > cutoff


@cache
def fourier_links():
    problem = problem_of("UR5e-FourierLeft")
    links = collision_constraint(problem, ClearanceOptions())
    balls = []
    for i in range(len(links.joint)):
        vertices = links.vertices[links.start[i] : links.start[i + 1]]
        centre = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        balls.append((centre, np.linalg.norm(vertices - centre, axis=1).max()))
    return make_target(problem.representation, problem.tree, all_joints=True), links, balls
