"""The batched solver in torch: the compiled solver is the oracle."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from problems import home, problem_of

from cei_gym.alignment import (
    ClearanceOptions,
    InitialisationOptions,
    Motion,
    SolverOptions,
    Surroundings,
    Track,
    make_solver,
)
from cei_gym.alignment.follow import Follower
from cei_gym.alignment.links import link_shapes
from cei_gym.alignment.solvers.newton import NewtonSolver
from cei_gym.alignment.solvers.newton_torch import TorchNewtonSolver
from cei_gym.alignment.solvers.paper import PaperSolver
from cei_gym.alignment.start.starts import find_basins
from cei_gym.errors import CEIError
from cei_gym.functional import directional_chamfer_distance

NAMES = ("UR5e-FourierRight", "IIWA-Inspire", "Kinova3-FourierLeft", "Panda-RobotiqThreeFinger")
OPTIONS = SolverOptions(device="cpu")
DT_S = 0.05


@pytest.fixture(autouse=True)
def _one_thread():
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    yield
    torch.set_num_threads(threads)


def panda_grasp(frames: int = 12, points: int = 32, lower_m: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """The Panda's pads go down and close, in its base frame, and lower still by `lower_m`."""
    problem = problem_of("Panda-PandaGripper", points)
    s = np.linspace(0, 1, frames)[:, None]
    placed, normals = problem.place(home(problem) + s * [0.05, 0.1, 0, -0.05, 0, 0.1, 0, -0.015])
    return placed - s[:, :, None] * [0, 0, lower_m], normals


@cache
def start(name: str, lambda_m: float = 0.05) -> np.ndarray:
    points, normals = panda_grasp()
    init = InitialisationOptions(starts=32, basins=1)
    return find_basins(problem_of(name), SolverOptions(lambda_m=lambda_m), points[0], normals[0], init)[0]


def arguments(motion: Motion) -> dict:
    """What `Solver.track` takes of a motion: all but what the source grips, which is not the solver's business."""
    return {name: value for name, value in vars(motion).items() if name != "grip"}


def both(name: str, options: SolverOptions, motion: Motion) -> tuple[Track, Track]:
    """The track of the compiled solver and of this one."""
    problem = problem_of(name)
    compiled, batched = (make_solver(problem, replace(options, backend=b)) for b in ("numba", "torch"))
    assert isinstance(batched, TorchNewtonSolver)
    return compiled.track(**arguments(motion)), batched.track(**arguments(motion))


def assert_alike(one: Track, other: Track) -> None:
    """A frame whose matches tie may go either way: hence not to the last digit."""
    apart = np.abs(one.objective - other.objective)
    assert apart.max() < 1e-3
    assert apart.mean() < 1e-5
    assert abs(one.iterations.mean() - other.iterations.mean()) < 1


# -- derivatives ---------------------------------------------------------------------------------------------


@settings(max_examples=25, deadline=None)
@given(
    name=st.sampled_from((*NAMES, "Panda-PandaGripper")),
    lambda_m=st.sampled_from((0.0, 0.05, 0.5)),
    seed=st.integers(0, 2**31),
)
def test_derivatives_are_those_of_the_compiled_solver(name: str, lambda_m: float, seed: int) -> None:
    problem, options = problem_of(name), replace(OPTIONS, lambda_m=lambda_m)
    rng = np.random.default_rng(seed)
    u = rng.uniform(*problem.embodiment.independent_limits)
    n = rng.integers(1, 33)
    points, normals = (x[seed % 12][:n] for x in panda_grasp())
    found = TorchNewtonSolver(problem, options).derivatives(points, normals, u)
    for one, other in zip(found, NewtonSolver(problem, options).derivatives(points, normals, u), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-9, atol=1e-9)


# -- tracks --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("lambda_m", [0.05, 0.5])
@pytest.mark.parametrize("name", NAMES)
def test_tracks_are_those_of_the_compiled_solver(name: str, lambda_m: float) -> None:
    options = replace(OPTIONS, lambda_m=lambda_m)
    points, normals = panda_grasp()
    one, other = both(name, options, Motion(points, normals, start(name, lambda_m), dt_s=DT_S))
    assert_alike(one, other)
    expected = directional_chamfer_distance(points, normals, *problem_of(name).place(other.u), lambda_m)
    np.testing.assert_allclose(other.objective, expected, atol=1e-9)


