"""The trajectory alignment: derivatives, solvers, limits, basins, clearance, and the report."""

import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import home, problem_of

from cei_gym.alignment import (
    AlignmentProblem,
    ClearanceOptions,
    InitialisationOptions,
    Motion,
    PaperOptions,
    SolverOptions,
    Surroundings,
    make_solver,
)
from cei_gym.alignment.follow import Follower
from cei_gym.alignment.judge.clearance import Clearance
from cei_gym.alignment.judge.report import make_report
from cei_gym.alignment.solvers.newton import NewtonSolver
from cei_gym.alignment.start.basins import judge, ranked
from cei_gym.alignment.start.starts import active_joints, find_basins, random_starts
from cei_gym.embodiment import END_EFFECTORS, load_embodiment
from cei_gym.errors import CEIError
from cei_gym.functional import directional_chamfer_distance
from cei_gym.kinematics import KinematicTree

# Each arm and each end-effector.
NAMES = dict(
    zip(
        END_EFFECTORS,
        (
            "Kinova3-FourierRight",
            "IIWA-Inspire",
            "Panda-FourierLeft",
            "UR5e-RobotiqThreeFinger",
            "Panda-PandaGripper",
        ),
        strict=True,
    )
)
POINTS = 32
SEEDS = st.integers(0, 2**31)


@pytest.fixture(scope="module")
def problems() -> dict[str, AlignmentProblem]:
    return {name: problem_of(name) for name in NAMES.values()}


def inside(problem: AlignmentProblem, seed: int, share: float = 0.8) -> np.ndarray:
    """(m,) random independent joints well within limits and near home, where an arm is of use."""
    lower, upper = problem.embodiment.independent_limits
    middle, half = (lower + upper) / 2, share * (upper - lower) / 2
    u = home(problem) + np.random.default_rng(seed).uniform(-0.4, 0.4, len(lower))
    return np.clip(u, middle - half, middle + half)


def panda_grasp(frames: int = 6) -> tuple[np.ndarray, np.ndarray]:
    """The Panda's pads, lowered by 5 cm and closed, in its base frame."""
    problem = problem_of("Panda-PandaGripper")
    s = np.linspace(0, 1, frames)[:, None]
    u = home(problem) + s * [0.05, 0.1, 0, -0.05, 0, 0.1, 0, -0.015]
    return problem.place(u)


# -- derivatives ---------------------------------------------------------------------------------------------


@settings(max_examples=20, deadline=None)
@given(end_effector=st.sampled_from(END_EFFECTORS), seed=SEEDS)
def test_gradient_is_the_finite_difference_of_the_smoothed_objective(end_effector: str, seed: int) -> None:
    problem = problem_of(NAMES[end_effector], 12)
    solver = NewtonSolver(problem, SolverOptions())
    u = inside(problem, seed)
    points, normals = problem.place(inside(problem, seed + 1))
    dcd, gradient, _ = solver.derivatives(points, normals, u)
    here = problem.place(u)
    assert dcd == pytest.approx(directional_chamfer_distance(points, normals, *here, 0.05), abs=1e-12)

    # Matches at u, from the definition; then the same matches with |r| smoothed by 1 mm.
    offset = points[:, None] - here[0][None]
    cost = np.linalg.norm(offset, axis=-1) - 0.05 * normals @ here[1].T
    forth, back = cost.argmin(1), cost.argmin(0)

    def objective(u: np.ndarray) -> float:
        p, n = problem.place(u)
        i, j = np.arange(len(points)), np.arange(len(p))
        total = 0.0
        for a, b in ((i, forth), (back, j)):
            distance = np.sqrt(np.square(points[a] - p[b]).sum(-1) + 1e-6)
            total += (distance - 0.05 * (normals[a] * n[b]).sum(-1)).mean()
        return total

    h = 1e-6
    expected = [(objective(u + h * e) - objective(u - h * e)) / (2 * h) for e in np.eye(len(u))]
    np.testing.assert_allclose(gradient, expected, atol=1e-7)


