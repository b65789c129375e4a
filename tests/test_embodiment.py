"""Embodiments against MuJoCo, pytorch-kinematics, the robosuite simulation, and third-party URDFs."""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from cei_envs.mounted import MountedSimulation as Simulation
from cei_gym.embodiment import (
    ARMS,
    END_EFFECTORS,
    GRID,
    ArmSpec,
    Coupling,
    Embodiment,
    EndEffectorSpec,
    Pad,
    arm_names,
    build_embodiment,
    end_effector_names,
    load_arm,
    load_embodiment,
    load_end_effector,
    load_spec,
)
from cei_gym.embodiment.building import DEFAULT_MAX_VELOCITY_M_S, DEFAULT_MAX_VELOCITY_RAD_S
from cei_gym.embodiment.meshes import link_mesh, visual_link_meshes
from cei_gym.embodiment.names import END_EFFECTOR_PREFIX
from cei_gym.errors import CEIError
from cei_gym.kinematics import KinematicTree
from cei_gym.kinematics.torch_chain import TorchChain

ROBOTS = Path(__file__).parents[2] / "shared/robots"
AG95 = ROBOTS / "dh_robotics_ag95_description/urdf/dh_robotics_ag95.urdf"
XHAND = ROBOTS / "xhand_right/xhand_right.urdf"
needs_robots = pytest.mark.skipif(not ROBOTS.is_dir(), reason=f"third-party descriptions are not at {ROBOTS}")

# Each arm and each end-effector at least once.
PAIRS = [
    "Panda-PandaGripper",
    "IIWA-Inspire",
    "UR5e-RobotiqThreeFinger",
    "Kinova3-FourierRight",
    "Panda-FourierLeft",
]

ARM_URDF = """<robot name="arm">
  <link name="base"/>
  <link name="link">
    <inertial><mass value="1"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry>{geometry}</geometry></collision>
  </link>
  <joint name="turn" type="revolute">
    <parent link="base"/><child link="link"/><axis xyz="0 0 1"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/>
  </joint>
</robot>"""
FINGERS = """<mujoco><compiler angle="radian"/><worldbody><body name="palm"><geom size="0.1"/>
  <body name="a"><joint name="a" range="-1 1"/><geom size="0.1"/></body>
  <body name="b"><joint name="b" range="-9 9"/><geom size="0.1"/></body>
  <body name="c"><joint name="c" range="-9 9"/><geom size="0.1"/></body>
  <body name="d"><joint name="d" type="slide" range="0 1"/><geom size="0.1"/></body>
</body></worldbody></mujoco>"""
FREE_BODY = '<mujoco><worldbody><body name="b"><freejoint/><geom size="1"/></body></worldbody></mujoco>'
BOX = '<box size="0.1 0.1 0.1"/>'


def one_line(error: pytest.ExceptionInfo[CEIError]) -> str:
    message = str(error.value)
    assert "\n" not in message
    return message


def random_qpos(embodiment: Embodiment, n: int, seed: int = 0) -> np.ndarray:
    """Any joint positions, within limits but with no regard to couplings."""
    rng = np.random.default_rng(seed)
    return rng.uniform(embodiment.lower, embodiment.upper, (n, len(embodiment.joint_names)))


def mujoco_poses(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    data = mujoco.MjData(model)
    T = np.tile(np.eye(4), (len(qpos), model.nbody, 1, 1))
    for t, q in enumerate(qpos):
        data.qpos[:] = q
        mujoco.mj_kinematics(model, data)
        T[t, :, :3, :3] = data.xmat.reshape(-1, 3, 3)
        T[t, :, :3, 3] = data.xpos
    return T


def write_arm(path: Path, geometry: str = BOX) -> ArmSpec:
    path.write_text(ARM_URDF.format(geometry=geometry))
    return ArmSpec("Arm", str(path), "link", {})


# -- kinematics ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", GRID)
def test_link_poses_agree_with_mujoco_and_pytorch_kinematics(name: str) -> None:
    embodiment = load_embodiment(name)
    qpos = random_qpos(embodiment, 4)
    expected = mujoco_poses(embodiment.model, qpos)
    np.testing.assert_allclose(KinematicTree(embodiment).forward(qpos), expected, atol=1e-9)
    chain = TorchChain(embodiment).forward(torch.tensor(qpos))
    np.testing.assert_allclose(chain.numpy(), expected, atol=1e-9)


def test_torch_chain_gives_the_links_asked_for_and_their_gradient() -> None:
    embodiment = load_embodiment("UR5e-RobotiqThreeFinger")
    qpos = random_qpos(embodiment, 1)
    bodies = [embodiment.body_id(pad.body) for pad in embodiment.end_effector.pads]
    point = np.array([0.01, 0.02, 0.03])
    angles = torch.tensor(qpos, requires_grad=True)
    T = TorchChain(embodiment).forward(angles, bodies)
    assert T.shape == (1, len(bodies), 4, 4)
    for i, body in enumerate(bodies):
        moved = T[0, i, :3, :3] @ torch.tensor(point) + T[0, i, :3, 3]
        J = np.array([torch.autograd.grad(x, angles, retain_graph=True)[0][0].numpy() for x in moved])
        np.testing.assert_allclose(J, KinematicTree(embodiment).jacobian(qpos[0], body, point)[:3], atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(pair=st.sampled_from(PAIRS), seed=st.integers(0, 2**31), link=st.integers(0, 2**31))
def test_jacobian_is_the_derivative_of_the_pose(pair: str, seed: int, link: int) -> None:
    embodiment = load_embodiment(pair)
    tree = KinematicTree(embodiment)
    body = link % embodiment.model.nbody
    rng = np.random.default_rng(seed)
    point, qpos, h = rng.uniform(-0.1, 0.1, 3), random_qpos(embodiment, 1, seed)[0], 1e-6
    J = tree.jacobian(qpos, body, point)
    steps = h * np.eye(len(qpos))
    ahead, behind = tree.forward(qpos + steps)[:, body], tree.forward(qpos - steps)[:, body]
    linear = ((ahead - behind) @ np.append(point, 1.0) / (2 * h))[:, :3]
    np.testing.assert_allclose(J[:3], linear.T, atol=1e-7)
    spin = (ahead - behind)[:, :3, :3] / (2 * h) @ tree.forward(qpos)[body, :3, :3].T
    np.testing.assert_allclose(J[3:], np.stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]]), atol=1e-7)


