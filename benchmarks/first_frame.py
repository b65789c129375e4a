"""First frames: how often each initialisation finds the best known basin, and how long it takes.

usage: python benchmarks/first_frame.py [--cases 500] [--seed 1000] [--results results/alignment]

A case is a random configuration of the Panda about its home pose and one of the sixteen targets, in turn. The best known
objective is the least that any method found, and a search of 2048 random starts with a seed of its own. A case counts as
found within 1 mm of that. The defaults were chosen on seeds 0-999.
"""

import argparse
import time
from pathlib import Path

import numpy as np
from measure import save
from rich.progress import track

from cei_gym.alignment import AlignmentProblem, InitialisationOptions, SolverOptions
from cei_gym.alignment.solvers.newton import NewtonSolver
from cei_gym.alignment.start.starts import find_basins, random_starts
from cei_gym.embodiment import ARMS, load_embodiment
from cei_gym.functional import directional_chamfer_distance, sample_representation
from cei_gym.kinematics import KinematicTree

SOURCE = "Panda-PandaGripper"
TARGETS = [f"{arm}-{e}" for e in ("FourierRight", "Inspire", "FourierLeft", "RobotiqThreeFinger") for arm in ARMS]
PAIRS = 64
FOUND_M = 1e-3
SEARCH_STARTS = 2048


def problem_of(name: str) -> AlignmentProblem:
    embodiment = load_embodiment(name)
    return AlignmentProblem(sample_representation(embodiment, PAIRS), KinematicTree(embodiment))


def random_frame(source: AlignmentProblem, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Pads of the source somewhere within half a radian of home, opened at random."""
    rng, embodiment = np.random.default_rng(seed), source.embodiment
    lower, upper = embodiment.independent_limits
    u = embodiment.coupled.reduce(embodiment.home) + rng.uniform(-0.5, 0.5, len(lower))
    u[-1] = rng.uniform(lower[-1], upper[-1])
    return source.place(np.clip(u, lower, upper))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cases", type=int, default=500)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--results", type=Path, default=Path("results/alignment"))
    args = parser.parse_args()
    source, options = problem_of(SOURCE), SolverOptions()
    problems = [problem_of(name) for name in TARGETS]
    methods = ("multistart", "eis, one draw (the paper)", "eis, 16 draws", "home")
    found = {method: [] for method in methods}
    seconds = {method: [] for method in methods}
    best = []
    find_basins(problems[0], options, *random_frame(source, 0), InitialisationOptions())  # compiles
    for case in track(range(args.cases), "cases"):
        problem, frame = problems[case % len(problems)], random_frame(source, args.seed + case)
        home = problem.embodiment.home.tolist()
        inits = (
            InitialisationOptions(seed=case),
            InitialisationOptions(method="eis", seed=case, draws=1, starts=1000),
            InitialisationOptions(method="eis", seed=case, draws=16),
            InitialisationOptions(method="given", qpos=home),
        )
        for method, init in zip(methods, inits, strict=True):
            start = time.perf_counter()
            u = find_basins(problem, options, *frame, init)[0]
            seconds[method].append(time.perf_counter() - start)
            found[method].append(directional_chamfer_distance(*frame, *problem.place(u), options.lambda_m))
        search = random_starts(problem, SEARCH_STARTS, [args.seed, case, 1])
        objective = NewtonSolver(problem, options).solve_starts(*frame, search, InitialisationOptions().iterations)[1]
        best.append(min(objective.min(), *(values[-1] for values in found.values())))
    rows = {}
    for method in methods:
        lag = np.array(found[method]) - np.array(best)
        rows[method] = {
            "found_percent": 100 * float(np.mean(lag < FOUND_M)),
            "lag_mm_mean": 1e3 * float(lag.mean()),
            "lag_mm_max": 1e3 * float(lag.max()),
            "seconds_mean": float(np.mean(seconds[method])),
            "seconds_p99": float(np.quantile(seconds[method], 0.99)),
            "seconds_max": float(np.max(seconds[method])),
            "missed": [
                {"target": TARGETS[i % len(TARGETS)], "seed": args.seed + int(i), "lag_mm": 1e3 * float(lag[i])}
                for i in np.flatnonzero(lag >= FOUND_M)
                if method == "multistart"
            ],
        }
        row = rows[method]
        print(
            f"{method:28} found {row['found_percent']:5.1f} %  behind by {row['lag_mm_mean']:6.3f} mm (worst ", end=""
        )
        print(
            f"{row['lag_mm_max']:.1f})  {row['seconds_mean']:.3f} s, p99 {row['seconds_p99']:.3f}, max {row['seconds_max']:.3f}"
        )
    result = {
        "command": f"python benchmarks/first_frame.py --cases {args.cases} --seed {args.seed}",
        "found_within_mm": 1e3 * FOUND_M,
        "pairs": PAIRS,
        "cases": args.cases,
        "seeds": [args.seed, args.seed + args.cases - 1],
        "methods": rows,
    }
    save(args.results / "first_frame.json", result)


if __name__ == "__main__":
    main()