@pytest.mark.parametrize("name", NAMES.values())
def test_gradient_is_that_of_the_distance_where_pads_are_apart(name: str, problems: dict) -> None:
    problem = problems[name]
    solver = NewtonSolver(problem, SolverOptions())
    points, normals = problem.place(inside(problem, 1))
    u, h = inside(problem, 2), 1e-6

    def dcd(u: np.ndarray) -> float:
        return float(directional_chamfer_distance(points, normals, *problem.place(u), 0.05))

    gradient = solver.derivatives(points, normals, u)[1]
    expected = np.array([(dcd(u + h * e) - dcd(u - h * e)) / (2 * h) for e in np.eye(len(u))])
    np.testing.assert_allclose(gradient, expected, atol=2e-3 * np.abs(expected).max())


@settings(max_examples=15, deadline=None)
@given(end_effector=st.sampled_from(END_EFFECTORS), seed=SEEDS)
def test_hessian_is_a_majoriser(end_effector: str, seed: int) -> None:
    """Symmetric, positive semi-definite, and a quadratic that lies above the objective for small steps."""
    problem = problem_of(NAMES[end_effector], 12)
    solver = NewtonSolver(problem, SolverOptions())
    u = inside(problem, seed)
    points, normals = problem.place(inside(problem, seed + 1))
    dcd, gradient, hessian = solver.derivatives(points, normals, u)
    np.testing.assert_allclose(hessian, hessian.T, atol=1e-12)
    eigenvalues = np.linalg.eigvalsh(hessian)
    assert eigenvalues.min() > -1e-9 * eigenvalues.max()
    step = -np.linalg.solve(hessian + 1e-3 * np.eye(len(u)), gradient)
    small = 1e-2 * step / np.abs(step).max()
    assert solver.derivatives(points, normals, u + small)[0] < dcd


# -- solvers -------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["IIWA-Inspire", "UR5e-RobotiqThreeFinger"])
def test_newton_is_at_least_as_good_as_the_paper(name: str, problems: dict) -> None:
    problem = problems[name]
    points, normals = panda_grasp(3)
    options = SolverOptions(paper=PaperOptions(steps=80))
    candidates = find_basins(problem, options, points[0], normals[0], InitialisationOptions(starts=48, basins=1))
    tracks = {}
    for backend in ("numba", "paper"):
        solver = make_solver(problem, replace(options, backend=backend))
        tracks[backend] = solver.track(points, normals, candidates[0])
    newton, paper = tracks["numba"], tracks["paper"]
    assert newton.objective.mean() <= paper.objective.mean() + 1e-3
    for track in (newton, paper):  # what they report is the paper's distance of what they return
        placed = problem.place(track.u)
        expected = directional_chamfer_distance(points, normals, *placed, options.lambda_m)
        np.testing.assert_allclose(track.objective, expected, atol=1e-6)
        assert (track.iterations >= 1).all()


@pytest.mark.parametrize("name", NAMES.values())
@pytest.mark.parametrize("seed", [1, 2])
def test_a_known_pose_is_recovered(name: str, seed: int, problems: dict) -> None:
    problem = problems[name]
    goal = inside(problem, seed)
    goal = np.where(active_joints(problem), goal, home(problem))
    points, normals = problem.place(goal[None])
    start = goal + np.random.default_rng(seed).uniform(-0.02, 0.02, len(goal)) * active_joints(problem)
    track = NewtonSolver(problem, SolverOptions(tolerance=1e-9)).track(points, normals, start, 200)
    assert track.objective[0] == pytest.approx(-0.1, abs=1e-5)
    error = np.linalg.norm(problem.place(track.u)[0] - points, axis=-1)
    assert error.mean() < 1e-5