def test_kinematics_are_batched_over_any_leading_shape() -> None:
    embodiment = load_embodiment("IIWA-Inspire")
    tree, qpos = KinematicTree(embodiment), random_qpos(load_embodiment("IIWA-Inspire"), 6)
    grid = qpos.reshape(2, 3, -1)
    one_by_one = np.stack([tree.forward(q) for q in qpos])
    np.testing.assert_array_equal(tree.forward(grid).reshape(one_by_one.shape), one_by_one)
    assert tree.jacobian(grid, 5, np.zeros(3)).shape == (2, 3, 6, len(embodiment.joint_names))
    with pytest.raises(ValueError, match="19 joints"):
        tree.forward(qpos[:, :7])


# -- couplings -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", PAIRS)
def test_couplings(name: str) -> None:
    embodiment = load_embodiment(name)
    coupled = embodiment.coupled
    lower, upper = embodiment.independent_limits
    assert (lower < upper).all()
    u = np.random.default_rng(0).uniform(lower, upper, (20, len(lower)))
    qpos = coupled.expand(u)
    np.testing.assert_array_equal(coupled.reduce(qpos), u)
    np.testing.assert_allclose(qpos, u @ coupled.A.T + coupled.offset, atol=1e-15)
    np.testing.assert_array_equal(coupled.A[coupled.independent], np.eye(len(lower)))
    for pose in (embodiment.home, embodiment.closed):
        np.testing.assert_array_equal(coupled.expand(coupled.reduce(pose)), pose)


@pytest.mark.parametrize("name", PAIRS)
def test_no_joint_leaves_its_limits_when_the_independent_ones_are_at_theirs(name: str) -> None:
    embodiment, model = load_embodiment(name), load_embodiment(name).model
    lower, upper = embodiment.independent_limits
    corners = np.concatenate([[lower, upper], np.where(np.eye(len(lower), dtype=bool), upper, lower)])
    qpos = embodiment.coupled.expand(corners)
    assert (qpos >= embodiment.lower - 1e-12).all()
    assert (qpos <= embodiment.upper + 1e-12).all()
    free = {joint for joint, c in embodiment.end_effector.couplings.items() if c.ignore_limits}
    bound = np.array([n not in free for n in embodiment.joint_names]) & model.jnt_limited.astype(bool)
    assert (qpos >= model.jnt_range[:, 0] - 1e-12)[:, bound].all()
    assert (qpos <= model.jnt_range[:, 1] + 1e-12)[:, bound].all()


@pytest.mark.parametrize("name", ["Panda-PandaGripper", "IIWA-Inspire", "Kinova3-FourierRight"])
def test_a_finger_at_its_bound_has_used_up_the_range_of_one_of_its_joints(name: str) -> None:
    embodiment = load_embodiment(name)
    coupled, (_, upper) = embodiment.coupled, embodiment.independent_limits
    qpos = coupled.expand(upper)
    at_limit = np.isclose(qpos, embodiment.upper) | np.isclose(qpos, embodiment.lower)
    for u in range(len(upper)):
        assert at_limit[coupled.leader == u].any()


