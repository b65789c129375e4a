"""What lambda, the weight of direction in the Directional Chamfer Distance, does to the pads of a target.

usage: python benchmarks/direction_weight.py

Four demonstrations of the scripted Panda expert (development seeds 0-3), moved to four targets; writes
results/alignment/direction_weight.csv: mean pad distance and normal angle by lambda (metres).
"""

import argparse
import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
from measure import say_of

from cei_converters.simulation.environment import open_environment
from cei_converters.simulation.rollout import record_episode
from cei_gym.alignment import SolverOptions
from cei_gym.embodiment import load_embodiment
from cei_gym.transfer import Transfer

SOURCE = "Panda-PandaGripper"
TARGETS = ("UR5e-FourierRight", "IIWA-Inspire", "Kinova3-FourierLeft", "Panda-RobotiqThreeFinger")
LAMBDAS_M = (0.0, 0.05, 0.1, 0.5)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", default=TARGETS)
    parser.add_argument("--demonstrations", type=int, default=4)
    parser.add_argument("--results", type=Path, default=Path("results/alignment"))
    args = parser.parse_args()
    env = open_environment(f"CEI-PickCube-{SOURCE}")
    episodes = [record_episode(env, seed, seed)[0] for seed in range(args.demonstrations)]
    demonstrations = [replace(e, depth_m={}, point_cloud_world=None) for e in episodes]
    args.results.mkdir(parents=True, exist_ok=True)
    with (args.results / "direction_weight.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["target", "lambda_m", "pad_distance_mm", "normal_angle_deg"])
        for target in args.targets:
            for lambda_m in LAMBDAS_M:
                solver = SolverOptions(lambda_m=lambda_m)
                transfer = Transfer(load_embodiment(SOURCE), load_embodiment(target), solver=solver)
                transfer.fit(demonstrations)
                reports = [transfer(demonstration)[1] for demonstration in demonstrations]
                distance = np.mean([r.pad_distance_mm.mean() for r in reports])
                angle = np.mean([r.normal_angle_deg.mean() for r in reports])
                row = [target, lambda_m, f"{distance:.1f}", f"{angle:.1f}"]
                writer.writerow(row)
                print(*row)
    say_of(args.results, ["direction_weight.csv"], [0, args.demonstrations - 1])


if __name__ == "__main__":
    main()