def test_paper_solver_recovers_a_known_pose(problems: dict) -> None:
    problem = problems["Panda-PandaGripper"]
    goal = inside(problem, 1)
    points, normals = problem.place(goal[None])
    options = SolverOptions(backend="paper", paper=PaperOptions(learning_rate=2e-3, steps=300, patience=40))
    track = make_solver(problem, options).track(points, normals, goal + 0.02)
    error = np.linalg.norm(problem.place(track.u)[0] - points, axis=-1)
    assert error.mean() < 2e-3


@pytest.mark.parametrize("backend", ["numba", "paper"])
@pytest.mark.parametrize("shift_m", [(0.0, 0.0, -0.3), (2.0, 0.0, 0.0), (0.0, 0.0, 2.0)])
def test_limits_hold_at_every_frame(backend: str, shift_m: tuple, problems: dict) -> None:
    problem = problems["UR5e-RobotiqThreeFinger"]
    points, normals = panda_grasp(3)
    options = SolverOptions(backend=backend, paper=PaperOptions(steps=25, learning_rate=0.1))
    lower, upper = problem.embodiment.independent_limits
    start = upper + 0.5  # a start outside is brought in, too
    track = make_solver(problem, options).track(points + shift_m, normals, start)
    assert np.isfinite(track.u).all()
    assert (track.u >= lower).all()
    assert (track.u <= upper).all()


def test_a_joint_at_its_limit_comes_back() -> None:
    problem = problem_of("Panda-PandaGripper")
    _, upper = problem.embodiment.independent_limits
    goals = np.tile(home(problem), (3, 1))
    goals[:, 7] = 0.03, 0.06, 0.02  # opens wider than it can, and closes again
    points, normals = problem.place(goals)
    track = NewtonSolver(problem, SolverOptions(temporal_weight=0)).track(points, normals, goals[0])
    assert track.u[1, 7] == upper[7]
    np.testing.assert_allclose(track.u[[0, 2], 7], [0.03, 0.02], atol=1e-4)


def test_a_source_that_stands_still_is_followed_by_standing_still(problems: dict) -> None:
    problem = problems["IIWA-Inspire"]
    points, normals = (np.repeat(x[:1], 16, axis=0) for x in panda_grasp(1))
    solver = NewtonSolver(problem, SolverOptions())
    basins = find_basins(problem, SolverOptions(), points[0], normals[0], InitialisationOptions(starts=32, basins=1))
    settled = solver.track(points[:1], normals[:1], basins[0], 200).u[0]
    track = solver.track(points, normals, settled)
    assert np.abs(np.diff(track.u, axis=0)).max() < 0.03
    assert np.abs(np.diff(track.u[-4:], axis=0)).max() < 1e-3


def test_the_temporal_weight_shrinks_steps(problems: dict) -> None:
    problem = problems["IIWA-Inspire"]
    points, normals = panda_grasp(10)
    u0 = find_basins(problem, SolverOptions(), points[0], normals[0], InitialisationOptions(starts=32, basins=1))[0]
    steps, objective = [], []
    for weight in (0.0, 1e-2, 1.0):
        track = NewtonSolver(problem, SolverOptions(temporal_weight=weight)).track(points, normals, u0)
        steps.append(np.linalg.norm(np.diff(track.u, axis=0), axis=1).mean())
        objective.append(track.objective.mean())
    assert steps[0] > steps[1] > steps[2]
    assert objective[2] > objective[0]  # it is paid for


def test_the_solver_keeps_nothing_between_calls(problems: dict) -> None:
    problem = problems["UR5e-RobotiqThreeFinger"]
    points, normals = panda_grasp(4)
    solver = NewtonSolver(problem, SolverOptions())
    first = solver.track(points, normals, home(problem))
    solver.track(points[::-1] + 0.1, normals, home(problem) + 0.2)
    again = solver.track(points, normals, home(problem))
    np.testing.assert_array_equal(first.u, again.u)
    np.testing.assert_array_equal(first.objective, again.objective)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        (
            {"backend": "numbe"},
            "unknown solver.backend 'numbe'. Did you mean 'numba'? Valid: auto, numba, torch, paper.",
        ),
        ({"lambda_m": -0.1}, "solver.lambda_m=-0.1 must be at least 0."),
        ({"velocity_scale": float("nan")}, "solver.velocity_scale=nan must be at least 0."),
        ({"iterations": -1}, "solver.iterations=-1 must be at least 0."),
    ],
)
def test_bad_options_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(CEIError) as error:
        SolverOptions(**changes)
    assert str(error.value) == message


