"""Where frame 0 starts: multi-start, elite means, given joints, whole turns, and several modes."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import home, problem_of
from scipy.spatial.transform import Rotation

from cei_gym.alignment import InitialisationOptions, Motion, SolverOptions, make_solver
from cei_gym.alignment.follow import Follower
from cei_gym.alignment.grip import Grip
from cei_gym.alignment.problem import Track
from cei_gym.alignment.solvers.newton import NewtonSolver
from cei_gym.alignment.start.basins import Basin, choose_modes, judge, judge_basins, kinds, ranked
from cei_gym.alignment.start.starts import elite_starts, find_basins, random_starts, unwrap
from cei_gym.demonstration import Demonstration, Scene
from cei_gym.errors import CEIError
from cei_gym.functional import directional_chamfer_distance
from cei_gym.kinematics import KinematicTree
from cei_gym.transfer import Transfer, TransferOptions

OPTIONS = SolverOptions()


def panda_frame(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """The Panda's pads somewhere about its home pose."""
    problem = problem_of("Panda-PandaGripper")
    u = home(problem) + np.random.default_rng(seed).uniform(-0.3, 0.3, 8)
    lower, upper = problem.embodiment.independent_limits
    return problem.place(np.clip(u, lower, upper))


def drawer_joints(frames: int = 30) -> np.ndarray:
    """(T, 8) OpenDrawer-like: the Panda, its pads one above the other about a handle, draws back by some 15 cm."""
    problem = problem_of("Panda-PandaGripper")
    start = np.array([0.0, 0.55, 0.0, -2.0, 0.0, 4.1, 0.785, 0.015])
    end = np.array([0.0, 0.05, 0.0, -2.5, 0.0, 4.1, 0.785, 0.015])
    s = np.linspace(0, 1, frames)[:, None]
    lower, upper = problem.embodiment.independent_limits
    return np.clip(start + s * (end - start), lower, upper)


def drawer_pull() -> tuple[np.ndarray, np.ndarray]:
    """What its pads do."""
    return problem_of("Panda-PandaGripper").place(drawer_joints())


# -- multi-start ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "name", ["UR5e-FourierRight", "IIWA-Inspire", "Kinova3-FourierLeft", "Panda-RobotiqThreeFinger"]
)
def test_a_few_starts_find_what_many_find(name: str) -> None:
    problem = problem_of(name)
    for seed in range(2):
        frame = panda_frame(seed)
        many = NewtonSolver(problem, OPTIONS).solve_starts(*frame, random_starts(problem, 2000, 99), 30)[1].min()
        found = find_basins(problem, OPTIONS, *frame, InitialisationOptions())[0]
        assert directional_chamfer_distance(*frame, *problem.place(found), OPTIONS.lambda_m) < many + 1e-3


@settings(max_examples=15, deadline=None)
@given(turns=st.lists(st.integers(-1, 1), min_size=6, max_size=6), seed=st.integers(0, 1000))
def test_whole_turns_are_taken_out_and_pads_stay(turns: list[int], seed: int) -> None:
    problem = problem_of("UR5e-Inspire")  # +-2 pi limits but for the elbow
    u = random_starts(problem, 1, seed)
    lower, upper = problem.embodiment.independent_limits
    wound = u.copy()
    wound[:, :6] += 2 * np.pi * np.array(turns)
    fits = (wound >= lower) & (wound <= upper)
    wound = np.where(fits, wound, u)
    back = unwrap(problem, wound)
    np.testing.assert_allclose(back, u, atol=1e-12)
    np.testing.assert_allclose(problem.place(back)[0], problem.place(wound)[0], atol=1e-9)


def test_no_basin_is_wound_up() -> None:
    problem = problem_of("UR5e-Inspire")
    found = find_basins(problem, OPTIONS, *panda_frame(3), InitialisationOptions())
    assert len(found) > 4
    free = np.array([0, 1, 3, 4, 5])  # the elbow's limits leave no room for a turn
    assert np.abs(found - home(problem))[:, free].max() < np.pi + 1e-9


# -- the paper's elite means ---------------------------------------------------------------------------------


def test_an_elite_mean_is_the_mean_of_the_best_tenth() -> None:
    problem, frame = problem_of("UR5e-RobotiqThreeFinger"), panda_frame(0)
    options = InitialisationOptions(method="eis", starts=60, draws=2, seed=5)
    means = elite_starts(problem, NewtonSolver(problem, OPTIONS), *frame, options)
    for draw in range(2):
        u = random_starts(problem, 60, [5, draw])
        scores = [directional_chamfer_distance(*frame, *problem.place(x), OPTIONS.lambda_m) for x in u]
        np.testing.assert_allclose(means[draw], u[np.argsort(scores)[:6]].mean(axis=0), atol=1e-12)


