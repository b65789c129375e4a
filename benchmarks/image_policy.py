"""Whether a policy that looks at pictures learns from painted ones: LeRobot's ACT, trained and evaluated by LeRobot's scripts.

usage: python benchmarks/image_policy.py [--arms painted,true,source] [--seed 500] [--episodes 20] [--work FOLDER] [--results FOLDER]

The Panda's demonstrations of PickCube go to the target. Arms are what their pictures show: `painted`, the target painted over the source (and, as policies act, over
itself); `true`, the target's own simulation with joints and objects as they are; `source`, the source still. All act on the target, and get its joints.
`blind` replays one demonstration. What is finished in --work is not done again; report on seeds from 2000, looked at once.
"""

import argparse
import json
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from measure import save

from cei_converters import convert
from cei_converters.benchmark.blind import blindly
from cei_converters.benchmark.jobs import record_successes
from cei_converters.cli import DatasetConfig, parse
from cei_converters.conversion.config import ConvertConfig
from cei_converters.dataset.provenance import collect
from cei_converters.dataset.writer import DatasetWriter
from cei_converters.record import RecordConfig
from cei_converters.simulation.environment import open_environment
from cei_converters.sources.reader import DatasetReader
from cei_gym.environment import robot_environment

TASK, SOURCE, TARGET, CAMERA = "PickCube", "Panda-PandaGripper", "IIWA-Inspire", "front"
ARMS = "painted", "true", "source"
VARIATION, EPISODE_LENGTH = 0.25, 200
POLICY = {
    "type": "act",
    "pretrained_backbone_weights": "null",  # its ImageNet weights are on a hub
    "use_vae": "false",
    "chunk_size": 16,
    "n_action_steps": 8,
    "dim_model": 256,
    "dim_feedforward": 1024,
    "n_encoder_layers": 2,
    "optimizer_lr": 1e-4,
    "optimizer_lr_backbone": 1e-4,
    "device": "cpu",
    "push_to_hub": "false",
}


def named(work: Path, name: str) -> DatasetConfig:
    return DatasetConfig(f"benchmark/{name}", work / "datasets" / name)


def script(name: str, log: Path, *options: str) -> None:
    log.parent.mkdir(parents=True, exist_ok=True)
    with log.open("a") as file:
        command = [Path(sys.executable).with_name(name), *options]
        subprocess.run(
            command, stdout=file, stderr=subprocess.STDOUT, env=os.environ | {"OMP_NUM_THREADS": "1"}, check=True
        )


def converted(work: Path, paint: bool, demonstrations: int) -> DatasetConfig:
    recorded, new = named(work, "recorded"), named(work, "painted" if paint else "source")
    assert recorded.root is not None and new.root is not None
    if not recorded.root.exists():
        env = f"CEI-{TASK}-{SOURCE}"
        record_successes(RecordConfig(env, recorded.repo_id, recorded.root, demonstrations, 0, VARIATION, colours=True))
    if not new.root.exists():
        options = [
            *(f"--dataset.repo_id={recorded.repo_id}", f"--dataset.root={recorded.root}", f"--target={TARGET}"),
            *(f"--new_repo_id={new.repo_id}", f"--new_root={new.root}", f"--cameras.paint={str(paint).lower()}"),
        ]
        convert.convert(parse(ConvertConfig, options, "cei-convert", ""))
    return new


def with_true_pictures(work: Path, demonstrations: int) -> DatasetConfig:
    """The painted dataset with pictures of the target's own simulation."""
    painted, new = converted(work, True, demonstrations), named(work, "true")
    assert new.root is not None
    if new.root.exists():
        return new
    reader = DatasetReader(painted.repo_id, painted.root)
    assert reader.metadata is not None
    env = open_environment(f"CEI-{TASK}-{TARGET}", colours=True)
    with DatasetWriter(
        new.repo_id, new.root, environment=reader.metadata.environment, provenance=collect({})
    ) as writer:
        for index in range(len(reader)):
            demonstration = reader.read(index)
            states, shown = demonstration.environment_state, []
            assert states is not None
            for qpos, state in zip(demonstration.qpos, states, strict=True):
                env.reset(seed=0, options={"agent_pos": qpos, "environment_state": state})
                shown.append(robot_environment(env).channels()["rgb"][CAMERA])
            writer.add(replace(demonstration, rgb={CAMERA: np.stack(shown)}), {})
    env.close()
    return new


