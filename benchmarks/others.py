"""mink and dex-retargeting on the nearest problem that each can express; `benchmarks/alignment.py` compares them with ours.

usage: python benchmarks/others.py

Run by itself, it prints how far the kinematics that each library is given are from ours. A library that is missing is left
out; dex-retargeting needs `uv pip install --python .venv --group baselines --constraint requirements.lock`.

Neither library matches surfaces. Both are given the matches that the DCD makes at frame 0, with the target at u0, and keep
them: the source points that a target pad is matched to carry it along as one rigid body. That leaves one pose of each pad and
frame (frame 0 is solved by u0), which is inverse kinematics, what both libraries are for. Position alone, or an offset held
constant in the base frame, would leave them with a higher DCD on average.
"""

from collections.abc import Callable
from importlib import import_module
from typing import NamedTuple

import mujoco
import numpy as np

from cei_gym.alignment import AlignmentProblem
from cei_gym.embodiment import GRID, Embodiment, load_embodiment
from cei_gym.functional.distance import DEFAULT_DIRECTION_WEIGHT_M, pair_cost
from cei_gym.functional.representation import sample_representation
from cei_gym.kinematics.tree import KinematicTree

# What lambda and the solver's temporal weight amount to beside the pull of matches 1 cm apart (see alignment/newton):
# sqrt(0.05 m * 0.01 m) and sqrt(1e-2 m * 0.01 m), against 1 for position.
_ORIENTATION_COST_M = 0.02
_POSTURE_COST_M = 0.01
# Without it, steps near a singularity diverge.
_LM_DAMPING = 1.0
# Centred triangle, 2.8 cm to a corner: turned about an axis in its plane, it moves by 2 cm a radian (root mean square).
_TRIANGLE_M = 0.035 * (np.eye(3) - 1 / 3)


class PadGoals(NamedTuple):
    """Poses for a frame fixed to each pad: at a point of it, aligned with its link.

    Attributes:
        body: (K,) link of each pad.
        points_link: (K, 3) where the frame is in its link, m.
        points_base: (T, K, 3) where it should be in the target's base frame, m.
        rotations_base: (T, K, 3, 3) how the link should be turned.
    """

    body: np.ndarray
    points_link: np.ndarray
    points_base: np.ndarray
    rotations_base: np.ndarray


def available() -> dict[str, Callable[..., np.ndarray]]:
    """The libraries that can be imported: name -> function that tracks with it; prints a line for each that cannot."""
    functions = {}
    for name, module, function in (
        ("mink", "mink", mink_track),
        ("dex-retargeting", "dex_retargeting.optimizer", dex_retargeting_track),
    ):
        try:
            import_module(module)
        except ImportError as error:
            print(f"{name} is left out: {error}")
        else:
            functions[name] = function
    return functions


def mink_track(problem: AlignmentProblem, points_base, normals_base, u0, iterations: int = 10) -> np.ndarray:
    """Differential inverse kinematics: a frame task a pad, and a posture task towards the frame before.

    Limits are mink's ConfigurationLimit on the independent joints. Coupled joints are equality constraints of the model,
    which mink keeps exactly (EqualityConstraintTask as a constraint), so nothing is projected.

    Args:
        points_base, normals_base: (T, N, 3) source representation in the target's base frame, m and unit.
        u0: (m,) solution of frame 0, rad or m.
        iterations: quadratic programs a frame.

    Returns:
        (T, m) independent joints.
    """
    import mink

    embodiment, goals = problem.embodiment, pad_goals(problem, points_base, normals_base, u0)
    model = _mujoco_model(embodiment, goals.body, goals.points_link)
    configuration = mink.Configuration(model, embodiment.coupled.expand(u0))
    pads = [
        mink.FrameTask(str(k), "site", 1.0, _ORIENTATION_COST_M, lm_damping=_LM_DAMPING) for k in range(len(goals.body))
    ]
    posture = mink.PostureTask(model, _POSTURE_COST_M)
    limits = [mink.ConfigurationLimit(model)]
    constraints = [mink.EqualityConstraintTask(model, 1.0)] if model.neq else None
    q = []
    for points, rotations in zip(goals.points_base, goals.rotations_base, strict=True):
        for pad, point, rotation in zip(pads, points, rotations, strict=True):
            pad.set_target(mink.SE3.from_rotation_and_translation(mink.SO3.from_matrix(rotation), point))
        posture.set_target_from_configuration(configuration)
        for _ in range(iterations):
            velocity = mink.solve_ik(
                configuration,
                [*pads, posture],
                1.0,  # seconds: the whole step
                solver="daqp",
                damping=1e-6,
                limits=limits,
                constraints=constraints,
            )
            configuration.integrate_inplace(velocity, 1.0)
        q.append(configuration.q.copy())
    return np.clip(embodiment.coupled.reduce(np.array(q)), *embodiment.independent_limits)