def test_the_robotiq_scissor_couples_about_its_references() -> None:
    embodiment = load_embodiment("UR5e-RobotiqThreeFinger")
    model, coupled = embodiment.model, embodiment.coupled
    first, second = (embodiment.joint_names.index(f"palm_finger_{i}_joint") for i in (1, 2))
    np.testing.assert_allclose(model.qpos0[[first, second]], [0.29, -0.29])
    assert coupled.leader[first] == coupled.leader[second]
    # MuJoCo's own residual of the description's joint equality vanishes on what we call coupled.
    data = mujoco.MjData(model)
    equality = int(np.flatnonzero(model.eq_type == mujoco.mjtEq.mjEQ_JOINT)[0])
    lower, upper = embodiment.independent_limits
    for u in np.random.default_rng(1).uniform(lower, upper, (4, len(lower))):
        data.qpos[:] = coupled.expand(u)
        mujoco.mj_fwdPosition(model, data)
        residual = data.efc_pos[data.efc_id == equality][0]
        assert abs(residual) < 1e-12
        assert np.ptp(data.qpos[[first, second]]) > 1e-3


def test_a_chain_of_followers_follows_its_end(tmp_path: Path) -> None:
    spec = replace(
        load_end_effector("Inspire"),
        couplings={
            "joint_r_thumb_distal": Coupling("joint_r_thumb_middle", 0.5, 0.1),
            "joint_r_thumb_middle": Coupling("joint_r_thumb_proximal_2", 0.8, 0.05),
        },
    )
    hand = build_embodiment(None, spec)
    q = {n: i for i, n in enumerate(hand.joint_names)}
    u = np.zeros(len(hand.coupled.independent))
    u[hand.coupled.leader[q["joint_r_thumb_proximal_2"]]] = 0.4
    qpos = hand.coupled.expand(u)
    assert qpos[q["joint_r_thumb_middle"]] == pytest.approx(0.8 * 0.4 + 0.05)
    assert qpos[q["joint_r_thumb_distal"]] == pytest.approx(0.5 * (0.8 * 0.4 + 0.05) + 0.1)


# -- velocity limits -----------------------------------------------------------------------------------------

# Manufacturers' data sheets, deg/s.
DATA_SHEETS = {
    "UR5e": [180] * 6,
    "IIWA": [85, 85, 100, 75, 130, 135, 135],
    "Kinova3": [80] * 4 + [70] * 3,
    "Panda": [124.6] * 4 + [149.5] * 3,
}


@pytest.mark.parametrize("arm", ARMS)
def test_arms_are_as_fast_as_their_data_sheets_say(arm: str) -> None:
    embodiment = load_embodiment(f"{arm}-PandaGripper")
    speeds = np.degrees(embodiment.max_velocity[: embodiment.n_arm])
    np.testing.assert_allclose(speeds, DATA_SHEETS[arm], rtol=1e-3)
    np.testing.assert_array_equal(embodiment.max_velocity[embodiment.n_arm :], DEFAULT_MAX_VELOCITY_M_S)


@settings(max_examples=40, deadline=None)
@given(
    speeds=st.lists(st.floats(0.01, 10), min_size=3, max_size=3),
    scales=st.lists(st.sampled_from([-3.0, -0.5, 0.0, 0.25, 1.0, 2.0]), min_size=2, max_size=2),
    ignored=st.lists(st.booleans(), min_size=2, max_size=2),
)
def test_at_the_largest_speed_the_slowest_joint_is_at_its_own(
    tmp_path_factory: pytest.TempPathFactory, speeds: list[float], scales: list[float], ignored: list[bool]
) -> None:
    path = tmp_path_factory.mktemp("hand") / "hand.xml"
    path.write_text(FINGERS)
    couplings = {
        "b": Coupling("a", scales[0], ignore_limits=ignored[0]),
        "c": Coupling("b", scales[1], ignore_limits=ignored[1]),  # a chain: c follows a by the product
    }
    limits = dict(zip("abc", speeds, strict=True))
    hand = build_embodiment(None, EndEffectorSpec("Hand", str(path), pads=[], couplings=couplings, max_velocity=limits))
    fastest = hand.independent_max_velocity
    assert fastest.shape == (2,)
    assert fastest[1] == DEFAULT_MAX_VELOCITY_M_S
    moved = np.abs(hand.coupled.expand(fastest) - hand.coupled.offset)[:3]  # of joints a, b, c in a second
    binds = np.array([True, not ignored[0], not ignored[1]])
    assert (moved <= np.array(speeds) * (1 + 1e-9))[binds].all()
    assert np.isclose(moved, speeds)[binds].any()


@needs_robots
@pytest.mark.parametrize("path", [AG95, XHAND], ids=["ag95", "xhand"])
def test_speeds_of_a_urdf_are_read(path: Path) -> None:
    hand = build_embodiment(None, EndEffectorSpec("Hand", str(path), pads=[]))
    declared = {
        joint.get("name"): float(limit.get("velocity"))
        for joint in ElementTree.parse(path).iter("joint")
        if (limit := joint.find("limit")) is not None
    }
    expected = [declared.get(name, DEFAULT_MAX_VELOCITY_RAD_S) for name in hand.joint_names]
    np.testing.assert_array_equal(hand.max_velocity, expected)
    assert set(expected) & set(declared.values())