@pytest.mark.parametrize(
    "options", [{"smoothness_weight": 0.1}, {"temporal_weight": 0.0}, {"iterations": 3}, {"iterations": 0}]
)
def test_options_mean_what_they_mean_to_the_compiled_solver(options: dict) -> None:
    motion = Motion(*panda_grasp(8), start("IIWA-Inspire"))
    assert_alike(*both("IIWA-Inspire", replace(OPTIONS, **options), motion))


def test_a_batch_is_its_trajectories_one_at_a_time() -> None:
    """Of different lengths, numbers of points, budgets and speeds, with and without surroundings."""
    name = "IIWA-Inspire"
    solver, u0 = TorchNewtonSolver(problem_of(name), OPTIONS), start(name)
    table = Surroundings(panda_grasp(5)[0][..., 2].min() + 0.005)
    motions = [
        Motion(*panda_grasp(6), u0, dt_s=DT_S),
        Motion(*panda_grasp(2), u0 + 0.05),
        Motion(*panda_grasp(3, points=20), u0, iterations=4),
        Motion(*panda_grasp(1), u0, iterations=100, dt_s=0.01),
        Motion(*panda_grasp(5), u0, surroundings=table),
        Motion(*panda_grasp(4), u0 - 0.05, dt_s=0.01),
    ]
    tracks = solver.track_all(motions)
    assert [len(t.u) for t in tracks] == [6, 2, 3, 1, 5, 4]
    for motion, track in zip(motions, tracks, strict=True):
        alone = solver.track(**arguments(motion))
        np.testing.assert_allclose(track.u, alone.u, atol=1e-6)
        np.testing.assert_allclose(track.objective, alone.objective, atol=1e-8)
    assert (tracks[2].iterations <= 4).all()
    assert solver.track_all([]) == []


def test_starts_are_solved_as_by_the_compiled_solver() -> None:
    problem = problem_of("UR5e-FourierRight")
    points, normals = (x[0] for x in panda_grasp())
    starts = start("UR5e-FourierRight") + np.random.default_rng(0).uniform(-0.2, 0.2, (24, len(home(problem))))
    u, objective = TorchNewtonSolver(problem, OPTIONS).solve_starts(points, normals, starts, 20)
    expected_u, expected = NewtonSolver(problem, OPTIONS).solve_starts(points, normals, starts, 20)
    assert u.shape == expected_u.shape
    # Far from a solution, a tie decides where one leads: nearly all agree.
    assert np.median(np.abs(objective - expected)) < 1e-6
    assert abs(objective.mean() - expected.mean()) < 1e-3


@pytest.mark.parametrize("options", [{}, {"smoothness_weight": 0.1}])
def test_frame_by_frame_it_is_the_track(options: dict) -> None:
    name, (points, normals) = "IIWA-Inspire", panda_grasp(5)
    solver = TorchNewtonSolver(problem_of(name), replace(OPTIONS, **options))
    track = solver.track(points, normals, start(name), dt_s=DT_S)
    before = last = track.u[0]
    for t in range(1, 5):
        before, last = last, solver.advance(points[t], normals[t], last, before, DT_S)
        np.testing.assert_allclose(last, track.u[t], atol=1e-9)


# -- limits --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["UR5e-FourierRight", "Panda-RobotiqThreeFinger"])
def test_no_joint_is_faster_than_it_can(name: str) -> None:
    solver, embodiment = TorchNewtonSolver(problem_of(name), OPTIONS), problem_of(name).embodiment
    points, normals = panda_grasp(5)
    allowed = embodiment.independent_max_velocity * 0.01
    held = solver.track(points, normals, start(name), dt_s=0.01).u
    steps = np.abs(np.diff(held, axis=0))
    assert (steps <= allowed + 1e-12).all()
    assert (steps > 0.999 * allowed).any()
    free = solver.track(points, normals, start(name)).u
    assert (np.abs(np.diff(free, axis=0)) > 1.5 * allowed).any()
    half = TorchNewtonSolver(problem_of(name), replace(OPTIONS, velocity_scale=0.5))
    assert (np.abs(np.diff(half.track(points, normals, start(name), dt_s=0.01).u, axis=0)) <= allowed / 2 + 1e-12).all()
    assert_alike(*both(name, OPTIONS, Motion(points, normals, start(name), dt_s=0.01)))


@pytest.mark.parametrize("shift_m", [(0.0, 0.0, -0.3), (2.0, 0.0, 0.0), (0.0, 0.0, 2.0)])
def test_limits_hold_where_the_source_is_out_of_reach(shift_m: tuple) -> None:
    problem = problem_of("UR5e-FourierRight")
    lower, upper = problem.embodiment.independent_limits
    points, normals = panda_grasp(3)
    motion = Motion(points + shift_m, normals, upper + 0.5)  # a start outside is brought in, too
    compiled, track = both("UR5e-FourierRight", OPTIONS, motion)
    assert (track.u >= lower).all()
    assert (track.u <= upper).all()
    assert track.objective[-1] < compiled.objective[-1] + 0.05