def dex_retargeting_track(problem: AlignmentProblem, points_base, normals_base, u0) -> np.ndarray:
    """Position retargeting with the library's own weights and tolerance: a triangle of three points a pad.

    Three points, because position retargeting has no orientations. Coupled joints are the library's mimic joints. It lets
    joints be 1e-3 beyond a limit: clipped here.

    Args:
        points_base, normals_base: (T, N, 3) source representation in the target's base frame, m and unit.
        u0: (m,) solution of frame 0, rad or m.

    Returns:
        (T, m) independent joints.
    """
    from dex_retargeting.kinematics_adaptor import MimicJointKinematicAdaptor
    from dex_retargeting.optimizer import PositionOptimizer
    from dex_retargeting.seq_retarget import SeqRetargeting

    embodiment, coupled = problem.embodiment, problem.embodiment.coupled
    goals = pad_goals(problem, points_base, normals_base, u0)
    corners_link = (goals.points_link[:, None] + _TRIANGLE_M).reshape(-1, 3)
    corners_base = goals.points_base[:, :, None] + np.einsum("tkij,cj->tkci", goals.rotations_base, _TRIANGLE_M)
    robot = _pinocchio_robot(embodiment, np.repeat(goals.body, 3), corners_link)
    leaders = [str(q) for q in coupled.independent]
    corners = [f"point {i}" for i in range(len(corners_link))]
    optimizer = PositionOptimizer(robot, leaders, corners, np.arange(len(corners)))
    followers = np.setdiff1d(np.arange(len(coupled.leader)), coupled.independent)
    if len(followers):
        optimizer.set_kinematic_adaptor(
            MimicJointKinematicAdaptor(
                robot,
                leaders,
                source_joint_names=[leaders[coupled.leader[q]] for q in followers],
                mimic_joint_names=[str(q) for q in followers],
                multipliers=coupled.scale[followers],
                offsets=coupled.offset[followers],
            )
        )
    retargeting = SeqRetargeting(optimizer)
    retargeting.set_qpos(coupled.expand(u0))
    q = np.array([retargeting.retarget(frame.reshape(-1, 3)) for frame in corners_base])
    return np.clip(coupled.reduce(q), *embodiment.independent_limits)


def pad_goals(problem: AlignmentProblem, points_base, normals_base, u0) -> PadGoals:
    """Each pad of the target carried by the source points that the DCD matches to it at frame 0.

    A pad is held at the mean of its matched points; how its source points move is their best rigid fit (Kabsch) to frame 0.
    """
    representation = problem.representation
    T_links = problem.tree.forward(problem.embodiment.coupled.expand(u0))
    points_target, normals_target = representation.place(T_links)
    cost = pair_cost(points_base[0], normals_base[0], points_target, normals_target, DEFAULT_DIRECTION_WEIGHT_M)
    n_source, n_target = cost.shape
    # Both directions of the DCD, each a mean over its own points.
    source = np.concatenate([np.arange(n_source), cost.argmin(0)])
    target = np.concatenate([cost.argmin(1), np.arange(n_target)])
    weight = np.repeat([1 / n_source, 1 / n_target], [n_source, n_target])
    bodies = np.unique(representation.body)
    points_link, points, rotations = [], [], []
    for body in bodies:
        on = representation.body[target] == body
        w = weight[on] / weight[on].sum()
        points_link.append(w @ representation.points_link[target[on]])
        matched = points_base[:, source[on]]
        centre = w @ matched
        arms = matched - centre[:, None]
        U, _, Vt = np.linalg.svd(np.swapaxes(w[:, None] * arms, 1, 2) @ arms[0])
        U[..., 2] *= np.linalg.det(U @ Vt)[:, None]  # a turn, not a mirror
        turn = U @ Vt
        offset = T_links[body, :3, :3] @ points_link[-1] + T_links[body, :3, 3] - centre[0]
        points.append(centre + turn @ offset)
        rotations.append(turn @ T_links[body, :3, :3])
    return PadGoals(bodies, np.array(points_link), np.stack(points, 1), np.stack(rotations, 1))