@pytest.mark.parametrize(
    ("velocity", "expected"),
    [
        ('velocity="0.7"', 0.7),
        ('velocity="0"', DEFAULT_MAX_VELOCITY_RAD_S),
        ('velocity="-1"', DEFAULT_MAX_VELOCITY_RAD_S),
        ('velocity="inf"', DEFAULT_MAX_VELOCITY_RAD_S),
        ('velocity="nan"', DEFAULT_MAX_VELOCITY_RAD_S),
        ("", DEFAULT_MAX_VELOCITY_RAD_S),
    ],
)
def test_a_speed_that_a_urdf_does_not_know_is_the_default(tmp_path: Path, velocity: str, expected: float) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM_URDF.format(geometry=BOX).replace('velocity="1"', velocity))
    arm = ArmSpec("Arm", str(path), "link", {})
    np.testing.assert_array_equal(build_embodiment(arm, None).max_velocity, [expected])
    named = replace(arm, max_velocity={"turn": 0.2})
    np.testing.assert_array_equal(build_embodiment(named, None).max_velocity, [0.2])


def test_a_speed_that_is_no_number(tmp_path: Path) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(ARM_URDF.format(geometry=BOX).replace('velocity="1"', 'velocity="fast"'))
    with pytest.raises(CEIError) as error:
        build_embodiment(ArmSpec("Arm", str(path), "link", {}), None)
    assert one_line(error) == "arm.urdf: <limit velocity='fast'> is not a number."


def test_a_speed_for_another_parts_joint_is_refused() -> None:
    arm, hand = load_arm("Panda"), load_end_effector("PandaGripper")
    with pytest.raises(CEIError) as error:
        build_embodiment(replace(arm, max_velocity={"finger_joint1": 1.0}), hand)
    assert one_line(error).startswith("unknown joint in max_velocity of Panda 'finger_joint1'.")
    assert one_line(error).endswith("Valid: joint1, joint2, joint3, joint4, joint5, joint6, joint7.")
    with pytest.raises(CEIError) as error:
        build_embodiment(arm, replace(hand, max_velocity={"joint1": 1.0}))
    assert one_line(error).endswith("Valid: finger_joint1, finger_joint2.")


@pytest.mark.parametrize("speed", [0.0, -1.0, float("inf"), float("nan")])
def test_a_speed_must_be_finite_and_above_0(speed: float) -> None:
    with pytest.raises(CEIError) as error:
        build_embodiment(replace(load_arm("UR5e"), max_velocity={"elbow_joint": speed}), None)
    assert f"max_velocity of UR5e gives elbow_joint {speed:g}" in one_line(error)


@pytest.mark.parametrize("arm", ARMS)
@pytest.mark.parametrize("end_effector", END_EFFECTORS)
def test_layout_is_arm_then_end_effector(arm: str, end_effector: str) -> None:
    embodiment = load_embodiment(f"{arm}-{end_effector}")
    alone = build_embodiment(None, embodiment.end_effector)
    assert embodiment.joint_names[: embodiment.n_arm] == tuple(embodiment.arm.home)
    assert embodiment.joint_names[embodiment.n_arm :] == alone.joint_names
    assert (embodiment.home >= embodiment.lower).all()
    assert (embodiment.home <= embodiment.upper).all()
    assert set(embodiment.joint_units[embodiment.n_arm :]) == {"m" if end_effector == "PandaGripper" else "rad"}


# -- the simulation ------------------------------------------------------------------------------------------


@pytest.fixture(scope="module", params=PAIRS)
def simulated(request: pytest.FixtureRequest) -> Iterator[tuple[Embodiment, Simulation]]:
    import robosuite

    embodiment = load_embodiment(request.param)
    simulation = Simulation(embodiment, lambda **arguments: robosuite.make("Lift", **arguments))
    yield embodiment, simulation
    simulation.close()


def test_link_poses_agree_with_the_simulation(simulated: tuple[Embodiment, Simulation]) -> None:
    embodiment, simulation = simulated
    tree, compared = KinematicTree(embodiment), 0
    for qpos in random_qpos(embodiment, 3):
        simulation.reset(qpos)
        simulation.forward()
        np.testing.assert_array_equal(simulation.qpos, qpos)
        T_world_links = simulation.T_world_base @ tree.forward(qpos)
        for body, name in enumerate(embodiment.body_names):
            if body == 0 or not name:
                continue
            if name.startswith(END_EFFECTOR_PREFIX):
                theirs = "gripper0_right_" + name.removeprefix(END_EFFECTOR_PREFIX)
            else:
                theirs = "robot0_" + name
            pose = simulation.data.body(theirs)
            np.testing.assert_allclose(T_world_links[body, :3, 3], pose.xpos, atol=1e-6, err_msg=name)
            np.testing.assert_allclose(T_world_links[body, :3, :3], pose.xmat.reshape(3, 3), atol=1e-6, err_msg=name)
            compared += 1
    assert compared > 3 * len(embodiment.joint_names)


