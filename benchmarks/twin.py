"""How often the twin of a recording agrees with the environment, beside the ceiling: the environment's own perturbed replays.

usage: python benchmarks/twin.py [--things Cube,Sphere,Nut] [--targets UR5e-FourierRight,IIWA-Inspire] [--seeds 3,4] [--results FOLDER] [--name twin]

Each thing is picked up by the source, recorded with clean depth (the seeds) and with a Kinect's (the seeds + 500), and moved to each target as it is, and
once more by a hand that is off at random, so that some fail. Seeds are those of development, below 1000, or fresh ones of a report, from 2000 on.
"""

import argparse
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from measure import save

from cei_converters.conversion.evidence import EvidenceOptions, Witness
from cei_converters.simulation.environment import open_environment
from cei_converters.simulation.perturbation import perturbations
from cei_converters.simulation.rollout import record_episode
from cei_converters.simulation.stage import Stage
from cei_gym.alignment.contact.correction import Correction
from cei_gym.demonstration import Demonstration
from cei_gym.embodiment import load_embodiment
from cei_gym.transfer import Attempt, Transfer

THINGS = "Cube,Sphere,Nut,Plate,Hammer,LyingCylinder,Mug,Can,ThinBox,Lemon"
TARGETS = "UR5e-FourierRight,IIWA-Inspire,Panda-RobotiqThreeFinger"
NOISE, NOISY_FROM = "kinect", 500
FRESH_FROM = 2000
OFF = 2.0 * np.array([0.005, 0.005, 0.005, 0.08, 0.08, 0.12])  # m and rad: twice what refinement draws
SHAKEN = 3


def environment(thing: str, robot: str) -> str:
    return f"CEI-{'PickCube' if thing == 'Cube' else f'Pick-{thing}'}-{robot}"


def recorded(thing: str, source: str, seeds: list[int]) -> list[tuple[str, Demonstration]]:
    """Demonstrations that succeed, with the kind of depth."""
    found = []
    for noise, first in ((None, 0), (NOISE, NOISY_FROM)):
        env = open_environment(environment(thing, source), depth_noise=noise)
        for seed in seeds:
            demonstration, info, _ = record_episode(env, first + seed, first + seed)
            if info["is_success"]:
                found.append((noise or "clean", demonstration))
        env.close()
    return found


def judged(transfer: Transfer, stage: Stage, witness: Witness, demonstration: Demonstration) -> list[dict[str, Any]]:
    """What the environment and the twin say of a demonstration that is moved plainly, and by a hand that is off."""
    drawn = np.random.default_rng([demonstration.index, 7]).normal(size=len(OFF)) * OFF
    aligned, rows = transfer.aligned(demonstration), []
    for way, attempt in (("plain", Attempt()), ("off", Attempt(correction=Correction(*drawn)))):
        moved, _ = transfer.made(aligned, attempt, clouds=False)
        moved = replace(moved, qpos=moved.qpos.astype(np.float32).astype(float))
        begun = time.process_time()
        evidence = witness(aligned, moved)
        cpu_s = time.process_time() - begun
        shaken = [
            bool(stage.play(moved, perturbation=each)[0]["success"])
            for each in perturbations(moved, SHAKEN, stage.n_arm)
        ]
        truth = bool(stage.play(moved)[0]["success"])
        rows.append({"way": way, "truth": truth, "shaken": shaken, "cpu_s": cpu_s, **evidence.record()})
    return rows


def line(name: str, rows: list[dict[str, Any]]) -> str:
    """Agreement of some episodes."""
    answered = [row for row in rows if row["answer"] in ("holds", "fails")]
    right = sum((row["answer"] == "holds") == row["truth"] for row in answered)
    accepts = [row["answer"] == "holds" for row in answered if not row["truth"]]
    rejects = [row["answer"] == "fails" for row in answered if row["truth"]]
    ceiling = [(sum(row["shaken"]) > SHAKEN / 2) == row["truth"] for row in rows]
    return (
        f"| {name} | {len(rows)} | {sum(not row['truth'] for row in rows)} | {len(answered) / len(rows):.0%} "
        f"| {right}/{len(answered)} | {sum(accepts)}/{len(accepts)} | {sum(rejects)}/{len(rejects)} "
        f"| {np.mean(ceiling):.0%} | {np.mean([row['cpu_s'] for row in rows]):.1f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--source", default="Panda-PandaGripper")
    parser.add_argument("--things", default=THINGS)
    parser.add_argument("--targets", default=TARGETS)
    parser.add_argument("--seeds", default="3,4")
    parser.add_argument("--results", type=Path, help="folder for a JSON; default: printed only")
    parser.add_argument("--name", default="twin", help="of the JSON, without its suffix")
    args = parser.parse_args()
    seeds = [int(seed) for seed in args.seeds.split(",")]
    if not all(0 <= seed - first < NOISY_FROM for first in [FRESH_FROM * (seeds[0] >= FRESH_FROM)] for seed in seeds):
        raise SystemExit(
            f"--seeds are from 0 to {NOISY_FROM - 1}, or all from {FRESH_FROM} to {FRESH_FROM + NOISY_FROM - 1}; those of noisy depth are {NOISY_FROM} higher."
        )
    things, rows = args.things.split(","), []
    demonstrations = {thing: recorded(thing, args.source, seeds) for thing in things}
    for target in args.targets.split(","):
        transfer = Transfer(load_embodiment(args.source), load_embodiment(target))
        witness = Witness(transfer, EvidenceOptions(enabled=True))
        transfer.fit([d for found in demonstrations.values() for _, d in found[:1]])
        for thing in things:
            with Stage(environment(thing, target)) as stage:
                for depth, demonstration in demonstrations[thing]:
                    known = {"thing": thing, "target": target, "depth": depth, "seed": demonstration.index}
                    rows += [known | row for row in judged(transfer, stage, witness, demonstration)]
    print("| | episodes | fail | judged | right | false accepts | false rejects | ceiling right | CPU s |")
    print("|---|---|---|---|---|---|---|---|---|")
    for column in ("thing", "target", "depth", "way"):
        for name in dict.fromkeys(row[column] for row in rows):
            print(line(name, [row for row in rows if row[column] == name]))
    print(line("all", rows))
    for reason, count in Counter(row["reason"] for row in rows if "reason" in row).items():
        print(f"cannot be judged: {reason}: {count}")
    if args.results is not None:
        save(args.results / f"{args.name}.json", {"rows": rows}, seeds=[min(seeds), NOISY_FROM + max(seeds)])


if __name__ == "__main__":
    main()