def test_compiled_code_is_read_from_disk_by_the_next_process() -> None:
    code = """
import numpy as np
from cei_gym.alignment import AlignmentProblem, SolverOptions, make_solver
from cei_gym.alignment.solvers import newton
from cei_gym.embodiment import load_embodiment
from cei_gym.functional import sample_representation
from cei_gym.kinematics import KinematicTree
body = load_embodiment("Panda-PandaGripper")
problem = AlignmentProblem(sample_representation(body, 8), KinematicTree(body))
u = body.coupled.reduce(body.home)
make_solver(problem, SolverOptions()).track(*problem.place(u[None]), u)
stats = newton._track.stats
print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))
"""
    for _ in range(2):
        process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert process.stdout.split() == ["1", "0"]


# -- first frame ---------------------------------------------------------------------------------------------


def test_basins_are_distinct_sorted_and_seeded(problems: dict) -> None:
    problem = problems["IIWA-Inspire"]
    points, normals = (x[0] for x in panda_grasp(1))
    options = InitialisationOptions(starts=48, basins=6)
    basins = find_basins(problem, SolverOptions(), points, normals, options)
    assert 2 <= len(basins) <= 6
    apart = np.abs(basins[:, None] - basins[None]).max(-1)
    assert (apart[~np.eye(len(basins), dtype=bool)] > 0.15).all()
    values = [directional_chamfer_distance(points, normals, *problem.place(u), 0.05) for u in basins]
    assert values[0] < -0.05
    np.testing.assert_allclose(values, np.sort(values), atol=5e-3)
    # A joint that moves no pad has no reason to leave home.
    idle = ~active_joints(problem)
    names = [problem.embodiment.joint_names[i] for i in problem.embodiment.coupled.independent[idle]]
    assert names == ["joint_r_ring_proximal", "joint_r_pinky_proximal"]
    np.testing.assert_array_equal(basins[:, idle], np.tile(home(problem)[idle], (len(basins), 1)))
    again = find_basins(problem, SolverOptions(), points, normals, options)
    np.testing.assert_array_equal(basins, again)
    other = find_basins(problem, SolverOptions(), points, normals, replace(options, seed=1))
    assert other.shape != basins.shape or not np.allclose(other, basins)


@settings(max_examples=10, deadline=None)
@given(end_effector=st.sampled_from(END_EFFECTORS), seed=st.integers(0, 1000))
def test_starts_are_within_limits_and_not_wrapped(end_effector: str, seed: int) -> None:
    problem = problem_of(NAMES[end_effector], 8)
    lower, upper = problem.embodiment.independent_limits
    starts = random_starts(problem, 50, seed)
    assert (starts >= lower).all()
    assert (starts <= upper).all()
    assert (np.abs(starts - home(problem)) <= np.pi).all()
    moving = active_joints(problem)
    assert (np.ptp(starts, axis=0)[moving] > 0.5 * np.minimum(upper - lower, 2 * np.pi)[moving]).all()


@pytest.mark.parametrize("name", NAMES.values())
def test_active_joints_are_those_that_move_a_pad(name: str, problems: dict) -> None:
    problem = problems[name]
    u, h = inside(problem, 5), 1e-4
    moved = [np.abs(problem.place(u + h * e)[0] - problem.place(u)[0]).max() for e in np.eye(len(u))]
    np.testing.assert_array_equal(active_joints(problem), np.array(moved) > 1e-9)