def test_each_target_drives_its_own_joints(simulated: tuple[Embodiment, Simulation]) -> None:
    embodiment, simulation = simulated
    coupled, hand = embodiment.coupled, slice(embodiment.n_arm, None)
    lower, upper = embodiment.independent_limits
    for u in sorted(set(coupled.leader[hand])):
        target = embodiment.home.copy()
        independent = coupled.reduce(target)
        goal = 0.5 * (lower[u] + upper[u])
        independent[u] = goal if abs(goal - independent[u]) > 0.25 * (upper[u] - lower[u]) else lower[u]
        target = coupled.expand(independent)
        simulation.reset(embodiment.home)
        simulation.forward()
        for _ in range(12):
            simulation.tick(target)
        # Soft servos sag by up to 0.06 rad; a target that went to another finger would be off by 0.3.
        asked = np.abs(target - embodiment.home)[hand]
        moved = np.abs(simulation.qpos - embodiment.home)[hand]
        mine = coupled.leader[hand] == u
        assert (moved[mine] > 0.5 * asked[mine]).all(), embodiment.joint_names[hand]
        assert (moved[~mine] < 0.3 * asked[mine].max()).all(), (embodiment.joint_names[hand], moved)


def test_arm_joints_reach_their_targets(simulated: tuple[Embodiment, Simulation]) -> None:
    embodiment, simulation = simulated
    arm = slice(0, embodiment.n_arm)
    target = embodiment.home.copy()
    target[arm] += np.random.default_rng(0).uniform(-0.15, 0.15, embodiment.n_arm)
    simulation.reset(embodiment.home)
    simulation.forward()
    for _ in range(30):
        simulation.tick(target)
    assert np.abs(simulation.qpos - target)[arm].max() < 0.02


def test_robotiq_couplings_are_what_the_stock_physics_settles_to() -> None:
    import robosuite

    embodiment = load_embodiment("UR5e-RobotiqThreeFinger")
    simulation = Simulation(embodiment, lambda **arguments: robosuite.make("Lift", **arguments))
    coupled = embodiment.coupled
    scissor, *fingers = range(len(coupled.independent) - 4, len(coupled.independent))
    for curl, spread in ((0.8, 0.0), (0.4, 0.2)):
        u = coupled.reduce(embodiment.home)
        u[fingers], u[scissor] = curl, spread
        simulation.reset(embodiment.home)
        simulation.forward()
        for _ in range(30):
            simulation.tick(coupled.expand(u))
        settled = simulation.qpos
        np.testing.assert_allclose(settled, coupled.expand(coupled.reduce(settled)), atol=0.02)
        assert (coupled.reduce(settled)[fingers] > 0.8 * curl).all()
    simulation.close()


# -- third-party descriptions --------------------------------------------------------------------------------


def ag95(**changes) -> EndEffectorSpec:
    return EndEffectorSpec("AG95", str(AG95), pads=[], **changes)


@needs_robots
def test_ag95_couplings_are_the_mimics_of_its_urdf() -> None:
    embodiment = build_embodiment(None, ag95())
    coupled, names = embodiment.coupled, embodiment.joint_names
    assert [names[i] for i in coupled.independent] == ["gripper_finger1_joint"]
    mimics = {
        joint.get("name"): float(joint.find("mimic").get("multiplier", 1))
        for joint in ElementTree.parse(AG95).iter("joint")
        if joint.find("mimic") is not None
    }
    assert len(mimics) == 7
    for q, joint in enumerate(names):
        assert coupled.scale[q] == mimics.get(joint, 1.0), joint
    np.testing.assert_allclose(embodiment.independent_limits, [[0.0], [0.6524]])


@needs_robots
def test_ag95_meshes_are_found_by_package_and_scaled() -> None:
    embodiment = build_embodiment(None, ag95())
    meshes = dict(zip(embodiment.body_names, visual_link_meshes(embodiment.model), strict=True))
    np.testing.assert_allclose(meshes.pop("ee/gripper_root_link").extents, [0.1, 0.1, 1.0], atol=1e-9)
    found = {name: mesh for name, mesh in meshes.items() if mesh is not None}
    assert len(found) == 9
    for name, mesh in found.items():
        assert 0.01 < mesh.extents.max() < 0.5, name


@needs_robots
@pytest.mark.parametrize(
    ("spec", "independent", "moving"),
    [
        (ag95(), 1, 8),
        (ag95(root_body="gripper_base_link"), 1, 8),
        (EndEffectorSpec("XHand", str(XHAND), pads=[]), 12, 12),
    ],
    ids=["ag95", "ag95-gripper", "xhand"],
)
@pytest.mark.parametrize("arm", [None, "UR5e"])
def test_third_party_urdf(spec: EndEffectorSpec, independent: int, moving: int, arm: str | None) -> None:
    embodiment = build_embodiment(None if arm is None else load_arm(arm), spec)
    assert len(embodiment.joint_names) == embodiment.n_arm + moving
    assert len(embodiment.coupled.independent) == embodiment.n_arm + independent
    assert embodiment.n_arm == (0 if arm is None else 6)
    qpos = random_qpos(embodiment, 3)
    expected = mujoco_poses(embodiment.model, qpos)
    np.testing.assert_allclose(KinematicTree(embodiment).forward(qpos), expected, atol=1e-9)
    np.testing.assert_allclose(TorchChain(embodiment).forward(torch.tensor(qpos)).numpy(), expected, atol=1e-9)
    if arm and spec.root_body:
        root, flange = (embodiment.model.body(n).id for n in ("ee/" + spec.root_body, "right_hand"))
        assert embodiment.model.body_parentid[root] == flange
        assert "ee/gripper_root_link" not in embodiment.body_names