def test_elite_means_are_seeded_and_lead_to_several_basins() -> None:
    problem, frame = problem_of("UR5e-FourierRight"), panda_frame(0)
    options = InitialisationOptions(method="eis", starts=128, draws=24)
    found = find_basins(problem, OPTIONS, *frame, options)
    np.testing.assert_array_equal(found, find_basins(problem, OPTIONS, *frame, options))
    assert len(found) >= 2
    other = find_basins(problem, OPTIONS, *frame, replace(options, seed=1))
    assert other.shape != found.shape or not np.allclose(other, found)


# -- given ---------------------------------------------------------------------------------------------------


def test_given_joints_are_where_the_solution_starts() -> None:
    problem = problem_of("IIWA-Inspire")
    solver, frame = make_solver(problem, OPTIONS), panda_frame(1)
    goal = find_basins(problem, OPTIONS, *frame, InitialisationOptions())[3]
    qpos = problem.embodiment.coupled.expand(goal + 0.02 * (home(problem) - goal))
    found = find_basins(problem, OPTIONS, *frame, InitialisationOptions(method="given", qpos=qpos.tolist()))
    assert len(found) == 1
    assert np.abs(found[0] - goal).max() < 0.3
    assert solver.track(*(x[None] for x in frame), found[0]).objective[0] < 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"method": "elite"}, "unknown init.method 'elite'. Valid: multistart, eis, given."),
        ({"modes": 0}, "init.modes=0 must be at least 1."),
        ({"method": "given"}, "init.method=given and init.qpos go together: give both or neither."),
        ({"qpos": [0.0]}, "init.method=given and init.qpos go together: give both or neither."),
        (
            {"method": "given", "qpos": [0.0], "modes": 2},
            "init.method=given starts one motion; init.modes=2 asks for more.",
        ),
    ],
)
def test_bad_options_are_refused(changes: dict, message: str) -> None:
    with pytest.raises(CEIError) as error:
        InitialisationOptions(**changes)
    assert str(error.value) == message


def test_given_joints_must_fit_the_target() -> None:
    problem, frame = problem_of("UR5e-RobotiqThreeFinger"), panda_frame(0)
    with pytest.raises(
        CEIError, match=r"init\.qpos has 2 values; UR5e-RobotiqThreeFinger has 17 joints: shoulder_pan_joint"
    ):
        find_basins(problem, OPTIONS, *frame, InitialisationOptions(method="given", qpos=[0.0, 0.0]))
    qpos = problem.embodiment.home.copy()
    qpos[2] = 9.0
    with pytest.raises(CEIError, match=r"init.qpos puts elbow_joint at 9, outside \[-3.142, 3.142\] rad"):
        find_basins(problem, OPTIONS, *frame, InitialisationOptions(method="given", qpos=qpos.tolist()))


# -- modes (section VII-B) -----------------------------------------------------------------------------------


@pytest.mark.parametrize("method", ["multistart", "eis"])
@pytest.mark.parametrize("name", ["UR5e-FourierRight", "IIWA-Inspire"])
def test_a_drawer_opens_in_two_ways(name: str, method: str) -> None:
    """Two modes asked for: both follow, both are free of contact, and they differ all the way."""
    problem, (points, normals) = problem_of(name), drawer_pull()
    follower = Follower(problem, OPTIONS)
    motion = Motion(points, normals, home(problem), dt_s=0.05)
    starts = find_basins(problem, OPTIONS, points[0], normals[0], InitialisationOptions(method=method))
    modes = choose_modes(judge_basins(follower, [motion], starts), 2)
    tracks = [follower.follow(replace(motion, u0=mode.u)) for mode in modes]
    one, two = (track.u for track in tracks)
    assert np.abs(one - two).max(axis=1).min() > 0.4
    root = problem.embodiment.end_effector_root
    hands = [problem.tree.forward(problem.embodiment.coupled.expand(u))[:, root, :3, :3] for u in (one, two)]
    turned = (Rotation.from_matrix(hands[0]) * Rotation.from_matrix(hands[1]).inv()).magnitude()
    assert turned.min() > np.radians(45)  # it is the hand that does something else
    lower, upper = problem.embodiment.independent_limits
    for mode, track in zip(modes, tracks, strict=True):
        assert ((track.u >= lower) & (track.u <= upper)).all()
        pads, _ = problem.place(track.u)
        assert np.linalg.norm(pads.mean(1) - points.mean(1), axis=-1).max() < 0.02
        travelled = np.linalg.norm(pads[-1].mean(0) - pads[0].mean(0))
        assert travelled == pytest.approx(np.linalg.norm(points[-1].mean(0) - points[0].mean(0)), abs=0.01)
        assert mode.penetration_m < 0.005
        assert np.abs(np.diff(track.u, axis=0)).max() < 0.16


def basin(yaw_deg: float, last_deg: float, cost: float, x_m: float = 0.0) -> Basin:
    """One whose hand is turned about the vertical, where the motion starts and where it ends, or stands elsewhere."""
    hands = np.tile(np.eye(4), (2, 1, 1))
    hands[:, :3, :3] = Rotation.from_euler("z", [[yaw_deg], [last_deg]], degrees=True).as_matrix()
    hands[:, 0, 3] = x_m
    return Basin(np.zeros(1), np.array([cost]), cost, cost, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, hands)