def test_judging_prefers_the_basin_that_stays_above_the_table(problems: dict) -> None:
    problem = problems["Panda-PandaGripper"]
    u = home(problem)
    trajectory = problem.place(np.tile(u, (3, 1)))
    lowest = problem.place(u)[0][:, 2].min()
    flipped = u.copy()
    flipped[1] += 0.4  # leans down: the pads are elsewhere and the hand deeper
    surroundings = Surroundings(lowest - 0.02)
    motion = Motion(*trajectory, u, surroundings=surroundings)
    options = SolverOptions(iterations=0, clearance=ClearanceOptions(weight=0))
    follower = Follower(problem, options)
    judged = ranked([judge(follower, [motion], u0, [follower.follow(replace(motion, u0=u0))]) for u0 in (flipped, u)])
    np.testing.assert_array_equal(judged[0].u, u)
    assert judged[0].cost < judged[1].cost
    assert judged[0].objective == pytest.approx(-0.1)
    assert judged[1].penetration_m > judged[0].penetration_m
    assert judged[1].joint_step_rad == 0


# -- clearance -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["Panda-PandaGripper", "Kinova3-FourierRight"])
def test_depth_below_the_support_is_measured(name: str) -> None:
    problem = problem_of(name)
    qpos = problem.embodiment.home
    pads_z = problem.place(home(problem))[0][:, 2].min()
    far_below, _ = Clearance(problem.embodiment).worst(qpos[None], pads_z - 1.0)
    assert far_below < 1e-3
    for depth in (0.01, 0.05):
        found, _ = Clearance(problem.embodiment).worst(qpos[None], pads_z + depth)
        assert found >= depth - 1e-3  # the pads are a part of the hand: something is at least this deep
    one, two = (Clearance(problem.embodiment).worst(qpos[None], pads_z + d)[0] for d in (0.1, 0.2))
    assert two - one == pytest.approx(0.1)


def test_a_hand_in_its_own_arm_has_depth() -> None:
    embodiment = load_embodiment("UR5e-PandaGripper")
    folded = embodiment.home.copy()
    folded[2] = 3.1  # the elbow folds the wrist onto the upper arm
    clearance = Clearance(embodiment)
    assert clearance.worst(embodiment.home[None], -10.0)[0] == 0
    assert clearance.worst(folded[None], -10.0)[0] > 0.01
    both = clearance.worst(np.stack([embodiment.home, folded]), -10.0)
    assert both[0] == clearance.worst(folded[None], -10.0)[0]


def test_static_torque_is_a_share_of_the_motors_limit() -> None:
    import mujoco

    embodiment = load_embodiment("Panda-PandaGripper")
    data = mujoco.MjData(embodiment.model)
    data.qpos[:] = embodiment.home
    mujoco.mj_inverse(embodiment.model, data)  # at rest: what the motors must hold
    limit = np.array([80.0, 80, 80, 80, 80, 12, 12])
    np.testing.assert_allclose(embodiment.model.actuator_ctrlrange[:7, 1], limit)
    expected = np.abs(data.qfrc_inverse[:7] / limit).max()
    _, share = Clearance(embodiment).worst(embodiment.home[None], -10.0)
    assert share == pytest.approx(expected, rel=0.05)
    stretched = embodiment.home.copy()
    stretched[1], stretched[3] = 1.57, -0.1
    assert Clearance(embodiment).worst(stretched[None], -10.0)[1] > share


# -- report --------------------------------------------------------------------------------------------------


def test_report_of_a_perfect_track(problems: dict) -> None:
    problem = problems["Panda-PandaGripper"]
    lower, _ = problem.embodiment.independent_limits
    u = home(problem) + np.array([0, 0.1, 0.3])[:, None] * np.eye(8)[0]
    u[2, 7] = lower[7]  # closed
    points, normals = problem.place(u)
    track = NewtonSolver(problem, SolverOptions()).track(points, normals, u[0])
    track = replace(track, u=u, objective=np.full(3, -0.1))
    report = make_report(problem, points, normals, track, 0.05, 30.0)
    np.testing.assert_allclose(report.pad_distance_mm, 0, atol=1e-9)
    np.testing.assert_allclose(report.normal_angle_deg, 0, atol=1e-4)
    np.testing.assert_allclose(report.joint_step_rad, [0, 0.1, 0.2], atol=1e-12)
    np.testing.assert_array_equal(report.limit_hits, [1, 1, 2 - 1])  # open, open, closed
    assert report.unreachable_frames == []