@needs_robots
def test_ag95_fingers_close_symmetrically_and_stay_parallel() -> None:
    """An oracle for the mimic signs: a parallel gripper's tips approach each other without turning."""
    embodiment = build_embodiment(None, ag95(root_body="gripper_base_link"))
    tree, coupled = KinematicTree(embodiment), build_embodiment(None, ag95()).coupled
    T = tree.forward(coupled.expand(np.array([[0.0], [0.3], [0.6]])))
    base = T[:, embodiment.body_id("gripper_base_link")]
    tips = np.linalg.inv(base)[:, None] @ np.stack(
        [T[:, embodiment.body_id(f"gripper_finger{i}_finger_tip_link")] for i in (1, 2)], axis=1
    )
    for t in (1, 2):  # the URDF's 3.14 for pi leaves 1.6 mrad
        np.testing.assert_allclose(tips[t, :, :3, :3], tips[0, :, :3, :3], atol=1e-6)
    gap = np.linalg.norm(tips[:, 0, :3, 3] - tips[:, 1, :3, 3], axis=1)
    assert gap[0] != pytest.approx(gap[1], abs=5e-3)
    np.testing.assert_allclose(tips[:, 0, :2, 3], -tips[:, 1, :2, 3], atol=5e-4)


# -- bad input -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("load", "close", "valid"),
    [
        (load_embodiment, "UR5e-Inspir", "Inspire"),
        (load_arm, "Pandas", "Panda"),
        (load_end_effector, "inspire", "Inspire"),
    ],
)
def test_unknown_names_list_the_valid_ones(load, close: str, valid: str) -> None:
    with pytest.raises(CEIError) as error:
        load(close)
    message = one_line(error)
    assert f"Did you mean {valid!r}?" in message
    names = {load_embodiment: end_effector_names(), load_arm: arm_names(), load_end_effector: end_effector_names()}[
        load
    ]
    assert all(name in message for name in names)


def test_unknown_link_lists_the_valid_ones() -> None:
    with pytest.raises(CEIError) as error:
        load_embodiment("Panda-Inspire").body_id("r_thumb_dist")
    assert "'r_thumb_distal'" in one_line(error)


def test_an_entity_bomb_is_refused(tmp_path: Path) -> None:
    lol = "".join(f'<!ENTITY l{i} "{f"&l{i - 1};" * 10}">' for i in range(1, 9))
    path = tmp_path / "bomb.urdf"
    path.write_text(f'<!DOCTYPE robot [<!ENTITY l0 "lol">{lol}]><robot name="x"><link name="base"/><a>&l8;</a></robot>')
    with pytest.raises(CEIError, match="entities are not allowed"):
        build_embodiment(ArmSpec("Arm", str(path), "base", {}), None)


def test_an_external_entity_is_not_read(tmp_path: Path) -> None:
    (tmp_path / "secret").write_text("secret")
    path = tmp_path / "arm.xml"
    path.write_text(f'<!DOCTYPE m [<!ENTITY x SYSTEM "{(tmp_path / "secret").as_uri()}">]><mujoco model="&x;"/>')
    with pytest.raises(CEIError, match="entities are not allowed"):
        build_embodiment(ArmSpec("Arm", str(path), "base", {}), None)


@pytest.mark.parametrize("uri", ["../outside.stl", "file:///etc/passwd", "/etc/passwd", "package://arm/../../x.stl"])
def test_a_mesh_outside_the_folder_is_refused(tmp_path: Path, uri: str) -> None:
    (tmp_path / "outside.stl").write_text("solid x\nendsolid x\n")
    folder = tmp_path / "arm"
    folder.mkdir()
    with pytest.raises(CEIError) as error:
        build_embodiment(write_arm(folder / "arm.urdf", f'<mesh filename="{uri}"/>'), None)
    assert "points outside its folder 'arm'" in one_line(error)