def dataset_of(work: Path, arm: str, demonstrations: int) -> DatasetConfig:
    return (
        with_true_pictures(work, demonstrations) if arm == "true" else converted(work, arm == "painted", demonstrations)
    )


def successes(work: Path, arm: str, dataset: DatasetConfig, steps: int, batch_size: int, seeds: range) -> list[bool]:
    name = f"{arm}-{steps}x{batch_size}"
    trained, evaluated = work / "trained" / name, work / "evaluated" / f"{name}-{seeds[0]}-{seeds[-1]}"
    given = f"--dataset.repo_id={dataset.repo_id}", f"--dataset.root={dataset.root}"
    if not (trained / "checkpoints" / f"{steps:06d}").exists():
        policy = (f"--policy.{name}={value}" for name, value in POLICY.items())
        rest = (
            f"--batch_size={batch_size}",
            f"--steps={steps}",
            f"--save_freq={steps}",
            "--num_workers=0",
            "--seed=0",
        )
        script("lerobot-train", trained.with_suffix(".log"), *given, *policy, *rest, f"--output_dir={trained}")
    if not (evaluated / "eval_info.json").exists():
        script(
            "lerobot-eval",
            evaluated.with_suffix(".log"),
            f"--policy.path={trained}/checkpoints/{steps:06d}/pretrained_model",
            *("--policy.device=cpu", "--env.type=cei", f"--env.dataset={dataset.root}", "--eval.batch_size=1"),
            *(f"--env.episode_length={EPISODE_LENGTH}", f"--eval.n_episodes={len(seeds)}", f"--seed={seeds[0]}"),
            f"--output_dir={evaluated}",
        )
    return json.loads((evaluated / "eval_info.json").read_text())["per_task"][0]["metrics"]["successes"]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--arms", default=",".join(ARMS))
    parser.add_argument("--seed", type=int, default=500)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--demonstrations", type=int, default=50)
    parser.add_argument("--steps", type=int, default=5000)
    parser.add_argument("--batch_size", type=int, default=8)
    parser.add_argument("--work", type=Path, default=Path("outputs/image-policy"))
    parser.add_argument("--results", type=Path)
    args = parser.parse_args()
    arms = args.arms.split(",")
    if unknown := sorted({*arms} - {*ARMS}):
        parser.error(f"unknown arm {unknown[0]!r}; they are {', '.join(ARMS)}")
    seeds, found = range(args.seed, args.seed + args.episodes), {}
    work = args.work / f"{args.demonstrations}"  # what is made of others is not taken up
    for arm in arms:
        dataset = dataset_of(work, arm, args.demonstrations)
        found[arm] = successes(work, arm, dataset, args.steps, args.batch_size, seeds)
        print(arm, sum(found[arm]), "of", len(seeds), flush=True)
    found["blind"] = blindly(converted(work, True, args.demonstrations), False, seeds, EPISODE_LENGTH)
    print("blind", sum(found["blind"]), "of", len(seeds))
    if args.results is not None:
        counts = {arm: {"successes": sum(of), "trials": len(of)} for arm, of in found.items()}
        shared = {"task": TASK, "source": SOURCE, "target": TARGET, "policy": POLICY, "steps": args.steps}
        made = {"demonstrations": args.demonstrations, "variation": VARIATION, "batch_size": args.batch_size}
        save(args.results / "image_policy.json", shared | made | {"arms": counts}, seeds=[seeds[0], seeds[-1]])


if __name__ == "__main__":
    main()