def test_modes_differ_in_what_hands_do_at_both_ends_and_cost_about_the_same() -> None:
    best = basin(0, 0, 0.0)
    merges, worse, other = basin(120, 5, 0.001), basin(180, 180, 0.5), basin(170, 175, 0.002)
    assert choose_modes([best, merges, other, worse], 2) == [best, other]
    with pytest.raises(CEIError, match=r"init\.modes=3, but only 2 distinct good motions were found"):
        choose_modes([best, merges, other, worse], 3)
    away = basin(0, 0, 0.003, x_m=0.2)
    assert choose_modes([best, merges, other, away], 3) == [best, other, away]


def test_one_demonstration_that_goes_wrong_does_not_rule_out_what_is_best_for_all_others() -> None:
    """It costs as much as going another way does, 5 cm more than what that costs."""
    good, even = (
        replace(basin(0, 0, np.mean(costs)), costs=np.array(costs))
        for costs in ([0.0, 0.0, 0.0, 5.0], [0.02, 0.02, 0.02, 0.02])
    )
    found = ranked([even, good])
    np.testing.assert_array_equal([each.costs for each in found], [good.costs, even.costs])
    np.testing.assert_allclose([each.cost for each in found], [0.07 / 4, 0.02])


def test_basins_are_of_a_kind_where_hands_meet() -> None:
    best, near, merges, other = basin(0, 0, 0.0), basin(30, 30, 0.1), basin(120, 5, 0.2), basin(180, 180, 0.3)
    assert kinds([best, near, merges, other]) == [[best, near, merges], [other]]


def test_a_hand_that_comes_from_the_other_side_than_the_sources_costs_more() -> None:
    problem = problem_of("UR5e-PandaGripper")
    follower, u = Follower(problem, OPTIONS), home(problem)
    points, normals = (np.tile(each, (4, 1, 1)) for each in problem.place(u))
    root = problem.tree.forward(problem.embodiment.coupled.expand(u))[problem.embodiment.end_effector_root, :3, 3]
    away, costs = root - points[0].mean(axis=0), []
    for side in (1, -1):
        at = np.tile(points[0].mean(axis=0) + side * away, (4, 1))
        grip = Grip(
            np.tile([1.0, 0, 0], (4, 1)), np.zeros((4, 2, 3)), at, np.tile(np.eye(3), (4, 1, 1)), np.zeros(4, bool)
        )
        motion = Motion(points, normals, u, dt_s=0.05, grip=grip)
        found = judge(follower, [motion], u, [Track(np.tile(u, (4, 1)), np.zeros(4), np.zeros(4))])
        assert found.side == pytest.approx((1 - side) / 2, abs=1e-6)
        costs.append(found.cost)
    assert costs[1] - costs[0] == pytest.approx(0.01, abs=1e-6)


def test_a_demonstration_that_goes_wrong_goes_on_in_the_same_way() -> None:
    """Nothing is within a micrometre: each of the two ways would be left for the cheaper one, if that were allowed."""
    source, target = (problem_of(name).embodiment for name in ("Panda-PandaGripper", "UR5e-FourierRight"))
    qpos = source.coupled.expand(drawer_joints())
    scene = Scene(np.eye(4), (), np.array([[-1.0, -1.0, 0.0], [1.2, 1.2, 1.2]]))
    demonstration = Demonstration(source.name, 20.0, qpos, qpos, scene)
    both = Transfer(source, target, init=InitialisationOptions(modes=2))
    both.fit([demonstration])
    for own, other in (both.basins, both.basins[::-1]):
        one = Transfer(source, target, TransferOptions(unreachable_mm=1e-3))
        one.start_from([own, other])
        made, report = one(demonstration)
        assert len(report.unreachable_frames) == len(made)
        hand = KinematicTree(target).forward(made.qpos[0])[target.end_effector_root, :3, :3]
        turned = Rotation.from_matrix(hand) * Rotation.from_matrix(own.hands_base[0, :3, :3]).inv()
        assert np.degrees(turned.magnitude()) < 60


def test_what_physics_may_try_next_is_of_the_kind_where_there_are_modes() -> None:
    source, target = (problem_of(name).embodiment for name in ("Panda-PandaGripper", "UR5e-FourierRight"))
    finalists = [basin(0, 0, 0.0), basin(170, 175, 0.001), basin(20, 0, 0.002), basin(180, 180, 0.003)]
    for modes, tried in ((2, {0: [2], 1: [3]}), (1, {0: [1, 2, 3]})):
        transfer = Transfer(source, target, init=InitialisationOptions(modes=modes))
        transfer.start_from(finalists)
        for mode, expected in tried.items():
            assert [a.basin for a in transfer.attempts(20, mode) if a.basin is not None] == expected