@pytest.mark.parametrize(
    "asset",
    [
        '<asset><mesh name="m" file="../outside.stl"/></asset>',
        '<include file="../outside.xml"/>',
        '<compiler meshdir=".."/><asset><mesh name="m" file="outside.stl"/></asset>',
        '<compiler assetdir=".."/><asset><mesh name="m" file="outside.stl"/></asset>',
        '<compiler texturedir=".."/><asset><texture type="cube" fileright="outside.stl"/></asset>',
        '<include file="part.xml"/>',
        '<compiler meshdir="."/><compiler meshdir=".."/><asset><mesh name="m" file="outside.stl"/></asset>',
    ],
)
def test_an_mjcf_cannot_reach_outside_its_folder(tmp_path: Path, asset: str) -> None:
    # A readable ball, so that only the rule can refuse it.
    import trimesh

    trimesh.creation.icosphere(1, 0.1).export(tmp_path / "outside.stl")
    (tmp_path / "outside.xml").write_text('<mujoco><worldbody><body name="b"/></worldbody></mujoco>')
    folder = tmp_path / "arm"
    folder.mkdir()
    geom = '<geom type="mesh" mesh="m"/>' if "mesh" in asset else ""
    (folder / "part.xml").write_text('<mujoco><asset><mesh name="m" file="../outside.stl"/></asset></mujoco>')
    (folder / "arm.xml").write_text(f'<mujoco>{asset}<worldbody><body name="base">{geom}</body></worldbody></mujoco>')
    with pytest.raises(CEIError) as error:
        build_embodiment(ArmSpec("Arm", str(folder / "arm.xml"), "base", {}), None)
    assert "points outside its folder 'arm'" in one_line(error)


def test_an_mjcf_may_name_files_in_any_folder_inside(tmp_path: Path) -> None:
    import trimesh

    for folder in ("meshes", "models"):
        (tmp_path / folder).mkdir()
    trimesh.creation.icosphere(1, 0.1).export(tmp_path / "meshes/ball.stl")
    (tmp_path / "models/assets.xml").write_text(
        '<mujoco><compiler meshdir="meshes"/><asset><mesh name="m" file="ball.stl"/></asset></mujoco>'
    )
    path = tmp_path / "arm.xml"
    path.write_text(
        '<mujoco><include file="models/assets.xml"/><worldbody><body name="base">'
        '<joint name="turn"/><geom type="mesh" mesh="m"/></body></worldbody></mujoco>'
    )
    embodiment = build_embodiment(ArmSpec("Arm", str(path), "base", {}), None)
    assert embodiment.joint_names == ("turn",)
    assert visual_link_meshes(embodiment.model)[1].extents == pytest.approx([0.2, 0.2, 0.2], rel=0.05)


def test_a_tendon_actuator_does_not_limit_a_joint(tmp_path: Path) -> None:
    path = tmp_path / "arm.xml"
    path.write_text(
        """<mujoco><compiler angle="radian"/><worldbody><body name="b"><geom size="0.1"/>
        <joint name="a" range="-1 1"/><joint name="c" axis="0 1 0" range="-1 1"/></body></worldbody>
        <tendon><fixed name="t"><joint joint="c" coef="1"/></fixed></tendon><actuator>
        <position tendon="t" ctrlrange="0 0.5"/><position joint="c" ctrlrange="-0.4 2"/></actuator>
        </mujoco>"""
    )
    arm = build_embodiment(ArmSpec("Arm", str(path), "b", {}), None)
    np.testing.assert_allclose([arm.lower, arm.upper], [[-1, -0.4], [1, 1]])