def _mujoco_model(embodiment: Embodiment, body: np.ndarray, points_link: np.ndarray) -> mujoco.MjModel:
    """The embodiment's kinematics alone, with a site "0", "1", ... at each point and an equality for each coupled joint."""
    model, coupled = embodiment.model, embodiment.coupled
    ranges = dict(zip(coupled.independent, np.transpose(embodiment.independent_limits), strict=True))
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    bodies = [spec.worldbody]
    for b in range(1, model.nbody):
        parent = bodies[model.body_parentid[b]]
        bodies.append(parent.add_body(pos=model.body_pos[b], quat=model.body_quat[b]))
        bodies[b].mass, bodies[b].inertia, bodies[b].explicitinertial = 1.0, np.ones(3), True
        for q in np.flatnonzero(model.jnt_bodyid == b):
            joint = bodies[b].add_joint(name=str(q), type=model.jnt_type[q], axis=model.jnt_axis[q])
            joint.pos, joint.ref = model.jnt_pos[q], model.qpos0[q]
            if q in ranges:
                joint.limited, joint.range = mujoco.mjtLimited.mjLIMITED_TRUE, ranges[q]
    for i, (b, point) in enumerate(zip(body, points_link, strict=True)):
        bodies[b].add_site(name=str(i), pos=point)
    for q in np.setdiff1d(np.arange(model.njnt), coupled.independent):
        leader = coupled.independent[coupled.leader[q]]
        equality = spec.add_equality(type=mujoco.mjtEq.mjEQ_JOINT, name1=str(q), name2=str(leader))
        # A polynomial of the leader's displacement from its reference.
        equality.data[0] = coupled.offset[q] + coupled.scale[q] * model.qpos0[leader] - model.qpos0[q]
        equality.data[1] = coupled.scale[q]
    return spec.compile()


def _pinocchio_robot(embodiment: Embodiment, body: np.ndarray, points_link: np.ndarray):
    """dex-retargeting's robot, made without a URDF: joints "0", "1", ... in our order, a link "point i" at each point."""
    import pinocchio as pin
    from dex_retargeting.robot_wrapper import RobotWrapper

    class Robot(RobotWrapper):
        def __init__(self, model):
            self.model, self.data, self.q0 = model, model.createData(), pin.neutral(model)

    arrays, independent = KinematicTree(embodiment).arrays, embodiment.coupled.independent
    lower, upper = embodiment.lower.copy(), embodiment.upper.copy()
    lower[independent], upper[independent] = embodiment.independent_limits
    model = pin.Model()
    frames = [(0, pin.SE3.Identity())]  # of each body: the joint that moves it, and its pose there
    for b in range(1, len(arrays.parent)):
        joint, T = frames[arrays.parent[b]]
        T = T * pin.SE3(arrays.rot[b], arrays.pos[b])
        for q in range(arrays.joint_start[b], arrays.joint_start[b + 1]):
            axis, anchor = arrays.axis[q], pin.SE3(np.eye(3), arrays.anchor[q])
            back = -arrays.reference[q] * axis
            if arrays.hinge[q]:
                kind, zero = pin.JointModelRevoluteUnaligned(axis), pin.SE3(pin.exp3(back), np.zeros(3))
            else:
                kind, zero = pin.JointModelPrismaticUnaligned(axis), pin.SE3(np.eye(3), back)
            limits = lower[q : q + 1], upper[q : q + 1]
            joint = model.addJoint(joint, kind, T * anchor * zero, str(q), np.ones(1), np.ones(1), *limits)
            T = anchor.inverse()
        frames.append((joint, T))
    for i, (b, point) in enumerate(zip(body, points_link, strict=True)):
        joint, T = frames[b]
        model.addFrame(pin.Frame(f"point {i}", joint, 0, T * pin.SE3(np.eye(3), point), pin.BODY))
    return Robot(model)


def main() -> None:
    libraries, rng = available(), np.random.default_rng(0)
    for name in GRID:
        embodiment = load_embodiment(name)
        representation, tree = sample_representation(embodiment), KinematicTree(embodiment)
        body, points_link = representation.body, representation.points_link
        q = embodiment.coupled.expand(rng.uniform(*embodiment.independent_limits))
        expected = representation.place(tree.forward(q))[0]
        found = {}
        if "mink" in libraries:
            model = _mujoco_model(embodiment, body, points_link)
            data = mujoco.MjData(model)
            data.qpos[:] = q
            mujoco.mj_forward(model, data)
            coupling = np.abs(data.efc_pos[: model.neq]).max(initial=0.0)
            found["mink"] = max(np.abs(data.site_xpos - expected).max(), coupling)
        if "dex-retargeting" in libraries:
            robot = _pinocchio_robot(embodiment, body, points_link)
            robot.compute_forward_kinematics(q)
            poses = [robot.get_link_pose(robot.get_link_index(f"point {i}")) for i in range(len(body))]
            found["dex-retargeting"] = np.abs(np.array(poses)[:, :3, 3] - expected).max()
        print(f"{name:24}", *(f"{library} {error:.0e} m" for library, error in found.items()))


if __name__ == "__main__":
    main()