def test_report_measures_distance_and_angle(problems: dict) -> None:
    problem = problems["Panda-PandaGripper"]
    u = np.tile(home(problem), (2, 1))
    points, normals = problem.place(u)
    centre = points.mean(axis=1, keepdims=True)
    # All pads of a gripper as one cloud far away: every match is nearly the shift long.
    track = NewtonSolver(problem, SolverOptions()).track(points, normals, u[0])
    track = replace(track, u=u)
    far = points + (np.arange(2)[:, None, None] * [0, 0, 1.0])
    report = make_report(problem, far, normals, track, 0.05, 30.0)
    assert report.pad_distance_mm[0] < 1e-9
    assert report.pad_distance_mm[1] == pytest.approx(1000, rel=0.02)
    assert report.unreachable_frames == [1]
    # Turned by 180 degrees about the vertical through the centre, normals are matched to the other finger.
    turned = np.array([-1.0, -1.0, 1.0])
    about = make_report(problem, centre + turned * (points - centre), turned * normals, track, 0.05, 30.0)
    assert about.normal_angle_deg.max() < 30
    opposite = make_report(problem, points, -normals, track, 0.0, 30.0)
    np.testing.assert_allclose(opposite.normal_angle_deg, 180, atol=1e-4)


def test_a_source_out_of_reach_is_reported(problems: dict) -> None:
    problem = problems["UR5e-RobotiqThreeFinger"]
    points, normals = panda_grasp(5)
    points[3:] += [1.0, 0.0, 0.5]
    u0 = find_basins(problem, SolverOptions(), points[0], normals[0], InitialisationOptions(starts=32, basins=1))[0]
    track = NewtonSolver(problem, SolverOptions()).track(points, normals, u0)
    report = make_report(problem, points, normals, track, 0.05, 30.0)
    assert report.unreachable_frames == [3, 4]
    assert report.pad_distance_mm[3:].min() > 100
    summary = report.summary()
    assert summary["pad_distance_mm_max"] == report.pad_distance_mm.max()
    assert summary["pad_distance_mm_mean"] == pytest.approx(report.pad_distance_mm.mean())
    assert summary["normal_angle_deg_mean"] == pytest.approx(report.normal_angle_deg.mean())
    assert summary["objective_m_mean"] == pytest.approx(track.objective.mean())
    assert summary["iterations_mean"] == pytest.approx(track.iterations.mean())
    assert summary["limit_hits_max"] == report.limit_hits.max()
    assert summary["joint_step_max_rad"] == pytest.approx(
        np.abs(np.diff(problem.embodiment.coupled.expand(track.u), axis=0)).max()
    )
    assert summary["unreachable_frames"] == [3, 4]


def test_the_stand_under_the_base_is_not_to_be_entered() -> None:
    """An oracle of its own: link origins well inside the column below the base must be reported as deep in it."""
    embodiment = load_embodiment("Panda-RobotiqThreeFinger")
    clearance = Clearance(embodiment)
    tree = KinematicTree(embodiment)
    rng = np.random.default_rng(0)
    qpos = embodiment.coupled.expand(
        rng.uniform(*embodiment.independent_limits, (4000, len(embodiment.coupled.independent)))
    )
    origins = tree.forward(qpos)[:, tree.arrays.body_joint >= 0][..., :3, 3]
    inside = np.any((np.linalg.norm(origins[..., :2], axis=-1) < 0.12) & (origins[..., 2] < -0.08), axis=1)
    assert inside.any()
    for q in qpos[inside][:5]:
        assert clearance.worst(q[None], -10.0)[0] > 0.05
    assert clearance.worst(embodiment.home[None], -10.0)[0] == 0.0
