"""Replay success of transferred demonstrations: record on a Panda, convert to each target, replay in physics.

usage: python benchmarks/replay.py [--seed 1000] [--episodes 20] [--results results/replay] [EMBODIMENT ...]

One JSON a target (finished ones are skipped, so it resumes), and a table over all of them with the paper's figure.
Datasets go to outputs/replay-benchmark. Development seeds are 0-999; figures are reported on 1000 and up.
"""

import argparse
import csv
import json
import shutil
from pathlib import Path

from cei_converters.cli import DatasetConfig, quiet_libraries
from cei_converters.convert import ConvertConfig, convert
from cei_converters.metadata import plain
from cei_converters.provenance import git_commit, versions
from cei_converters.record import RecordConfig, record
from cei_converters.replay import ReplayConfig, replay
from cei_converters.report import physics_exceptions
from cei_gym.embodiment import ARMS, load_embodiment

SOURCE = "Panda-PandaGripper"
ENVIRONMENT = f"CEI-PickCube-{SOURCE}"
TARGETS = [f"{arm}-{e}" for e in ("FourierRight", "Inspire", "FourierLeft", "RobotiqThreeFinger") for arm in ARMS]
# The paper's table I, PickCube row (percent), by end-effector and arm.
PAPER = {
    "FourierRight": {"UR5e": 81, "IIWA": 72, "Kinova3": 69, "Panda": 79},
    "Inspire": {"UR5e": 50, "IIWA": 45, "Kinova3": 33, "Panda": 43},
    "FourierLeft": {"UR5e": 88, "IIWA": 83, "Kinova3": 81, "Panda": 79},
    "RobotiqThreeFinger": {"UR5e": 19, "IIWA": 31, "Kinova3": 41, "Panda": 52},
}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", default=TARGETS)
    parser.add_argument("--seed", type=int, default=1000)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--results", type=Path, default=Path("results/replay"))
    args = parser.parse_args()
    quiet_libraries()
    work = Path("outputs/replay-benchmark") / f"{args.seed}-{args.episodes}"
    args.results.mkdir(parents=True, exist_ok=True)
    source = DatasetConfig("cei/pick_cube_panda", str(work / "source"))
    if not (work / "source").exists():
        record(RecordConfig(ENVIRONMENT, source.repo_id, source.root, args.episodes, args.seed))
    for target in [SOURCE, *(t for t in args.targets if t != SOURCE)]:
        path = args.results / f"PickCube-{target}.json"
        if not path.exists():
            cell = run_cell(source, target, work)
            cell |= {
                "seeds": [args.seed, args.seed + args.episodes - 1],
                "commit": git_commit(),
                "versions": versions(["cei-gym", "lerobot", "mujoco", "robosuite", "numpy"]),
            }
            path.write_text(json.dumps(plain(cell), indent=1) + "\n")
    write_table(args.results)


def run_cell(source: DatasetConfig, target: str, work: Path) -> dict:
    """Convert (unless it is the source itself) and replay."""
    if target == SOURCE:
        dataset, quality = source, []
    else:
        dataset = DatasetConfig(f"cei/pick_cube_{target}", str(work / target))
        shutil.rmtree(work / target, ignore_errors=True)  # left by a run that was stopped
        quality = convert(ConvertConfig(source, target, dataset.repo_id, dataset.root, allow_unreachable=True))[
            "results"
        ]
    result = replay(ReplayConfig(dataset, video_episodes=0))
    physics = physics_exceptions(load_embodiment(target))
    return {"target": target, "replay": result, "alignment": quality, "physics_exceptions": physics}


def write_table(results: Path) -> None:
    """results.csv over all the cells there are."""
    with (results / "pick_cube.csv").open("w", newline="") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(["target", "successes", "episodes", "wilson_low", "wilson_high", "paper_percent", "failures"])
        for path in sorted(results.glob("PickCube-*.json")):
            r = json.loads(path.read_text())
            arm, hand = r["target"].split("-")
            replayed = r["replay"]
            paper = PAPER.get(hand, {}).get(arm, "")
            low, high = (round(x, 3) for x in replayed["interval_95"])
            failures = "; ".join(f"{k}: {v}" for k, v in replayed["failures"].items())
            writer.writerow([r["target"], replayed["successes"], replayed["episodes"], low, high, paper, failures])


if __name__ == "__main__":
    main()