# -- clearance -----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["IIWA-Inspire", "Panda-RobotiqThreeFinger"])
def test_clearance_is_kept_as_by_the_compiled_solver(name: str) -> None:
    problem = problem_of(name)
    points, normals = panda_grasp(8, lower_m=0.03)
    table = Surroundings(points[..., 2].min() + 0.01)  # the source's pads dip into it by 1 cm
    free = TorchNewtonSolver(problem, OPTIONS).track(points, normals, start(name), dt_s=DT_S)
    compiled, held = both(name, OPTIONS, Motion(points, normals, start(name), dt_s=DT_S, surroundings=table))
    assert_alike(compiled, held)

    def depth(u: np.ndarray) -> float:
        return float(table.support_z_base_m - problem.place(u)[0][..., 2].min())

    assert depth(free.u) > 0.007
    assert depth(held.u) < 0.003
    assert abs(depth(held.u) - depth(compiled.u)) < 1e-4
    ignored = replace(OPTIONS, clearance=ClearanceOptions(weight=0))
    motion = Motion(points, normals, start(name), dt_s=DT_S, surroundings=table)
    np.testing.assert_allclose(both(name, ignored, motion)[1].objective, free.objective, atol=1e-6)


def test_idle_fingers_get_out_of_the_way_as_with_the_compiled_solver() -> None:
    name = "IIWA-Inspire"
    problem = problem_of(name)
    points, normals = panda_grasp(5)
    solver = TorchNewtonSolver(problem, OPTIONS)
    free = solver.track(points, normals, start(name))
    shapes, body = link_shapes(problem.embodiment), problem.embodiment.body_id("r_pinky_distal")
    centre = shapes.vertices_link[int(np.flatnonzero(shapes.body == body)[0])].mean(axis=0)
    T = problem.tree.forward(problem.embodiment.coupled.expand(free.u[-1]))[body]
    rng = np.random.default_rng(0)
    # Balls in the fingertip where the trajectory ends, of as many points as there happen to be; in one frame none.
    sizes = 20, 7, 0, 20, 30
    blobs = [(centre + rng.normal(0, 0.002, (n, 3))) @ T[:3, :3].T + T[:3, 3] for n in sizes]
    motion = Motion(points, normals, start(name), surroundings=Surroundings(-1.0, blobs))
    compiled, held = both(name, OPTIONS, motion)
    assert_alike(compiled, held)
    np.testing.assert_allclose(held.u, compiled.u, atol=1e-3)
    names = [problem.embodiment.joint_names[i] for i in problem.embodiment.coupled.independent]
    pinky = names.index("joint_r_pinky_proximal")
    assert np.ptp(free.u[:, pinky]) == 0
    assert abs(held.u[-1, pinky] - free.u[-1, pinky]) > 0.05
    follower = Follower(problem, OPTIONS)
    assert follower.shortfall_m(motion, free.u)[-1] > 0.005
    assert follower.shortfall_m(motion, held.u)[-1] < 0.002


# -- device --------------------------------------------------------------------------------------------------


def test_a_device_that_is_not_there_is_refused() -> None:
    problem = problem_of("Panda-PandaGripper")
    with pytest.raises(CEIError, match="Did you mean 'cuda'\\? Valid: auto, cpu, cuda, mps"):
        TorchNewtonSolver(problem, SolverOptions(device="cuda1"))
    for device, here in (("cuda", torch.cuda.is_available()), ("mps", torch.backends.mps.is_available())):
        for solver in (TorchNewtonSolver, PaperSolver) if not here else ():
            with pytest.raises(CEIError, match=f"solver.device={device}"):
                solver(problem, SolverOptions(device=device))


@pytest.mark.skipif(not torch.cuda.is_available(), reason="no CUDA device")
def test_a_gpu_finds_the_same() -> None:
    name = "IIWA-Inspire"
    points, normals = panda_grasp()
    table = Surroundings(points[..., 2].min() + 0.01, [points[0, :9]] * 12)
    for surroundings in (None, table):
        motion = Motion(points, normals, start(name), dt_s=DT_S, surroundings=surroundings)
        assert_alike(*both(name, replace(OPTIONS, device="auto"), motion))