def test_an_arm_without_joints_is_an_embodiment(tmp_path: Path) -> None:
    path = tmp_path / "post.xml"
    path.write_text('<mujoco><worldbody><body name="b"><geom size="0.1"/></body></worldbody></mujoco>')
    embodiment = build_embodiment(ArmSpec("Post", str(path), "b", {}), load_end_effector("PandaGripper"))
    assert (embodiment.n_arm, len(embodiment.coupled.independent)) == (0, 1)
    assert build_embodiment(ArmSpec("Post", str(path), "b", {}), None).joint_names == ()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "not well-formed XML"),
        ("<sdf/>", "root element <sdf> is neither"),
        ('<mujoco><worldbody><body name="b"><geom/></body></worldbody></mujoco>', "MuJoCo"),
        (ARM_URDF.format(geometry='<mesh filename="none.stl"/>'), "none.stl"),
        (
            ARM_URDF.format(geometry='<mesh filename="package://ros/x.stl"/>'),
            "no enclosing folder is named 'ros'",
        ),
        (
            '<mujoco><worldbody><body name="b"><joint type="ball"/><geom size="1"/></body></worldbody></mujoco>',
            "neither a hinge",
        ),
    ],
)
def test_a_description_that_cannot_be_used(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "arm.urdf"
    path.write_text(text)
    with pytest.raises(CEIError) as error:
        body = "link" if "<robot" in text else "b"
        build_embodiment(ArmSpec("Arm", str(path), body, {}), None)
    assert message in one_line(error)


def test_a_missing_package_names_the_remedy() -> None:
    with pytest.raises(CEIError) as error:
        build_embodiment(ArmSpec("Arm", "package://no_such_robots/arm.xml", "base", {}), None)
    assert "pip install no_such_robots" in one_line(error)


@pytest.mark.parametrize("uri", ["package://robosuite/none.xml", "none.urdf"])
def test_a_missing_file(uri: str) -> None:
    with pytest.raises(CEIError) as error:
        build_embodiment(ArmSpec("Arm", uri, "base", {}), None)
    assert f"no robot description at {uri!r}" in one_line(error)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"couplings": {"joint_r_index_distal": Coupling("index")}},
            "joint in a coupling of Inspire 'index'",
        ),
        (
            {"couplings": {"index": Coupling("joint_r_index_distal")}},
            "joint in a coupling of Inspire 'index'",
        ),
        (
            {
                "couplings": {
                    "joint_r_index_distal": Coupling("joint_r_index_proximal"),
                    "joint_r_index_proximal": Coupling("joint_r_index_distal"),
                }
            },
            "go round in a circle: joint_r_index_",
        ),
        ({"couplings": {"joint_r_index_distal": Coupling("joint_r_index_distal")}}, "go round in a circle"),
        (
            {"home": {"joint_r_ring_proximal": 2.0}},
            "joint_r_ring_proximal at 2, outside [0, 1.62] rad",
        ),
        ({"closed": {"joint_r_index_proximal": -0.5}}, "closed puts joint_r_index_proximal at -0.5"),
        (
            {"home": {"joint_r_ring_distal": 1.0}},
            "unknown independent joint in a pose of Inspire",
        ),
        ({"root_body": "palm"}, "unknown root_body of Inspire 'palm'"),
        ({"angle": "rad"}, "unknown angle of Inspire 'rad'. Did you mean 'radian'?"),
    ],
)
def test_a_specification_that_does_not_fit_its_description(changes: dict, message: str) -> None:
    with pytest.raises(CEIError) as error:
        build_embodiment(None, replace(load_end_effector("Inspire"), **changes))
    assert message in one_line(error)


def test_a_mount_body_that_the_arm_lacks() -> None:
    with pytest.raises(CEIError) as error:
        build_embodiment(replace(load_arm("Panda"), mount_body="flange"), load_end_effector("Inspire"))
    assert "unknown mount_body of Panda 'flange'" in one_line(error)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("name: X\ndescription: x.xml\npads: []\nhomee: {a: 1}", "homee"),
        ("name: X\ndescription: x.xml", "pads"),
        ("name: X\ndescription: x.xml\npads: [{body: a, extend: [0, 1]}]", "extend"),
        ("name: X\ndescription: x.xml\npads: []\nhome: {a: one}", "one"),
        ("name: [X\n", "gripper.yaml: not a valid EndEffectorSpec"),
        ("- a\n- b", "expected a mapping"),
        ("!!python/object/apply:os.system ['true']", "gripper.yaml: not a valid EndEffectorSpec"),
    ],
)
def test_a_faulty_yaml_is_one_line(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "gripper.yaml"
    path.write_text(text)
    with pytest.raises(CEIError) as error:
        load_spec(EndEffectorSpec, path)
    assert message in one_line(error)
    assert "gripper.yaml" in one_line(error)


def test_a_missing_yaml(tmp_path: Path) -> None:
    with pytest.raises(CEIError, match="no such file"):
        load_spec(ArmSpec, tmp_path / "arm.yaml")


# -- surfaces ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("geom", "extents"),
    [
        ('type="box" size="0.1 0.2 0.3"', (0.2, 0.4, 0.6)),
        ('type="sphere" size="0.1"', (0.2, 0.2, 0.2)),
        ('type="ellipsoid" size="0.1 0.2 0.3"', (0.2, 0.4, 0.6)),
        ('type="cylinder" size="0.1 0.3"', (0.2, 0.2, 0.6)),
        ('type="capsule" size="0.1 0.3"', (0.2, 0.2, 0.8)),
        ('type="box" size="0.1 0.2 0.3" quat="0.70710678 0.70710678 0 0"', (0.2, 0.6, 0.4)),
    ],
)
def test_a_geom_becomes_a_surface_of_its_size(geom: str, extents: tuple[float, float, float]) -> None:
    model = mujoco.MjModel.from_xml_string(
        f'<mujoco><worldbody><body><geom {geom} pos="1 2 3"/></body></worldbody></mujoco>'
    )
    mesh = link_mesh(model, [0])
    assert mesh is not None
    np.testing.assert_allclose(mesh.extents, extents, rtol=0.02)
    np.testing.assert_allclose(mesh.bounds.mean(0), [1, 2, 3], atol=1e-6)
    assert mesh.is_watertight
    assert mesh.volume > 0


def test_a_pad_may_name_only_what_its_link_has() -> None:
    from cei_gym.functional import sample_representation

    spec = replace(load_end_effector("Inspire"), pads=[Pad("r_index_distal", ["r_index_distal_co"])])
    with pytest.raises(CEIError) as error:
        sample_representation(build_embodiment(None, spec), 8)
    assert "Did you mean 'r_index_distal_col'?" in one_line(error)
